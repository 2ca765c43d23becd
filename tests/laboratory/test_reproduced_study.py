"""A paper's study done again: where errors come from, what helps, what is written."""

import json
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser

import msgspec
import numpy as np
import pytest
from rx60 import PROBLEM, truth
from schemas import parsed

from consistent_id import cli, load_problem, low_passed
from consistent_id.errors import ProblemError
from consistent_id.excitation.request import design_request
from consistent_id.laboratory import Cameras, LoadCell
from consistent_id.laboratory.from_problem import laboratory_of, task_motion, task_path
from consistent_id.laboratory.reproduction import QUICK, error_budget, reproduce
from consistent_id.laboratory.reproduction.budget import Tempo, allowed_friction, slowed
from consistent_id.laboratory.reproduction.error_analysis import _varied
from consistent_id.laboratory.reproduction.paper_report import (
    html_page,
    markdown_tables,
)
from consistent_id.laboratory.reproduction.paper_study import (
    TASKS,
    WITHIN_LIMITS,
    place_of,
    used_by,
)
from consistent_id.problems.published import parametrisation_of, published_least_squares

ALPHA5, ALPHA12 = 4, 11


@cache
def _circle():
    return task_motion(PROBLEM, "circle").samples(slice(None, None, 5))


@cache
def _study():
    return reproduce(PROBLEM, QUICK)


def _budget(laboratory):
    motions = {"circle": _circle()}
    return error_budget(PROBLEM, laboratory, motions, cell_rate=1000.0)


@pytest.mark.slow
def test_each_part_of_the_error_is_what_that_torque_does_to_least_squares():
    laboratory = laboratory_of(PROBLEM, truth())
    motion = _circle()
    budget = _budget(laboratory)
    assert budget.causes == ("viscous", "coulomb", "offset")
    rigid = PROBLEM.model.predict(
        truth(), motion.position, motion.velocity, motion.acceleration
    )
    C = parametrisation_of(PROBLEM).matrix

    def alpha(torque):
        log = replace(motion, torque=torque)
        return C @ published_least_squares(PROBLEM, log).parameters

    # Torque by the laws of friction, written down here once more.
    viscous = np.array([3.0, 3.0, 1.5]) * motion.velocity
    coulomb = np.array([4.0, 4.0, 2.0]) * np.tanh(motion.velocity / 0.05)
    offset = np.tile([0.05, -0.05, 0.02], (len(motion), 1))
    for cause, torque in zip(budget.causes, (viscous, coulomb, offset), strict=True):
        moved = alpha(rigid + torque) - alpha(rigid)
        assert budget.error(cause)[0] == pytest.approx(moved, abs=1e-6)
    assert budget.error() == pytest.approx(budget.parts.sum(axis=(1, 2)))
    with pytest.raises(ProblemError, match="no cause 'stribeck'"):
        budget.error("stribeck")


@pytest.mark.slow
def test_noise_scatters_least_squares_as_predicted():
    quiet = laboratory_of(PROBLEM, truth())
    noise = np.array([0.16, 0.131, 0.159])
    quiet = replace(quiet, load_cell=LoadCell(noise), cameras=Cameras(300.0))
    motion = _circle()  # at 200 Hz, and so is the load cell here
    motions = {"circle": motion}
    predicted = error_budget(PROBLEM, quiet, motions, cell_rate=200.0).noise[0]
    rng = np.random.default_rng(0)
    C = parametrisation_of(PROBLEM).matrix
    drawn = []
    for _ in range(60):
        log = replace(motion, torque=noise * rng.normal(size=motion.position.shape))
        drawn.append(C @ published_least_squares(PROBLEM, log).parameters)
    found = np.std(drawn, axis=0)
    free = predicted > 0.0
    assert free.sum() == 13
    # A standard deviation from 60 draws has a relative error of 1/sqrt(120) = 0.09.
    assert found[free] / predicted[free] == pytest.approx(1.0, abs=0.35)


@pytest.mark.slow
def test_a_budget_without_friction_and_offset_is_nothing():
    laboratory = laboratory_of(PROBLEM, truth()).without_friction()
    still = replace(laboratory, load_cell=LoadCell(0.1))
    assert not _budget(still).error().any()


