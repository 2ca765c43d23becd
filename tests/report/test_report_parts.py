"""Parts of a report: sections without a study, advice, outlines, residuals, markup."""

import base64
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from report_pages import Page
from robots import random_body

from consistent_id import (
    DHRow,
    DriveTerms,
    FixedMasses,
    PhysicalConsistency,
    Recording,
    TorqueModel,
    build_regression,
    compare,
    constrained_least_squares,
    from_modified_dh,
    least_squares,
    simulate_torque,
)
from consistent_id.diagnosis import Diagnosis
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.estimation.verdict import Reason, Verdict, percent
from consistent_id.report import advise, comparison_html
from consistent_id.report.links_section import (
    InertiaEllipsoid,
    equimomental,
    outline,
    view,
)
from consistent_id.report.markup import Html, grid, tag, text
from consistent_id.report.plot import buckets, extremes, packed
from consistent_id.report.report_content import _expected
from consistent_id.report.residuals_section import binned, residual_statistics
from consistent_id.robot.inertia import InertialParameters

EVIL = '<script>alert("x")</script>&"\''


@pytest.fixture(scope="module")
def experiment():
    """A small robot with friction and evil names, its estimates and recordings."""
    rng = np.random.default_rng(4)
    robot = from_modified_dh(EVIL, [DHRow(0, 0, 0.3), DHRow(-np.pi / 2, 0.2)])
    robot = replace(
        robot,
        joints=tuple(replace(j, name=f"{j.name}{EVIL}") for j in robot.joints),
        links=tuple(replace(k, name=f"{k.name}{EVIL}") for k in robot.links),
    )
    model = TorqueModel(robot, DriveTerms(viscous=True, coulomb="sign", offset=True))
    bodies = [random_body(rng) for _ in range(2)]
    links = np.concatenate([body.vector for body in bodies])
    x = np.append(links, rng.uniform(0.5, 1.0, 6))
    time = np.arange(1200) / 100

    def recorded(phase, name):
        arguments = np.array([1.3, 2.1]) * time[:, None] + phase
        rates = np.array([1.3, 2.1])
        q, dq = np.sin(arguments), rates * np.cos(arguments)
        motion = Recording(robot.joint_names, time, q, dq, -(rates**2) * q, name=name)
        return simulate_torque(model, x, motion, noise=0.3, rng=rng)

    training, held_out = recorded(0.0, f"a{EVIL}"), recorded(1.0, f"b{EVIL}")
    regression = build_regression(model, training)
    masses = FixedMasses(
        {n: b.mass for n, b in zip(robot.link_names, bodies, strict=True)}
    )
    known = [PhysicalConsistency(), masses]
    estimates = [
        least_squares(model, regression),
        constrained_least_squares(model, regression, constraints=known),
    ]
    comparison = compare(estimates, [held_out], training=[training])
    return SimpleNamespace(
        comparison=comparison, training=training, held_out=held_out, truth=x
    )


@pytest.mark.slow
def test_names_cannot_become_markup(experiment):
    html = comparison_html(
        experiment.comparison,
        training=[experiment.training],
        validation=[experiment.held_out],
    )
    page = Page(html)
    assert "alert(" in page.text
    scripts = [a for name, a in page.elements if name == "script"]
    assert all(a.get("type") == "application/json" or not a for a in scripts), (
        "only data, and the page's own script"
    )
    assert sum(not a for a in scripts) == 1
    assert "<script>alert" not in html


@pytest.mark.slow
def test_a_comparison_alone_has_the_sections_that_need_no_study(experiment):
    bare = Page(comparison_html(experiment.comparison)).sections
    assert bare == ["verdict", "parameters", "links", "certificate", "reproduce"]
    more = Page(
        comparison_html(
            experiment.comparison,
            training=[experiment.training],
            validation=[experiment.held_out],
        )
    ).sections
    assert {"health", "torque", "residuals", "friction"} <= set(more)


def test_the_constrained_estimate_is_advised_whatever_the_held_out_data_say(
    experiment,
):
    advice = advise(experiment.comparison)
    assert advice.level in ("use", "use with care")
    assert advice.method == "constrained"
    error = experiment.comparison["constrained"].held_out_error
    assert f"held-out error {percent(error)} (all joints, " in advice.headline


def test_a_faulty_log_is_said_first(experiment):
    fault = LogFinding("torque sign", "fault", "joint1", "reversed", "negate it")
    advice = advise(experiment.comparison, Diagnosis((fault,)))
    assert (advice.level, advice.method) == ("do not use", "")
    assert "reversed" in advice.cautions[0]
    html = comparison_html(experiment.comparison, diagnosis=Diagnosis((fault,)))
    assert "do not use: constrained" in html


