"""Weights by cross-validation: what the data say of the nominal robot, and honestly."""

from types import SimpleNamespace

import numpy as np
import pytest
from robots import random_body, random_robot, random_states
from some_fast import some_fast

from consistent_id import (
    PhysicalConsistency,
    ProblemError,
    Recording,
    TorqueModel,
    constrained_least_squares,
    simulate_torque,
)
from consistent_id.constraints.priors import Penalty
from consistent_id.estimation import cross_validation
from consistent_id.estimation.cross_validation import WEIGHTS as GRID
from consistent_id.estimation.cross_validation import cross_validated
from consistent_id.regression import joint_noise
from consistent_id.regression.segments import merged, segment_regressions

WEIGHTS = 10.0 ** np.arange(2, -7, -1)
BODIES = (PhysicalConsistency(),)
SEEDS = (0, pytest.param(1, marks=pytest.mark.slow))


def simulated(seed, right, samples, noise, joints=3, count=12):
    """Weighted segments and recording of a robot that is the nominal one, or not."""
    rng = np.random.default_rng(seed)
    _, robot = random_robot(rng, joints)
    model = TorqueModel(robot)
    other = np.concatenate([random_body(rng).vector for _ in range(joints)])
    truth = robot.nominal if right else other
    states = random_states(rng, joints, samples)
    log = Recording(robot.joint_names, np.arange(samples) / 100, *states)
    sigma = noise * simulate_torque(model, truth, log).torque.std(axis=0) + 1e-9
    log = simulate_torque(model, truth, log, noise=sigma, rng=rng)
    segments = segment_regressions(model, log, count=count)
    weights = joint_noise(model, merged(segments))
    return model, [s.weighted(weights) for s in segments], log


@pytest.mark.slow
@pytest.mark.parametrize("distance", some_fast(["pullback", "euclidean", "entropic"]))
@pytest.mark.parametrize("seed", SEEDS)
def test_a_wrong_nominal_robot_gets_little_weight_where_data_are_rich(seed, distance):
    model, segments, _ = simulated(seed, right=False, samples=1500, noise=0.02)
    path = cross_validated(
        model, segments, constraints=BODIES, distance=distance, weights=WEIGHTS
    )
    assert path.penalty.distance == distance
    assert path.penalty.weight <= 1e-2
    assert all(path.certified)


@pytest.mark.slow
@pytest.mark.parametrize("distance", some_fast(["pullback", "euclidean", "entropic"]))
@pytest.mark.parametrize("seed", SEEDS)
def test_a_right_one_gets_much_where_data_are_scarce_and_noisy(seed, distance):
    model, segments, _ = simulated(seed, right=True, samples=60, noise=1.0)
    path = cross_validated(
        model, segments, constraints=BODIES, distance=distance, weights=WEIGHTS
    )
    assert path.penalty.weight >= 0.1
    assert path.error[path.best] < path.error[-1]


@pytest.mark.slow
def test_the_error_of_a_fold_is_that_of_predicting_its_samples():
    model, segments, log = simulated(3, right=False, samples=240, noise=0.3)
    path = cross_validated(
        model, segments, constraints=BODIES, weights=[1e-2, 1.0], folds=4
    )
    assert path.weights.tolist() == [1.0, 1e-2]
    assert path.errors.shape == (2, 4)
    # The second fold of four: segments 3 to 5 of twelve, samples 60 to 119.
    others = merged([*segments[:3], *segments[6:]])
    held_out = log.samples(slice(60, 120))
    sigma = segments[0].sigma

    def least(regression):
        R = regression.stacked()
        x = np.linalg.lstsq(R[:, :-1], R[:, -1], rcond=1e-12)[0]
        return np.sum((R[:, :-1] @ x - R[:, -1]) ** 2)

    for weight, errors in zip(path.weights, path.errors, strict=True):
        # A weight is in units of the residual of all data.
        own = Penalty(weight * least(merged(segments)) / least(others), inside=0.0)
        estimate = constrained_least_squares(
            model, others, constraints=BODIES, prior=own
        )
        rest = (held_out.torque - estimate.predict(held_out)) / sigma
        assert errors[1] == pytest.approx(np.sqrt(np.mean(rest**2)), rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("right", "samples"), [(True, 60), (False, 240), (True, 24)])
@pytest.mark.parametrize("joints", some_fast([1, 2]))
def test_the_path_finds_the_best_of_all_weights_without_trying_them_all(
    right, samples, joints
):
    model, segments, _ = simulated(5, right, samples, noise=0.5, joints=joints)
    path = cross_validated(model, segments, constraints=BODIES)
    whole = cross_validated(model, segments, constraints=BODIES, weights=GRID)
    assert len(path.weights) < len(whole.weights) == len(GRID)
    assert (np.diff(path.weights) < 0.0).all()
    assert path.penalty == whole.penalty
    places = [int(np.flatnonzero(GRID == weight)[0]) for weight in path.weights]
    # Fits of folds end at a relative gap of 1e-4, those of all data at 1e-6.
    assert path.errors == pytest.approx(whole.errors[places], rel=1e-4)
    assert path.misfits == pytest.approx(whole.misfits[places], rel=1e-5)


