"""The expected error's range follows the scatter of segments and the new motion."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from experiments import experiment

from consistent_id import ProblemError, build_regression, simulate_torque
from consistent_id.constraints import PointToSet
from consistent_id.estimation import expected_error as expectation
from consistent_id.estimation.best_fit import FitProblem
from consistent_id.estimation.constrained import constrained_least_squares
from consistent_id.estimation.constrained_fit import DEFAULT_CONSTRAINTS
from consistent_id.estimation.expected_error import (
    ExpectedError,
    error_forecast,
    expected_error,
)
from consistent_id.estimation.left_out import (
    LeftOutErrors,
    folds_of,
    left_out_errors,
    left_out_fits,
    prediction_spread,
)
from consistent_id.estimation.torque_error import stacked_of_regression
from consistent_id.regression import base_parameters, segment_regressions
from consistent_id.regression.segments import merged


def of_errors(errors):
    n = len(errors)
    return LeftOutErrors([errors], np.full(n, 1 / n), [1.0], [1.0])


def test_the_range_is_that_of_one_more_draw_of_student_s_distribution():
    logs = np.log(0.03) + np.array([-0.3, -0.1, 0.0, 0.1, 0.3])
    found = expected_error(of_errors(np.exp(logs)))
    # 90 % quantile with four degrees of freedom: 1.5332, from tables.
    factor = np.exp(1.5332 * np.sqrt(0.05) * np.sqrt(1.2))
    assert found.error == pytest.approx(np.sqrt(np.mean(np.exp(logs) ** 2)))
    assert found.high / found.error == pytest.approx(factor, rel=1e-4)
    assert found.error / found.low == pytest.approx(factor, rel=1e-4)


@pytest.mark.slow
def test_four_of_five_further_errors_are_in_the_range():
    rng = np.random.default_rng(0)
    inside = []
    for _ in range(2000):
        *seen, new = np.exp(rng.normal(np.log(0.05), 0.2, 25))
        inside.append(expected_error(of_errors(np.array(seen))).contains(new))
    # The pooled error is a root mean square, 4 % above the median of this scatter.
    assert np.mean(inside) == pytest.approx(0.8, abs=0.03)


def test_without_a_block_that_can_be_left_out_nothing_is_expected():
    assert expected_error(of_errors(np.array([0.1, np.inf]))) is None


def test_an_error_of_all_torque_and_more_is_said_in_words():
    found = expected_error(of_errors(np.array([0.1, 0.2, 9.0, 0.1])))
    assert found.error > 1.0 and not found.predicts
    assert str(found) == "unknown, the data do not predict other motion"
    assert ExpectedError(0.99, 0.5, 2.0).predicts


@pytest.mark.parametrize(
    ("low", "high", "said"),
    [
        (0.16, 0.9, "16 % to 90 %"),
        (0.16, 3.1, "16 % to over 100 %"),
        (1.2, 40.0, "over 100 %"),
    ],
)
def test_a_range_does_not_tell_errors_above_100_per_cent_apart(low, high, said):
    assert ExpectedError(low, low, high).range == said


def test_errors_out_of_order_are_refused():
    with pytest.raises(ProblemError, match="in order"):
        ExpectedError(0.03, 0.04, 0.05)


@pytest.fixture(scope="module")
def forecast():
    model, truth, log = experiment(3, joints=3, noise=0.5, samples=1200)
    segments, base = segment_regressions(model, log), base_parameters(model)
    prior = PointToSet()
    whole = merged(segments)
    estimate = constrained_least_squares(model, whole, prior=prior, base=base)
    left_out = left_out_errors(
        left_out_fits(
            model, folds_of(segments), constraints=DEFAULT_CONSTRAINTS, base=base
        ),
        [prior],
    )
    found = error_forecast(
        FitProblem.of(model, whole, DEFAULT_CONSTRAINTS, base),
        left_out,
        parameters=estimate.parameters,
        prior=prior,
    )
    return model, truth, log, found


@pytest.mark.slow
def test_a_motion_like_the_training_motion_has_the_range_of_any(forecast):
    model, _, log, found = forecast
    there = found.on(build_regression(model, log))
    assert there.to_dict() == pytest.approx(found.expected.to_dict(), rel=1e-12)


@pytest.mark.slow
def test_with_less_torque_the_range_holds_noise_and_errors_that_grow_with_it(forecast):
    model, truth, log, found = forecast
    quiet = log.samples(abs(log.torque).sum(axis=1) < np.median(abs(log.torque)))
    rows = build_regression(model, quiet)
    here, there = (
        np.linalg.norm(one.predicted_rms(truth)) for one in (found.regression, rows)
    )
    assert here > 1.5 * there
    expected = found.on(rows)
    # White noise has the same size everywhere.
    noise = found.expected.error * here / there
    assert expected.contains(noise)
    assert expected.contains(found.expected.error)
    assert expected.error == pytest.approx(
        np.sqrt(noise * found.expected.error), rel=0.1
    )


@pytest.mark.slow
def test_the_range_widens_upwards_with_the_distance_of_the_motion(forecast):
    model, truth, log, found = forecast
    widths = []
    for faster in (1.0, 2.0, 4.0):
        motion = replace(
            log,
            velocity=faster * log.velocity,
            acceleration=faster**2 * log.acceleration,
        )
        there = found.on(build_regression(model, simulate_torque(model, truth, motion)))
        assert there.low <= found.expected.low
        widths.append(there.high / there.low)
    assert widths[0] < widths[1] < widths[2]


def test_a_distance_beyond_that_tested_adds_to_the_error_and_a_nearer_one_does_not(
    forecast,
):
    """``E_new^2 = E^2 + (E^2 - F^2) max(D^2 / D_0^2 - 1, 0)`` at equal torque."""
    _, _, log, found = forecast
    rows = build_regression(found.model, log)
    fitted = stacked_of_regression(found.model, found.regression, found.parameters)
    whole = found.expected.error**2 - fitted**2
    assert 0.0 < found.excess == pytest.approx(whole, rel=1e-9)
    spread = prediction_spread(
        found.root, found.scaled, rows.weighted(found.regression.sigma), found.base
    )
    x = found.parameters
    E, excess = found.expected.error, 0.5 * found.expected.error**2
    for tested, farther in ((spread / 4.0, 3.0), (spread, 0.0), (4.0 * spread, 0.0)):
        there = replace(found, tested=tested, excess=excess).on(rows)
        assert there.error == pytest.approx(np.sqrt(E**2 + farther * excess), rel=1e-9)
    # Without torque there is none to compare; an error of nothing has no range.
    still = replace(found, tested=spread / 4.0, excess=0.04, parameters=0.0 * x)
    still = replace(still, expected=ExpectedError(0.0, 0.0, 0.0)).on(rows)
    assert (still.error, still.low) == (pytest.approx(np.sqrt(0.12)), 0.0)
    assert still.high == still.error


@pytest.mark.parametrize(("fitted", "excess"), [(0.2, 0.12), (0.5, 0.0)])
def test_the_excess_is_of_squares_beyond_the_fitted_one(monkeypatch, fitted, excess):
    for name, made in {
        "expected_error": SimpleNamespace(error=0.4),
        "nominal_distance": None,
        "stacked_of_regression": fitted,
        "prediction_root": "root",
    }.items():
        monkeypatch.setattr(expectation, name, lambda *a, made=made: made)
    free = SimpleNamespace(regression=None, base=None)
    scaled = SimpleNamespace(unit=None)
    problem = SimpleNamespace(model=None, free=free, scaled=lambda: scaled)
    left_out = SimpleNamespace(spreads=[0.3, 0.9], weights=[2.0, 5.0])
    prior = SimpleNamespace(distance="pullback")
    found = expectation.error_forecast(problem, left_out, parameters=None, prior=prior)
    assert found.excess == pytest.approx(excess)
    assert (found.tested, found.root, found.scaled) == (0.3, "root", scaled)