def test_no_error_is_expected_where_most_of_it_would_be_guessed():
    advised = SimpleNamespace(statement="error to expect: 4.7 %")
    for word, said in (("use with care", "4.7 %"), ("do not use", "unknown")):
        guessed = Reason("mostly guessed", word, "")
        verdict = Verdict(word, "constrained", (guessed,))
        (line,) = _expected(advised, verdict)
        assert said in line


def test_without_a_usable_estimate_none_is_advised(experiment):
    comparison = experiment.comparison
    reports = tuple(r for r in comparison.reports if r.estimate.method != "constrained")
    broken = replace(
        reports[0],
        links=tuple(replace(k, least_eigenvalue=-1.0) for k in reports[0].links),
    )
    advice = advise(replace(comparison, reports=(broken,)))
    assert (advice.level, advice.method) == ("do not use", "")
    page = Page(comparison_html(replace(comparison, reports=(broken,))))
    assert advice.headline in page.texts
    crosses = [a for _, a in page.elements if a.get("class") == "place cross"]
    assert len(crosses) == 2


def test_ellipsoids_have_the_body_s_moments_and_outline():
    # A solid ellipsoid with semi-axes a has moments m (b^2 + c^2) / 5.
    axes = np.array([0.3, 0.2, 0.1])
    inertia = 4.0 * np.diag(np.sum(axes**2) - axes**2) / 5
    body = InertialParameters.from_central(4.0, [0.1, 0, 0], inertia)
    found = equimomental(body)
    assert np.allclose(found.Q, np.diag(axes**2))
    seen = outline(found, view(0.0, 0.0))  # along x: y to the right, z up
    assert np.allclose([seen.x, seen.y, seen.rx, seen.ry], [0, 0, 0.2, 0.1])
    assert seen.angle % 180 == pytest.approx(0.0, abs=1e-9)
    turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    tilted = outline(
        InertiaEllipsoid(found.centre, turned @ found.Q @ turned.T), view(0.0, 0.0)
    )
    assert np.allclose([tilted.rx, tilted.ry], [0.3, 0.1])
    assert equimomental(InertialParameters([-1.0, *[0] * 9])) is None
    assert equimomental(InertialParameters([1, 0, 0, 0, 1, 0, 1, 0, 0, 3])) is None


def test_downsampling_keeps_every_extreme():
    rng = np.random.default_rng(1)
    values = rng.normal(size=10_007)
    starts = buckets(len(values), 500)
    kept = extremes(values, starts)
    assert len(kept) == 2 * len(starts) <= 502
    assert (kept.min(), kept.max()) == (values.min(), values.max())
    assert np.array_equal(extremes(values, buckets(len(values), 20_000)), values)
    record = packed(values)
    counts = np.frombuffer(base64.b64decode(record["data"]), dtype="<u2")
    back = record["low"] + record["step"] * counts  # as the page's script does
    assert abs(back - values).max() <= np.ptp(values) / 65535 / 2 * (1 + 1e-9)


def test_white_residuals_are_white_and_what_velocity_explains_is_found():
    rng = np.random.default_rng(2)
    n = 4000
    time, q, dq = np.arange(n) / 100, rng.normal(size=n), rng.normal(size=n)
    white = residual_statistics(rng.normal(size=n), time, q, dq)
    assert white.white_share > 0.88  # 95 % expected of 100 lags
    assert white.correlation < 1.5
    assert white.by_velocity.explained < 0.02
    assert abs(white.drift) < 4 * white.drift_error
    # Friction that is not in the model, and a drift of 0.6 per minute.
    left = np.sign(dq) + rng.normal(size=n) + 0.01 * time
    found = residual_statistics(left, time, q, dq)
    assert found.by_velocity.explained == pytest.approx(0.5, abs=0.06)
    assert found.by_position.explained < 0.02
    assert found.drift == pytest.approx(0.6, abs=4 * found.drift_error)
    assert found.drift > 2 * found.drift_error
    assert np.isnan(binned(left, dq, 5.0).explained)  # too few to tell


def test_markup_escapes_text_and_keeps_markup():
    assert text(EVIL) == text(Html(text(EVIL)))
    assert tag("p", EVIL, title=EVIL).count("<") == 2
    assert grid(("a",), [(EVIL,)]).count("script&gt;") == 2
    assert tag("input", type="range", open=True, close=None) == (
        '<input type="range" open>'
    )
