"""Segments are predicted by fits without their block, and squares are pooled."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from experiments import experiment

from consistent_id import (
    DHRow,
    ProblemError,
    TorqueModel,
    build_regression,
    from_modified_dh,
)
from consistent_id.constraints import PointToSet
from consistent_id.estimation.best_fit import FitProblem, scaled_fit
from consistent_id.estimation.constrained_fit import (
    DEFAULT_CONSTRAINTS,
    constrained_fit,
)
from consistent_id.estimation.left_out import (
    FOLDS,
    LeftOutErrors,
    _between,
    _pooled,
    _Predicted,
    folds_of,
    left_out_errors,
    left_out_fits,
    prediction_root,
    prediction_spread,
)
from consistent_id.estimation.torque_error import stacked_of_regression
from consistent_id.regression import base_parameters, segment_regressions
from consistent_id.regression.segments import merged


@pytest.fixture(scope="module")
def logged():
    model, _, log = experiment(3, joints=3, noise=0.5, samples=1200)
    return model, segment_regressions(model, log), base_parameters(model)


def test_the_pooled_error_is_that_of_all_rows_over_all_torque():
    squares, torque = np.array([4.0, 1.0, 9.0]), np.array([100.0, 1.0, 400.0])
    rows = np.array([10, 5, 20])
    shares = rows / rows.sum()
    errors = np.sqrt((squares / rows) / (torque.sum() / rows.sum()))
    found = LeftOutErrors([errors], shares, [1.0], [1.0])
    assert found.pooled == pytest.approx([np.sqrt(squares.sum() / torque.sum())])


@pytest.mark.slow
def test_each_segment_is_predicted_by_the_fit_without_its_block(logged):
    model, segments, base = logged
    folds = folds_of(segments)
    found = left_out_errors(
        left_out_fits(model, folds, constraints=DEFAULT_CONSTRAINTS, base=base),
        [PointToSet()],
    )
    assert found.errors.shape == (1, len(segments))
    assert found.shares.sum() == pytest.approx(1.0)
    assert len(folds) == FOLDS
    fold = folds[2]
    problem = FitProblem.of(model, fold.rest, DEFAULT_CONSTRAINTS, base)
    x = constrained_fit(problem, PointToSet()).parameters
    block = merged(fold.segments)
    own = slice(8, 12)
    squared = found.errors[0, own] ** 2 @ found.shares[own] / found.shares[own].sum()
    # One joint turns and two slide: each kind has its own relative error, over the
    # torque of all segments.
    left, torque = block.residual_rms(x) ** 2, merged(segments).torque_rms ** 2
    kinds = [left[0] / torque[0], left[1:].sum() / torque[1:].sum()]
    assert squared == pytest.approx(np.mean(kinds), rel=1e-3)


@pytest.mark.slow
def test_the_torque_itself_is_the_error_of_no_parameters(logged):
    model, segments, _ = logged
    nothing = np.zeros(len(model.layout))
    assert stacked_of_regression(model, merged(segments), nothing) == pytest.approx(1.0)


@pytest.mark.slow
def test_the_spread_is_that_of_the_covariance(logged):
    model, segments, base = logged
    whole, block = merged(segments), segments[0]
    scaled = scaled_fit(model, whole, base, DEFAULT_CONSTRAINTS)
    fitted = constrained_fit(
        FitProblem.of(model, whole, DEFAULT_CONSTRAINTS, base), PointToSet()
    )
    weight = 0.01
    G = fitted.distance.local(fitted.distance.nominal).G
    root = prediction_root(scaled, fitted.distance, weight)
    covariance = np.linalg.inv(scaled.M.T @ scaled.M + weight * G.T @ G)
    rows = block.stacked()[:, :-1] * scaled.unit / scaled.size
    spread = np.trace(rows @ covariance @ rows.T) / sum(block.counts)
    assert prediction_spread(root, scaled, block, base) == pytest.approx(spread)


def test_motion_farther_from_the_data_spreads_more(logged):
    model, segments, base = logged
    _, _, log = experiment(3, joints=3, noise=0.5, samples=1200)
    faster = replace(
        log, velocity=3.0 * log.velocity, acceleration=9.0 * log.acceleration
    )
    scaled = scaled_fit(model, merged(segments), base, DEFAULT_CONSTRAINTS)
    problem = FitProblem.of(model, merged(segments), DEFAULT_CONSTRAINTS, base)
    root = prediction_root(scaled, constrained_fit(problem, None).distance, 1e-6)
    spreads = [
        prediction_spread(root, scaled, build_regression(model, motion), base)
        for motion in (log, faster)
    ]
    assert spreads[1] > 4.0 * spreads[0]


def test_one_segment_cannot_be_left_out(logged):
    _, segments, _ = logged
    with pytest.raises(ProblemError, match="1 segments, expected two"):
        folds_of(segments[:1])


def test_errors_of_folds_are_pooled_by_their_shares_of_the_rows():
    """Three segments of two folds; the second fold has no fit the second time."""
    model = TorqueModel(from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.4)]))
    folds = [SimpleNamespace(segments=(0,)), SimpleNamespace(segments=(1, 2))]
    squares = [np.array([4.0, 1.0]), np.array([9.0, 2.0]), np.array([1.0, 3.0])]
    first = [_Predicted(squares[:1], 0.5, 2.0)]
    second = [_Predicted(squares[1:], 8.0, 3.0)]
    torque, rows = np.array([100.0, 400.0]), np.array([10, 5, 25])
    found = _pooled(model, folds, [first, second], torque, rows, 1)
    shares = rows / 40.0
    expected = [
        np.sqrt(each.sum() / share / torque.sum())
        for each, share in zip(squares, shares, strict=True)
    ]
    np.testing.assert_allclose(found.errors, [expected])
    np.testing.assert_allclose(found.shares, shares)
    assert found.weights == pytest.approx([2.0])  # the geometric mean
    assert found.spreads == pytest.approx([0.25 * 2.0 + 0.75 * 3.0])
    alone = _pooled(model, folds, [first, None], torque, rows, 1)
    assert alone.weights == pytest.approx([0.5])
    assert np.isinf(alone.errors).tolist() == [[False, True, True]]


def test_a_point_between_two_fits_uses_up_the_slack_on_the_line_between_them():
    rng = np.random.default_rng(4)
    M, z = rng.normal(size=(6, 3)), rng.normal(size=6)
    free = np.linalg.lstsq(M, z, rcond=None)[0]
    best = SimpleNamespace(scaled=SimpleNamespace(M=M, z=z))

    def fit(u, weight):
        excess = float(np.sum((M @ u - z) ** 2))
        return SimpleNamespace(
            excess=excess, weight=weight, solution=SimpleNamespace(u=u)
        )

    path = [
        fit(free + step * np.array([1.0, -2.0, 0.5]), w)
        for step, w in ((1.0, 100.0), (0.3, 10.0), (0.01, 1.0))
    ]
    limit = 0.5 * (path[0].excess + path[1].excess)
    found = _between(best, path, limit)
    assert np.sum((M @ found.u - z) ** 2) == pytest.approx(limit)
    share = np.linalg.norm(found.u - path[1].solution.u) / np.linalg.norm(
        path[0].solution.u - path[1].solution.u
    )
    assert found.weight == pytest.approx(10.0 ** (1.0 + share))
    # Beyond either end, it is the end.
    for out, end in ((2.0 * path[0].excess, path[0]), (0.0, path[2])):
        point = _between(best, path, out)
        assert point.weight == end.weight and (point.u == end.solution.u).all()