@pytest.mark.slow
def test_the_account_leaves_no_more_than_noise():
    study = _study()
    rest = (
        study.tasks.errors(study.tasks.tables[0]) - study.error_analysis.budget.error()
    )
    # Four standard errors, 26 numbers; and 0.01 that filters and steps leave.
    assert (abs(rest) <= 4.0 * study.error_analysis.budget.noise + 0.01).all()
    assert study.error_analysis.planned.scatter() == pytest.approx(
        study.error_analysis.budget.scatter(), abs=0.05
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ellipse", "ellipsoid"])
def test_tasks_elsewhere_are_of_another_size_in_all_directions(name):
    table = PROBLEM.table.tasks[name]
    varied = _varied(table, np.random.default_rng(0))
    ratios = np.array(varied.semi_axes) / np.array(table.semi_axes)
    assert ratios == pytest.approx(ratios[0])
    assert ratios[0] != pytest.approx(1.0)
    path = task_path(
        replace(
            PROBLEM,
            table=msgspec.structs.replace(PROBLEM.table, tasks={name: varied}),
        ),
        name,
    )
    assert path.duration == pytest.approx(varied.duration)


def test_alpha5_scatters_most_in_the_paper_and_alpha12_least():
    place = place_of(PROBLEM)
    assert (place.most_scattered, place.least_scattered) == (ALPHA5, ALPHA12)


@pytest.mark.slow
def test_slow_motion_keeps_its_path_and_stretches_time():
    motion = _circle()
    slow = slowed(motion, 2.0)
    assert (slow.position == motion.position).all()
    assert slow.time[-1] == 2.0 * motion.time[-1]
    dt = slow.time[1] - slow.time[0]
    numeric = np.gradient(slow.position, dt, axis=0)[1:-1]
    # Central differences at 100 Hz of at most 3 Hz: jerk * dt^2 / 6, below 1e-3.
    assert slow.velocity[1:-1] == pytest.approx(numeric, abs=1e-3)
    numeric = np.gradient(slow.velocity, dt, axis=0)[1:-1]
    assert slow.acceleration[1:-1] == pytest.approx(numeric, abs=0.02)


@pytest.mark.slow
def test_allowed_friction_has_the_mean_square_that_the_paper_prints():
    laboratory = laboratory_of(PROBLEM, truth())
    share = allowed_friction(PROBLEM, laboratory)
    dq = PROBLEM.motion("verification").velocity
    torque = np.array([3.0, 3.0, 1.5]) * dq
    torque = torque + np.array([4.0, 4.0, 2.0]) * np.tanh(dq / 0.05)
    printed = np.mean(PROBLEM.table.published.mean_squared_errors, axis=0)
    assert np.mean((share * torque) ** 2, axis=0) == pytest.approx(printed)


def test_the_slowness_needed_is_read_off_between_tempos():
    scatter = np.array([[1.0], [4.0], [16.0]])
    tempo = Tempo(("a",), np.array([1.0, 2.0, 4.0]), np.ones(1), scatter, 0 * scatter)
    assert tempo.needed(0, 8.0) == pytest.approx(2.0 * np.sqrt(2.0))
    assert tempo.needed(0, 0.5) == 1.0
    assert tempo.needed(0, 17.0) == float("inf")


@pytest.mark.slow
def test_limits_used_by_motions_hold_them_and_touch_them():
    limits = design_request(PROBLEM).limits
    motion = _circle()
    used = used_by(limits, {"circle": motion})
    assert used.upper == pytest.approx(motion.position.max(axis=0))
    assert used.lower == pytest.approx(motion.position.min(axis=0))
    assert used.velocity == pytest.approx(abs(motion.velocity).max(axis=0))
    assert used.acceleration == pytest.approx(abs(motion.acceleration).max(axis=0))


@pytest.mark.slow
def test_exciting_motions_are_as_long_and_scatter_alpha5_less():
    study = _study()
    tasks, exciting = study.tasks, study.with_friction[WITHIN_LIMITS]
    for task, instead in zip(tasks.experiments, exciting.experiments, strict=True):
        assert len(instead.log.wanted) == len(task.log.wanted)
        assert instead.excitation.condition < 0.3 * task.excitation.condition
    for method in (0, 2):
        before = tasks.scatter(tasks.tables[method])[ALPHA5]
        after = exciting.scatter(exciting.tables[method])[ALPHA5]
        assert before > 5.0 * after
    assert np.median(study.error_analysis.shrunk[WITHIN_LIMITS][:, ALPHA5]) > 5.0


@pytest.mark.slow
def test_verification_errors_are_mean_squares_of_the_paper_s_own_torque():
    study = _study()
    found, mine = study.verification, parametrisation_of(PROBLEM)
    first, log = found.predictors[0], found.recordings[0]
    assert (first.source, first.method) == (TASKS, "least squares as published")
    alpha = study.tasks.tables[0].mean
    # What the parameters leave before the filter passes it like the torque.
    behind = log.torque_filter
    raw = behind.source
    Y = mine.regressor(raw.position, raw.velocity, raw.acceleration)
    rest = raw.torque - np.einsum("jas,a->sj", Y, alpha)
    passed = low_passed(replace(raw, torque=rest), torque_cutoff=behind.cutoff)
    expected = (passed.torque[behind.kept] ** 2).sum(axis=0) / len(log)
    assert found.mean_squared_errors[0, 0] == pytest.approx(expected)


@pytest.mark.slow
def test_a_model_with_friction_predicts_as_well_as_the_truth_and_without_it_not():
    errors = _study().verification.mean_squared_errors[:, 0]
    published, _, with_friction, constrained = errors[:4]
    at_best = errors[-1]
    assert (published > 50.0 * at_best).all()
    assert (with_friction < 1.2 * at_best).all()
    assert (constrained < 1.2 * at_best).all()


@pytest.mark.slow
def test_inertia_tables_are_the_parallel_axis_theorem_of_the_vectors():
    study = _study()
    table = study.inertia[0]
    alpha = study.tasks.tables[0].vectors
    # Table II by hand: A2 = alpha2, F2 = -alpha5, A3 = alpha7 - m3 d4c^2.
    assert table.entries[:, 1, 0] == pytest.approx(alpha[:, 1])
    assert table.entries[:, 1, 5] == pytest.approx(-alpha[:, 4])
    assert table.entries[:, 2, 0] == pytest.approx(alpha[:, 6] - 3.603 * 0.060032**2)
    assert table.standard_deviation[1, 5] == pytest.approx(alpha[:, 4].std(ddof=1))
    # Both open directions shift A and B of links 2 and 3, and nothing else of them.
    identifiable = [[False] * 2 + [True] * 4] * 2
    assert table.identifiable[1:].tolist() == identifiable
    assert not table.identifiable[0].any()
    words = [one.bodies for one in study.inertia]
    assert all("are physically consistent" in word for word in words[3])


class _Page(HTMLParser):
    def __init__(self):
        super().__init__()
        self.references, self.tags, self.ids = [], set(), set()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        for name, value in attrs:
            if name in ("src", "href", "xlink:href"):
                self.references.append(value)
            if name == "id":
                self.ids.add(value)


@pytest.mark.slow
def test_the_page_stands_alone_and_escapes_what_the_problem_says():
    study = _study()
    said = msgspec.structs.replace(
        PROBLEM.table,
        source="<script>alert(1)</script>",
        published=msgspec.structs.replace(
            PROBLEM.table.published, notes=["a < b & <b>c</b>"]
        ),
    )
    text = html_page(replace(study, problem=replace(PROBLEM, table=said)))
    page = _Page()
    page.feed(text)
    assert "script" not in page.tags
    assert "a &lt; b &amp; &lt;b&gt;c&lt;/b&gt;" in text
    assert all(reference.startswith("#") for reference in page.references)
    assert {"printed", "causes", "exciting", "verification"} <= page.ids
    assert "url(http" not in text
    assert "prefers-color-scheme" in text
    assert "currentColor" in text
    assert "#123456" not in text


@pytest.mark.slow
def test_markdown_has_the_tables_and_no_nan():
    text = markdown_tables(_study())
    for title in (
        "Parameters by experiment",
        "Mean squared errors",
        "least identifiable",
    ):
        assert title in text
    assert "nan" not in text


@pytest.mark.slow
def test_the_command_writes_page_tables_and_numbers(tmp_path, capsys, monkeypatch):
    done = []

    def known(problem, extent, **options):
        done.append((problem.name, extent, options["seed"]))
        return _study()

    monkeypatch.setattr(
        "consistent_id.laboratory.reproduction.paper_study.reproduce", known
    )
    arguments = ["reproduce", "problems/rx60", "--quick", "--output", str(tmp_path)]
    assert cli.main([*arguments, "--verbose"]) == 0
    assert done == [("rx60", QUICK, 0)]
    assert "Mean squared errors" in capsys.readouterr().out
    record = json.loads((tmp_path / "reproduction.json").read_text())
    assert record["certified"] is True
    assert record["scatters_most"] == "alpha5"
    rows = record["verification"]["with_friction"]["rows"]
    assert rows[-1]["method"] == "truth"
    assert (tmp_path / "reproduction.html").exists()
    assert (tmp_path / "reproduction.md").exists()
    assert cli.main([*arguments, "--json"]) == 0
    assert len(record.pop("digest")) == 16  # the file's own, not the study's
    assert parsed(capsys.readouterr().out) == record


@pytest.mark.parametrize(
    ("old", "new", "seed", "message"),
    [
        ('"held_out"]', '"holdout"]', 0, "no motion 'holdout'"),
        (
            '["circle", "ellipse", "bulb", "ellipsoid", "helix", "free"]',
            '["free"]',
            0,
            "one has no scatter",
        ),
        ("", "", -1, "seed is -1"),
    ],
)
def test_what_cannot_be_done_is_refused_at_once(tmp_path, old, new, seed, message):
    text = (PROBLEM.folder / "problem.toml").read_text()
    (tmp_path / "problem.toml").write_text(text.replace(old, new))
    with pytest.raises(ProblemError, match=message):
        reproduce(load_problem(tmp_path), seed=seed)


def test_a_problem_without_a_laboratory_is_refused(tmp_path, capsys):
    text = (PROBLEM.folder / "problem.toml").read_text()
    (tmp_path / "problem.toml").write_text(text.split("[laboratory]")[0])
    arguments = ["reproduce", str(tmp_path), "--output", str(tmp_path / "out")]
    assert cli.main(arguments) == 2
    assert "no [laboratory] table" in capsys.readouterr().err
