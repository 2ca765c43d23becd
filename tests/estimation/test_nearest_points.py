"""Points for several slacks at once are nearly those that are proven one by one."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment

from consistent_id import build_regression
from consistent_id.constraints import PointToSet
from consistent_id.constraints.priors import nominal_distance
from consistent_id.estimation.best_fit import FitProblem
from consistent_id.estimation.constrained_fit import DEFAULT_CONSTRAINTS, best_inside
from consistent_id.estimation.left_out import nearest_points, next_first
from consistent_id.estimation.nearest import nearest_within
from consistent_id.regression import base_parameters

SLACKS = (1e-4, 0.003, 0.05)  # the last one reaches the nominal robot


SLOW = pytest.param("entropic", marks=pytest.mark.slow)


@pytest.fixture(scope="module", params=["pullback", SLOW])
def fitted(request):
    model, _, log = experiment(5, joints=4, noise=5.0, samples=300)
    base = base_parameters(model)
    regression = build_regression(model, log)
    problem = FitProblem.of(model, regression, DEFAULT_CONSTRAINTS, base)
    best = best_inside(problem, PointToSet().inside).best
    return best, nominal_distance(model, request.param, best.scaled.unit)


@pytest.mark.parametrize("first", [1.0, 1e-6, 100.0])
def test_they_use_up_the_slack_and_are_nearly_as_near(fitted, first):
    best, distance = fitted
    scaled = best.scaled
    total = scaled.excess(best.solution.u) + scaled.residual**2
    points = nearest_points(best, distance, SLACKS, first=first)
    for slack, point in zip(SLACKS, points, strict=True):
        misfit = np.sqrt((scaled.excess(point.u) + scaled.residual**2) / total)
        proven = nearest_within(best, distance, slack).fit
        assert misfit <= 1.0 + slack + 1e-9
        assert scaled.domain.violation(point.u) < 1e-6
        # A squared distance below 0.01 counts as none, as in the proof.
        assert distance.squared(point.u) <= 1.5 * proven.squared_distance + 0.01
        if proven.squared_distance > 0.01:
            assert misfit == pytest.approx(1.0 + slack, rel=0.01 * slack)
            assert 0.1 < point.weight / proven.weight < 10.0


@pytest.mark.parametrize("slack", [1e-4, 1e-3])
def test_the_slack_is_a_share_of_the_whole_misfit(fitted, slack):
    best, distance = fitted
    large = replace(best, scaled=replace(best.scaled, residual=3.0))
    (point,) = nearest_points(large, distance, (slack,), first=1e-4)
    excess = large.scaled.excess(best.solution.u)
    used = (large.scaled.excess(point.u) - excess) / (excess + 9.0)
    assert used == pytest.approx((1.0 + slack) ** 2 - 1.0, rel=0.02)


def test_the_next_fit_begins_above_the_highest_weight():
    assert next_first([3e-7, 2e-3]) == pytest.approx(1e-2)
