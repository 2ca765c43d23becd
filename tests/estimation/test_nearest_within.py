"""The nearest point within a slack, and the search for the weight that leads to it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from penalised_problems import noisy
from scipy.optimize import brentq

from consistent_id.constraints.cones.certificate import (
    GAP_TOLERANCE,
)
from consistent_id.constraints.priors import nominal_distance
from consistent_id.estimation import nearest
from consistent_id.estimation.best_fit import (
    REFERENCE,
    best_fit,
)
from consistent_id.estimation.nearest import (
    DISTANCE_GAP,
    _WeightedPoint,
    _WeightSearch,
    nearest_within,
)
from consistent_id.estimation.penalised import Compromise
from consistent_id.regression.base import base_parameters


@pytest.mark.parametrize("slack", [1e-3, 0.03, 0.3])
@pytest.mark.parametrize("noise", [0.01, 0.2])
def test_the_nearest_point_within_a_slack_is_that_of_ridge_regression(noise, slack):
    model, regression = noisy(3, joints=3, noise=noise)
    best = best_fit(model, regression, (), base=base_parameters(model))
    fit = best.scaled
    distance = nominal_distance(model, "pullback", fit.unit)
    G, g = distance.local(distance.nominal)

    def ridge(weight):
        A = np.vstack([fit.M, np.sqrt(weight) * G])
        return np.linalg.lstsq(A, np.append(fit.z, np.sqrt(weight) * g))[0]

    def misfit(u):
        return np.sum((fit.M @ u - fit.z) ** 2) + fit.residual**2

    limit = (1.0 + slack) ** 2 * misfit(best.solution.u)
    if misfit(distance.nominal) <= limit:
        exact = 0.0
    else:
        log = brentq(lambda log: misfit(ridge(np.exp(log))) - limit, -25.0, 15.0)
        exact = np.sum((G @ ridge(np.exp(log)) - g) ** 2)
    found = nearest_within(best, distance, slack)
    u, squared = found.fit.solution.u, found.fit.squared_distance
    assert found.slack == slack
    assert found.allowed == pytest.approx(limit - misfit(best.solution.u), rel=1e-6)
    assert misfit(u) <= limit * (1.0 + 1e-9)
    assert squared == pytest.approx(np.sum((G @ u - g) ** 2), abs=1e-12)
    assert found.distance_gap <= DISTANCE_GAP
    # A squared distance below 0.01 counts as that.
    assert exact - 1e-8 <= squared <= exact + found.distance_gap * max(squared, 0.01)


@pytest.mark.parametrize("slack", [1e-3, 3.0])
@pytest.mark.parametrize("finer", ["met", "missed", "beyond"])
def test_a_proof_that_just_suffices_is_made_finer_for_the_distance(
    monkeypatch, slack, finer
):
    """As of a solver that stops where the gap is as large as it may be."""
    model, regression = noisy(3, joints=2, noise=0.3)
    best = best_fit(model, regression, (), base=base_parameters(model))
    distance = nominal_distance(model, "pullback", best.scaled.unit)
    least = best.scaled.excess(best.solution.u) + 0.7  # as if the best fit had that
    near = nearest_within(best, distance, slack)
    fit, size = near.fit, max(near.fit.squared_distance, 0.01)
    assert (fit.squared_distance > 0.01) == (slack < 1.0)
    asked, optimum = [], Compromise.optimum

    def just(self, start=None, *, gap=GAP_TOLERANCE):
        assert np.array_equal(start, fit.solution.u)
        asked.append(gap)
        gap = 100.0 * gap if finer == "missed" else gap
        found = optimum(self, start)
        found = replace(found, excess=found.excess + 0.7)
        if finer == "beyond":
            found = replace(found, excess=least + 1.001 * near.allowed)
        return replace(found, optimality=replace(found.optimality, gap=gap))

    monkeypatch.setattr(Compromise, "optimum", just)
    enough = replace(near, distance_gap=DISTANCE_GAP)
    assert nearest._finer(best.scaled, distance, enough, least, 3.0) is enough
    coarse = replace(near, distance_gap=2.0 * DISTANCE_GAP)
    found = nearest._finer(best.scaled, distance, coarse, least, 3.0)
    (gap,) = asked
    # Half of what is allowed is for the proof, and half for what the slack leaves.
    objective = max(fit.optimality.objective, REFERENCE)
    proven = 2.0 * gap * objective / fit.weight
    assert proven == pytest.approx(DISTANCE_GAP / 2.0 * size, rel=1e-9)
    if finer == "met":
        unused = (near.allowed - (fit.excess + 0.7 - least)) / fit.weight
        expected = unused / size + DISTANCE_GAP / 2.0
        assert found.distance_gap == pytest.approx(expected, rel=1e-6)
        assert found.fit.optimality.gap == gap
        assert (found.slack, found.allowed) == (slack, near.allowed)
    else:
        assert found is coarse


@pytest.fixture(scope="module")
def two_weights():
    """Return a set of points within a slack, optima of two weights, and what is exact.

    The optimum of one weight is well within the slack, that of the other one far out.
    """
    model, regression = noisy(3, joints=3, noise=0.2)
    best = best_fit(model, regression, (), base=base_parameters(model))
    scaled = best.scaled
    distance = nominal_distance(model, "pullback", scaled.unit)
    near = nearest_within(best, distance, 0.03)
    least = scaled.excess(best.solution.u)
    within = nearest._WithinSlack(scaled, distance, least, near.allowed, 0.03)
    w = near.fit.weight
    fits = [Compromise(scaled, distance, w * s, 1e3).optimum() for s in (0.05, 20.0)]
    assert [within.holds(fit) for fit in fits] == [True, False]
    return best, within, fits, near


def test_a_point_between_two_optima_uses_up_the_slack(two_weights):
    _, within, (under, over), _ = two_weights
    u = within.between(under.solution.u, over.solution.u)
    assert within.scaled.excess(u) - within.least == pytest.approx(within.allowed)
    assert within.scaled.excess(u) - within.least <= within.allowed
    # From a point that has used it up already, there is no way to go.
    assert within.between(over.solution.u, under.solution.u) is over.solution.u


def test_its_distance_is_bounded_by_the_better_of_both_proofs(two_weights):
    _, within, fits, near = two_weights
    u = within.between(*(fit.solution.u for fit in fits))
    found = within.proven(u, fits)
    exact = near.fit.squared_distance  # to its own gap, below a hundredth
    gaps = [near.distance_gap * exact, found.distance_gap * found.fit.squared_distance]
    assert gaps[0] <= 0.01 * exact < gaps[1]
    assert exact - gaps[0] <= found.fit.squared_distance <= exact + gaps[1]
    for fit in fits:
        alone = within.proven(u, [fit])
        assert alone.distance_gap >= found.distance_gap
        # As a compromise at that weight it is worse than the optimum, by the gap.
        excess = alone.fit.excess + fit.weight * alone.fit.squared_distance
        least = fit.excess + fit.weight * fit.squared_distance
        gap = alone.fit.optimality.gap * max(alone.fit.optimality.objective, REFERENCE)
        assert excess - least <= 2.0 * gap * (1.0 + 1e-9)
    # Nothing is claimed of points outside, or without a proof that reaches so far.
    assert within.proven(fits[1].solution.u, fits) is None
    short = [replace(f, optimality=replace(f.optimality, radius=1e-3)) for f in fits]
    assert within.proven(u, short) is None


@pytest.mark.parametrize("given", [(0, 1), (1,)])
def test_points_between_optima_come_as_near_as_a_search_of_weights(two_weights, given):
    """Also if the best fit is the only point within the slack."""
    best, within, fits, near = two_weights
    nothing = replace(near, fit=fits[0], distance_gap=np.inf)
    found = nearest._between(within, best, [fits[i] for i in given], nothing, 1e3)
    assert found.distance_gap <= DISTANCE_GAP
    assert found.fit.optimality.verdict == "certified"
    assert found.fit.excess - within.least <= within.allowed
    ours, exact = found.fit.squared_distance, near.fit.squared_distance
    assert ours == pytest.approx(exact, rel=2.0 * DISTANCE_GAP)
    # Weights whose optima are all within the slack have nothing between them.
    assert nearest._between(within, best, fits[:1], nothing, 1e3) is nothing


def test_a_weight_is_sought_by_brackets_and_then_by_interpolation():
    search = _WeightSearch(5.0)
    # Upwards by the slope of 1.2, and 0.3 further; not more than a thousandfold.
    assert search.narrowed(np.exp(-2.0)).log_weight == pytest.approx(5.3 + 2.0 / 1.2)
    assert search.narrowed(np.exp(3.0)).log_weight == pytest.approx(4.7 - 3.0 / 1.2)
    assert search.narrowed(1.0).log_weight == pytest.approx(5.3)
    assert search.narrowed(1e-9).log_weight == pytest.approx(5.0 + np.log(1e3))
    assert search.narrowed(np.exp(20.0)).log_weight == pytest.approx(5.0 - np.log(1e3))
    # From the fourth step in one direction on, each is twice the one before.
    steps = []
    for _ in range(5):
        further = search.narrowed(np.exp(-0.6))
        steps.append(further.log_weight - search.log_weight)
        search = further
    assert steps == pytest.approx([0.8, 0.8, 0.8, 1.6, 3.2])


def test_within_a_bracket_a_parabola_is_taken_and_its_ends_are_kept_away_from():
    def narrowed(tried, used, widths=(), aim=0.98):
        points = tuple(_WeightedPoint(*point) for point in tried)
        return _WeightSearch(1.0, points, widths).narrowed(np.exp(used), aim)

    line = narrowed([(0.0, -1.0)], 0.5)
    assert line.log_weight == pytest.approx((1.0 + np.log(0.98)) / 1.5)
    assert line.widths == (1.0,)

    # Shares of a parabola in the weight; the farthest is left out.
    def curve(u):
        return 0.5 * u * u + 2.0 * u + 1.555

    known = [(curve(u), u) for u in (-0.4, 0.5, -1.5)]
    bent = narrowed([*known, (-9.0, -5.0)], -0.3, aim=0.9)
    assert bent.log_weight == pytest.approx(curve(np.log(0.9)))
    # An end is kept away from by a twentieth of the width.
    assert narrowed([(0.0, -30.0)], 1e-3).log_weight == pytest.approx(0.95)
    assert narrowed([(0.0, -1e-3)], 9.0).log_weight == pytest.approx(0.05)
    # A third width that is not half of the first is halved; but not if it is small.
    for widths, halved in (((1.9, 1.5), True), ((2.1, 1.5), False)):
        found = narrowed([(0.0, -1.0)], 0.5, widths)
        assert (found.log_weight == 0.5) is halved
    assert narrowed([(0.71, -1.0)], 0.5, (0.3, 0.3)).log_weight != 0.71 + 0.29 / 2
    assert narrowed([(0.69, -1.0)], 0.5, (0.3, 0.3)).log_weight == 0.69 + 0.31 / 2


@pytest.fixture
def search(monkeypatch):
    """Search for a weight with stated optima; returns what was asked, and the result.

    Of a weight ``w``, the misfit is ``4 + 9 w^2``, the squared distance ``2 / w``.
    """

    def run(verdicts, slack=0.5, gap=0.0, grows=9.0):
        asked, verdicts = [], iter(verdicts)

        def compromise(scaled, distance, weight, reach):
            def optimum(start, **finer):
                asked.append((weight, reach, start))
                return SimpleNamespace(
                    excess=4.0 + grows * weight**2,
                    squared_distance=2.0 / weight,
                    weight=weight,
                    distance_gap=gap,
                    solution=SimpleNamespace(u=len(asked)),
                    optimality=SimpleNamespace(verdict=next(verdicts), objective=1.0),
                )

            return SimpleNamespace(optimum=optimum)

        monkeypatch.setattr(nearest, "Compromise", compromise)
        scaled = SimpleNamespace(excess=lambda u: 4.0, residual=1.5)
        u, nominal = np.array([1.0, 2.0]), np.array([4.0, 6.0])
        best = SimpleNamespace(scaled=scaled, solution=SimpleNamespace(u=u))
        distance = SimpleNamespace(nominal=nominal)
        return asked, nearest_within(best, distance, slack)

    return run


def test_a_weight_is_sought_whose_misfit_uses_up_the_slack(search):
    asked, found = search(["certified"] * 99)
    allowed = 1.25 * 6.25
    assert found.allowed == pytest.approx(allowed)
    w = found.fit.weight
    assert 9.0 * w**2 <= allowed
    assert found.distance_gap == pytest.approx((allowed - 9.0 * w**2) / w / (2.0 / w))
    assert found.distance_gap <= DISTANCE_GAP
    # Proofs hold twice as far as the nominal robot is from the best fit.
    assert {reach for _, reach, _ in asked} == {10.0}
    assert asked[0][::2] == (pytest.approx(allowed * np.exp(-12.0)), None)
    assert asked[1][2] == 1  # from the point before


@pytest.mark.parametrize(("proven", "tries"), [("", 5), ("y", 6), ("nny", 8)])
def test_a_search_ends_after_five_fits_without_a_proof(search, proven, tries):
    """And one more, finer, whose distance is not proven either."""
    verdicts = ["certified" if p == "y" else "uncertified" for p in proven.ljust(99)]
    asked, _ = search(verdicts, gap=1e3, grows=0.0)
    assert len(asked) == tries + 1
    assert len({weight for weight, *_ in asked}) == tries
