"""What determines a parameter: the same in every table, and relative to its value."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from experiments import pendulum
from robots import random_robot

from consistent_id import (
    DriveTerms,
    Estimate,
    FixedMasses,
    InertialParameters,
    PhysicalConsistency,
    Recording,
    TorqueModel,
    build_regression,
    constrained_least_squares,
    least_squares,
    simulate_torque,
)
from consistent_id.constraints import Penalty
from consistent_id.estimation import determination
from consistent_id.estimation.determination import (
    LinearErrors,
    determinations,
    linear_errors,
    origin_text,
    parameter_sizes,
    pinned,
    stated_errors,
)
from consistent_id.estimation.uncertainties.parameter_uncertainty import uncertainty
from consistent_id.regression import base_parameters
from consistent_id.regression.residual_noise import unconstrained_fit
from consistent_id.regression.segments import merged, segment_regressions

BODIES = (PhysicalConsistency(), FixedMasses())


def noisy(noise, seed=0):
    model, truth, log = pendulum()
    rng = np.random.default_rng(seed)
    return model, simulate_torque(model, truth, log, noise=noise, rng=rng)


def test_errors_without_equalities_are_those_of_least_squares():
    model, log = noisy(0.5)
    regression, base = build_regression(model, log), base_parameters(model)
    none = np.zeros((0, len(model.layout)))
    found = linear_errors(base, unconstrained_fit(regression, base).noise, none).values
    stated = least_squares(model, regression, base=base).standard_errors
    assert found[list(base.independent)] == pytest.approx(stated, rel=1e-6)


def test_an_equality_that_ties_two_parameters_shrinks_their_errors():
    # hx = hy: one unknown with the information of both, and their cross terms.
    model, log = noisy(0.5)
    regression, base = build_regression(model, log), base_parameters(model)
    tie = np.zeros((1, len(model.layout)))
    tie[0, 1:3] = 1.0, -1.0
    noise = unconstrained_fit(regression, base).noise
    found = linear_errors(base, noise, tie).values
    assert found[1] == pytest.approx(found[2])
    free = linear_errors(base, noise, tie[:0]).values
    assert found[1] < free[1]


def test_a_size_is_the_value_or_a_tenth_of_the_torque():
    model, log = noisy(0.5)
    regression = build_regression(model, log)
    (factor,) = regression.factors
    x = np.zeros(len(model.layout))
    k = model.layout.index("joint1.viscous")
    torque, column = (np.linalg.norm(factor[:, i]) for i in (-1, k))
    sizes = parameter_sizes(model, regression, x)
    assert sizes[k] == pytest.approx(0.1 * torque / column)
    x[k] = -100.0
    assert parameter_sizes(model, regression, x)[k] == 100.0


def test_a_small_value_is_called_small_with_its_relative_error():
    assert origin_text("data", -2.0, 1.0) == "data"
    # 1.96 standard errors are 2.94 times the value.
    assert origin_text("data", -0.1, 0.15) == "small (± 294 %)"
    assert origin_text("data", 0.0, 0.15) == "small (± more than 1000 %)"
    assert origin_text("data", 0.0, 1e6) == "small (± more than 1000 %)"
    assert origin_text("data", 0.0, 0.0) == "data"
    assert origin_text("data", 0.1, np.nan) == "data"
    assert origin_text("loose", 0.1, 9.0) == "loose"


@pytest.mark.slow
def test_tables_call_small_what_the_data_determine_to_be_small():
    model, truth, log = pendulum()
    friction = model.layout.index("joint1.viscous")
    truth = truth.copy()
    truth[friction] = 1e-4
    rng = np.random.default_rng(1)
    log = simulate_torque(model, truth, log, noise=0.5, rng=rng)
    segments = segment_regressions(model, log, count=8)
    regression = merged(segments)
    estimate = constrained_least_squares(model, regression, constraints=BODIES)
    assert estimate.origins[friction] == "data"
    row = estimate.table().rows[friction]
    assert row[-1].startswith("small (± ") and row[-1].endswith(" %)")
    assert any(note.startswith("small: ") for note in estimate.table().notes)
    found = uncertainty(model, segments, constraints=BODIES, replicates=4)
    p = found["joint1.viscous"]
    assert p.verdict == "data" and p.source.startswith("small (± ")


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.05, 3.0])
def test_estimate_and_uncertainty_agree_on_what_the_data_determine(noise):
    model, log = noisy(noise)
    segments = segment_regressions(model, log, count=8)
    estimate = constrained_least_squares(model, merged(segments), constraints=BODIES)
    found = uncertainty(model, segments, constraints=BODIES, replicates=4)
    verdicts = [p.verdict for p in found.parameters]
    for origin, verdict in zip(estimate.origins, verdicts, strict=True):
        # Intervals can only add that constraints leave no room.
        assert verdict == origin or verdict == "constraint"
        assert (origin == "data") == (verdict == "data")


@pytest.mark.slow
def test_a_standard_error_holds_the_priors_bias_and_is_only_where_it_means_something():
    model, log = noisy(1.0)
    segments = segment_regressions(model, log, count=8)
    found = uncertainty(model, segments, constraints=BODIES, replicates=4)
    for p in found.parameters:
        if p.verdict in ("data", "constraint"):
            assert p.standard_error >= p.prior_shift
        else:
            assert np.isnan(p.standard_error)
    assert "scatter" in found.scatter


def coloured(log, rng, size, rho=0.9):
    """The log with noise whose samples are correlated by `rho` to the next."""
    noise = rng.normal(size=log.torque.shape) * size * np.sqrt(1.0 - rho**2)
    for i in range(1, len(noise)):
        noise[i] += rho * noise[i - 1]
    return replace(log, torque=log.torque + noise)


def slow_arm(rng):
    """A robot that moves slowly beside the noise; its nominal bodies are not true."""
    _, robot = random_robot(rng, 2)
    model = TorqueModel(robot, DriveTerms(viscous=True, rotor_inertia=True))
    nominal = [InertialParameters(v) for v in robot.nominal.reshape(-1, 10)]
    bodies = [
        InertialParameters.from_central(b.mass, b.com + 0.02, 1.2 * b.central_inertia)
        for b in nominal
    ]
    truth = np.concatenate([*(b.vector for b in bodies), rng.uniform(0.5, 1.0, 4)])
    time, rates = np.arange(2000) / 100, rng.uniform(0.5, 4.0, (4, 2))
    angles = rates * time[:, None, None] + rng.uniform(0.0, 6.0, (4, 2))
    q, dq, ddq = np.sin(angles), rates * np.cos(angles), -(rates**2) * np.sin(angles)
    log = Recording(robot.joint_names, time, *(x.sum(axis=1) for x in (q, dq, ddq)))
    return model, truth, simulate_torque(model, truth, log)


@pytest.mark.slow
def test_standard_errors_of_constrained_estimates_hold_under_correlated_noise():
    rng = np.random.default_rng(2)
    model, truth, log = slow_arm(rng)
    base, ratios = base_parameters(model), []
    for _ in range(25):
        regression = build_regression(model, coloured(log, rng, 0.5))
        found = constrained_least_squares(model, regression, base=base)
        errors = found.parameter_errors
        seen = np.array([o in ("data", "loose") for o in found.origins])
        assert (np.isfinite(errors) == seen).all()
        ratios.append(((found.parameters - truth) / errors)[seen])
    ratios = np.concatenate(ratios)
    assert len(ratios) > 100
    # 95 %, with room for 25 logs; white errors would be some four times too small.
    assert np.mean(abs(ratios) < 1.96) == pytest.approx(0.95, abs=0.05)
    assert np.sqrt(np.mean(ratios**2)) == pytest.approx(1.0, abs=0.2)


def test_the_priors_pull_is_in_the_standard_error():
    model, log = noisy(0.5)
    regression = build_regression(model, log)
    k = model.layout.index("joint1.viscous")
    free = constrained_least_squares(model, regression, constraints=BODIES)
    pulled = constrained_least_squares(
        model, regression, constraints=BODIES, prior=Penalty(weight=1e3)
    )
    moved = abs(pulled.parameters - free.parameters)[k]
    assert moved > 5.0 * free.parameter_errors[k]
    assert pulled.parameter_errors[k] == pytest.approx(moved, rel=0.3)


def test_standard_errors_are_in_the_table_and_in_the_file(tmp_path):
    model, log = noisy(0.5)
    base = base_parameters(model)
    found = constrained_least_squares(model, build_regression(model, log), base=base)
    again = Estimate.load(found.save(tmp_path / "it.json"), model, base)
    np.testing.assert_allclose(again.parameter_errors, found.parameter_errors)
    table = found.table()
    cells = [row[table.header.index("standard error")] for row in table.rows]
    known = np.isfinite(found.parameter_errors)
    assert [cell != "-" for cell in cells] == known.tolist() and known.any()
    assert float(cells[int(np.argmax(known))]) == pytest.approx(
        found.parameter_errors[known][0], rel=0.05
    )
    assert any(note.startswith("standard error: for noise") for note in table.notes)
    # Files of earlier versions have none.
    record = json.loads((tmp_path / "it.json").read_text())
    for entry in record["parameters"].values():
        del entry["standard_error"]
    (tmp_path / "old.json").write_text(json.dumps(record))
    assert Estimate.load(tmp_path / "old.json", model, base).parameter_errors is None


def found_of(name, errors, width=None, *, known=None, elsewhere="prior"):
    """What determines a parameter of the pendulum, of given errors and widths in sizes.

    And what determines the others.
    """
    model, log = noisy(0.5)
    regression, base = build_regression(model, log), base_parameters(model)
    x = np.zeros(len(model.layout))
    size = parameter_sizes(model, regression, x)
    rows = np.zeros((0, len(x))) if known is None else known(model.layout)
    stated = LinearErrors(errors * size, rows, np.full(len(x), np.inf))
    free = unconstrained_fit(regression, base)
    found = determinations(model, free, stated, x, elsewhere=elsewhere)
    if width is not None:
        found = pinned(found, width * size, size)
    k = model.layout.index(name)
    return found[k], [*found[:k], *found[k + 1 :]]


# The 95 % interval is 2 x 1.96 errors wide, and may be half a size wide.
GATE = 0.5 / (2.0 * 1.96)


@pytest.mark.parametrize(
    ("errors", "width", "expected"),
    [
        (0.999 * GATE, None, "data"),
        (1.001 * GATE, None, "loose"),
        # Constraints that leave a tenth of a size determine what data do not.
        (1.001 * GATE, 0.0999, "constraint"),
        (1.001 * GATE, 0.1001, "loose"),
        (0.999 * GATE, 0.0999, "data"),
        (0.999 * GATE, 0.1001, "data"),
    ],
)
def test_data_determine_a_value_to_half_a_size_and_constraints_to_a_tenth(
    errors, width, expected
):
    assert found_of("joint1.viscous", errors, width)[0] == expected


@pytest.mark.parametrize(
    ("width", "pinned"), [(0.0999, True), (0.1001, False), (None, False)]
)
@pytest.mark.parametrize("elsewhere", ["prior", "convention"])
def test_what_no_data_see_is_the_constraints_or_the_priors(width, pinned, elsewhere):
    # A pendulum about z feels hx, hy and Izz alone, and never its hz.
    found, _ = found_of("link1.hz", 1e-9, width, elsewhere=elsewhere)
    assert found == ("constraint" if pinned else elsewhere)


def test_a_value_that_is_stated_is_the_constraints_however_well_data_see_it():
    def stated(layout):
        return np.eye(len(layout))[[layout.index("joint1.viscous")]]

    found, others = found_of("joint1.viscous", 1e-9, known=stated)
    assert found == "constraint" and "constraint" not in others


def test_standard_errors_are_those_of_parameters_that_data_see():
    origins = ("data", "loose", "combination", "constraint", "prior", "convention")
    found = stated_errors(np.full(6, 3.0), origins, shift=4.0)
    np.testing.assert_allclose(found[:2], 5.0)  # of noise and of bias, by Pythagoras
    assert np.isnan(found[2:]).all()


def test_a_value_is_small_whose_interval_contains_zero():
    """Half an interval is 1.96 standard errors; beyond ten times it is not stated."""
    for error, said in (
        (0.51, "data"),
        (0.52, "small (± 102 %)"),
        (5.0, "small (± 980 %)"),
        (5.2, "small (± more than 1000 %)"),
    ):
        for value in (1.0, -1.0):
            assert origin_text("data", value, error) == said
    assert origin_text("prior", 1.0, 5.0) == "prior"
    assert origin_text("data", 0.0, 1.0) == "small (± more than 1000 %)"


def test_a_size_makes_a_tenth_of_the_torque_of_joints_that_depend_on_it(monkeypatch):
    model = SimpleNamespace(robot=None, layout=SimpleNamespace(inertial_size=3))
    scales = SimpleNamespace(units=np.array([4.0, 5.0, 6.0]))
    monkeypatch.setattr(determination, "link_scales", lambda robot: scales)
    rng = np.random.default_rng(0)
    factors = rng.uniform(0.01, 0.1, (2, 4, 6)) * [1.0, 1.0, 0.0, 3.0, 1.0, 50.0]
    factors[0, :, 1] = 0.0
    sizes = parameter_sizes(
        model, SimpleNamespace(factors=factors), np.array([0.0, -70.0, 0.2, 0.0, 0.0])
    )
    squares = np.sum(factors**2, axis=1)
    whole = squares.sum(axis=0)
    both = 0.1 * np.sqrt(whole[5] / whole[[0, 3, 4]])
    np.testing.assert_allclose(sizes, [both[0], 70.0, 6.0, *both[1:]])
    smaller = parameter_sizes(model, SimpleNamespace(factors=factors), np.zeros(5))
    assert smaller[1] == pytest.approx(0.1 * np.sqrt(squares[1, 5] / squares[1, 1]))