@pytest.mark.slow
def test_the_path_is_the_estimates_with_all_data():
    model, segments, log = simulated(4, right=False, samples=240, noise=0.3)
    path = cross_validated(model, segments, constraints=BODIES, weights=WEIGHTS)
    for i in (2, 5):
        estimate = constrained_least_squares(
            model,
            merged(segments),
            constraints=BODIES,
            prior=Penalty(path.weights[i], path.distance),
        )
        size = np.maximum(abs(estimate.parameters), 1.0)
        assert (abs(path.parameters[i] - estimate.parameters) <= 1e-3 * size).all()
        rest = (log.torque - estimate.predict(log)) / segments[0].sigma
        assert path.misfits[i] == pytest.approx(np.sqrt(np.mean(rest**2)), rel=1e-6)
    assert (np.diff(path.misfits) <= 1e-6).all()
    assert (np.diff(path.distances) >= -1e-4).all()
    assert path.error == pytest.approx(np.sqrt(np.mean(path.errors**2, axis=1)))
    assert path.best == np.argmin(path.error)


@pytest.mark.slow
def test_folds_solved_together_have_the_errors_of_folds_solved_alone(monkeypatch):
    model, segments, _ = simulated(5, right=False, samples=120, noise=0.3)
    options = {"constraints": BODIES, "weights": [1e-3, 0.1, 10.0]}
    found = cross_validated(model, segments, **options)
    nothing = [None] * 3 * found.errors.shape[1]
    monkeypatch.setattr(cross_validation, "penalised_fits", lambda *_, **__: nothing)
    alone = cross_validated(model, segments, **options)
    # Fits of folds end at a relative gap of 1e-4.
    np.testing.assert_allclose(found.errors, alone.errors, rtol=5e-3)
    np.testing.assert_array_equal(found.parameters, alone.parameters)


def test_folds_and_weights_that_are_none_are_refused():
    model, segments, _ = simulated(6, right=True, samples=60, noise=0.3)
    with pytest.raises(ProblemError, match="1 folds of 1 segments"):
        cross_validated(model, segments[:1])
    for weights in ([], [0.0, 1.0], [-1.0]):
        with pytest.raises(ProblemError, match="positive"):
            cross_validated(model, segments, weights=weights)


def test_two_folds_are_enough_and_one_is_not():
    model, segments, _ = simulated(0, right=True, samples=60, noise=0.1, joints=1)
    found = cross_validated(model, segments, constraints=BODIES, weights=[1.0], folds=2)
    assert found.penalty.weight == 1.0
    with pytest.raises(ProblemError, match="1 folds of 12 segments"):
        cross_validated(model, segments, constraints=BODIES, weights=[1.0], folds=1)


def test_weights_to_choose_from_are_two_in_a_factor_of_ten():
    np.testing.assert_allclose(GRID, np.logspace(2, -8, 21))


@pytest.mark.slow
@pytest.mark.parametrize("distance", ["pullback", "entropic"])
@pytest.mark.parametrize("best", [0, 2, 7, 99])
def test_every_second_weight_is_tried_and_those_beside_the_best(
    monkeypatch, distance, best
):
    """Of errors that grow away from one of the weights."""
    model, segments, _ = simulated(0, right=True, samples=24, noise=0.1, joints=1)
    grid = [weight for weight in GRID if distance != "entropic" or weight > 0.9e-6]
    wanted, starts = np.log(grid[0::2][min(best, len(grid[::2]) - 1)]), []

    def along(task, distance, weights, start=None):
        starts.append(start)
        proof = SimpleNamespace(verdict="certified")
        found = [
            SimpleNamespace(
                solution=SimpleNamespace(u=np.full(10, np.log(weight) - wanted)),
                optimality=proof,
                excess=0.0,
                squared_distance=weight,
            )
            for weight in weights
        ]
        return [found for _ in task[0]]

    def errors(tested, fits, samples):
        return np.array([1.0 + fit.solution.u[0] ** 2 for fit in fits])

    monkeypatch.setattr(cross_validation, "_along", along)
    monkeypatch.setattr(cross_validation, "_errors", errors)
    path = cross_validated(model, segments, distance=distance, folds=3)
    place = min(2 * best, 2 * len(grid[::2]) - 2)
    tried = {*range(0, len(grid), 2), place - 1, place + 1}
    expected = [grid[k] for k in sorted(tried) if 0 <= k < len(grid)]
    np.testing.assert_allclose(path.weights, expected)
    assert path.weights[path.best] == grid[place]
    np.testing.assert_allclose(path.distances**2, expected)
    assert path.errors.shape == (len(expected), 3)
    # All data, and all but each fold, first from nominal, then from the best.
    assert starts[:2] == [None] * 2 and len(starts) == 4
    assert all((start == 0.0).all() for start in starts[2:])
