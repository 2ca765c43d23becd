"""The point nearest to nominal among all that fit nearly best, certified.

``minimise distance(u)^2  subject to  ||M u - z||^2 <= least + allowed`` over the
constraints.

A weight of the distance makes this a compromise (`Compromise`), which is well
conditioned.  Its optimum for a weight ``w`` bounds the distance of every ``v`` within
the slack:

``distance(v)^2 >= distance(u)^2 - (allowed - excess(u)) / w - gap``

The weight is searched for until the optimum itself is as near as that
(`nearest_within`).  Where the data determine a combination of parameters and no robot
has its value, the optimum is the same for many weights and then moves far for hardly
any change: no weight's optimum uses up the slack.  A point between two of them does,
as the set is convex, and is as good a compromise at the weight at which both are
(`_between`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.constraints.cones.certificate import (
    FEASIBILITY_TOLERANCE,
    GAP_TOLERANCE,
    RADIUS,
)
from consistent_id.constraints.priors import NominalDistance
from consistent_id.errors import ConsistentIdError
from consistent_id.estimation.best_fit import REFERENCE, BestFit, ScaledFit
from consistent_id.estimation.penalised import Compromise, PenalisedFit

_WEIGHTS = 30  # weights of the prior tried, at most,
_UNPROVEN = 5  # and without a certified fit in a row: the next proves no more
_FIRST = -12.0  # logarithm of the first weight over the slack; typical of real logs
_SLOPE = 1.2  # of the used share over the weight, in logarithms, near the solution
_STEEPEST = 2.0  # the same far below: the effect of a weak prior grows with its square
_PATIENCE = 3  # steps in one direction, after which they grow twofold each
_WIDE = 0.3  # width of a bracket in which interpolation may go astray
_BEYOND = 0.3  # by how much to step beyond what that slope says, so as to bracket
_STEP = np.log(1e3)  # by which the weight grows or shrinks, at the most
_AIM = 0.98  # share of the slack to use up, unless the proof needs more
_HALF = 0.5  # share of the allowed gap for the slack's unused rest
_LEAST = 1e-6  # share of the slack below which differences are rounding
_APART = 1e-6  # shares closer than that, in logarithms, show no curvature
_ROUNDING = float(np.finfo(float).eps)  # relative, of a squared misfit
_SMALL = 0.01  # squared distance that counts as zero

_CROSSINGS = 12  # weights tried between two whose optima are far apart
_SHARE = 1.0 - 1e-9  # of the slack, that a point between them uses up

DISTANCE_GAP = 0.01
"""Relative gap of the squared distance (or of 0.01, if it is less) that is allowed."""


@dataclass(frozen=True, slots=True, eq=False)
class NearestFit:
    """The nearest point, as the optimum of a penalised fit.

    Parameters
    ----------
    fit : PenalisedFit
        Its proof is for its own weight, even if it is a point between two optima.
    slack : float
        Allowed relative increase of the misfit.
    distance_gap : float
        Bound on the relative excess of its squared distance (or of 0.01, where it is
        less) over the least within the slack; infinite if its misfit exceeds that.
    allowed : float
        Squared misfit beyond the least that the slack allows, in scaled units.
    """

    fit: PenalisedFit
    slack: float
    distance_gap: float
    allowed: float


def nearest_within(
    best: BestFit, distance: NominalDistance, slack: float
) -> NearestFit:
    """Return the point nearest to nominal whose misfit is within `slack` of the best.

    The weight of the distance is searched for until the bound of `_WithinSlack` is as
    good as equality: until the slack is used up, or the nominal robot itself fits and a
    larger weight changes nothing.  If this fails, points between those found are tried.

    If no weight keeps the misfit within the slack, which can happen with data of hardly
    any noise, and no point between does, the point of the least misfit is returned,
    with an infinite gap.

    Parameters
    ----------
    slack : float
        Allowed relative increase of the misfit.
    """
    scaled = best.scaled
    least = scaled.excess(best.solution.u)
    # (1 + slack)^2 - 1 in a form that keeps the digits of a small slack.  What is less
    # than rounding of the misfit cannot be used up.
    increase = max(slack * (2.0 + slack), _ROUNDING)
    allowed = increase * max(least + scaled.residual**2, 1.0)
    # The proof's ball must contain the best fit.
    reach = 2.0 * float(np.linalg.norm(best.solution.u - distance.nominal))
    within = _WithinSlack(scaled, distance, least, allowed, slack)
    tried: list[PenalisedFit] = []
    search = _WeightSearch(float(np.log(allowed) + _FIRST))
    kept: NearestFit | None = None
    unproven = 0
    for _ in range(_WEIGHTS):
        start = None if kept is None else kept.fit.solution.u
        weight = float(np.exp(search.log_weight))
        found = Compromise(scaled, distance, weight, reach).optimum(start)
        tried.append(found)
        excess = found.excess - least
        certified = found.optimality.verdict == "certified"
        unproven = 0 if certified else unproven + 1
        if excess <= allowed:
            now = _near(found, excess, slack, allowed)
            if kept is None or (certified and now.distance_gap < kept.distance_gap):
                kept = now
            if kept.distance_gap <= DISTANCE_GAP or unproven >= _UNPROVEN:
                break
        # Of the proof's gap, the unused rest of the slack costs (1 - share) / worth.
        worth = weight * max(found.squared_distance, _SMALL) / allowed
        aim = max(_AIM, 1.0 - _HALF * DISTANCE_GAP * worth)
        search = search.narrowed(excess / allowed, aim)
    if kept is not None:
        kept = _finer(scaled, distance, kept, least, reach)
        if kept.distance_gap <= DISTANCE_GAP:
            return kept
    closest = min(tried, key=lambda fit: fit.excess)
    least_so_far = kept or NearestFit(closest, slack, np.inf, allowed)
    return _between(within, best, tried, least_so_far, reach)


def _finer(
    scaled: ScaledFit,
    distance: NominalDistance,
    kept: NearestFit,
    least: float,
    reach: float,
) -> NearestFit:
    """Return the point solved once more, if a smaller gap would prove its distance.

    A certified optimum is a small part of the misfit away from the least; of the
    distance, which has a small weight, that may be a large part.
    """
    if kept.distance_gap <= DISTANCE_GAP:
        return kept
    fit = kept.fit
    objective = max(fit.optimality.objective, REFERENCE)
    worth = fit.weight * max(fit.squared_distance, _SMALL)
    gap = _HALF * DISTANCE_GAP * worth / (2.0 * objective)
    problem = Compromise(scaled, distance, fit.weight, reach)
    found = problem.optimum(fit.solution.u, gap=gap)
    excess = found.excess - least
    if excess > kept.allowed:
        return kept
    now = _near(found, excess, kept.slack, kept.allowed)
    return min(kept, now, key=lambda near: near.distance_gap)


def _near(
    found: PenalisedFit, excess: float, slack: float, allowed: float
) -> NearestFit:
    """Return a fit with the proof of its distance, given its use of the slack."""
    short = (allowed - excess) / found.weight + found.distance_gap
    gap = short / max(found.squared_distance, _SMALL)
    return NearestFit(found, slack, gap, allowed)


@dataclass(frozen=True, slots=True, eq=False)
class _WithinSlack:
    """The set of points whose misfit is within the slack.

    Parameters
    ----------
    least, allowed : float
        Least squared misfit, and what the slack allows beyond it, in scaled units.
    slack : float
        The same, relative, of the misfit.
    """

    scaled: ScaledFit
    distance: NominalDistance
    least: float
    allowed: float
    slack: float

    def holds(self, fit: PenalisedFit) -> bool:
        """Return whether a compromise is in the set."""
        return fit.excess - self.least <= self.allowed

    def bound(self, fit: PenalisedFit) -> float:
        """Return a lower bound of the squared distance in the set, from a compromise.

        It is valid wherever the compromise's own proof is.
        """
        beyond = (fit.excess - self.least - self.allowed) / fit.weight
        return fit.squared_distance + beyond - fit.distance_gap

    def between(self, under: Vector, over: Vector) -> Vector:
        """Return the point of the line from `under`, inside, to `over` on the edge."""
        M, z = self.scaled.M, self.scaled.z
        residual, change = M @ under - z, M @ (over - under)
        left = self.least + _SHARE * self.allowed - float(residual @ residual)
        if left <= 0.0:
            return under
        # The squared misfit grows by 2 t slope + t^2 bend.
        slope, bend = float(residual @ change), float(change @ change)
        root = slope + float(np.sqrt(slope**2 + bend * left))
        share = min(left / root, 1.0) if root > 0.0 else 1.0
        return self.scaled.domain.snapped(under + share * (over - under))

    def proven(self, u: Vector, fits: Sequence[PenalisedFit]) -> NearestFit | None:
        """Return a point with the best of the bounds of compromises; None if outside.

        The bound is one of the compromise at a weight, too: the point's misfit and
        distance exceed the least compromise by no more than the gap.
        """
        excess, squared = self.scaled.excess(u), self.distance.squared(u)
        away = RADIUS * float(np.linalg.norm(u - self.distance.nominal))
        sure = [fit for fit in fits if fit.optimality.radius >= away]
        violation = self.scaled.domain.violation(u)
        outside = (
            excess - self.least > self.allowed or violation > FEASIBILITY_TOLERANCE
        )
        if outside or not sure or not np.isfinite(squared):
            return None
        best = max(sure, key=self.bound)
        old = best.optimality
        objective = (excess + best.weight * squared) / 2.0
        lower = old.objective - old.gap * max(old.objective, REFERENCE)
        gap = max(objective - lower, 0.0) / max(objective, REFERENCE)
        proof = replace(old, objective=objective, gap=gap, violation=violation)
        fit = PenalisedFit(
            replace(best.solution, u=u), proof, excess, squared, best.weight
        )
        short = max(squared - self.bound(best), 0.0) / max(squared, _SMALL)
        return NearestFit(fit, self.slack, short, self.allowed)


class _End(NamedTuple):
    """An end of a line of points: its place, squared misfit and squared distance."""

    u: Vector
    excess: float
    squared: float


def _end(fit: PenalisedFit) -> _End:
    return _End(fit.solution.u, fit.excess, fit.squared_distance)


def _between(
    within: _WithinSlack,
    best: BestFit,
    tried: Sequence[PenalisedFit],
    kept: NearestFit,
    reach: float,
) -> NearestFit:
    """Return the nearest point between two optima, if it is better than the one `kept`.

    One of the optima is within the slack (or is the best fit), one beyond.  The next
    weight is the one at which both are equally good compromises: if it has no better
    one, all points between them are optimal; else this replaces one of them.
    """
    distance, fits = within.distance, list(tried)
    if all(within.holds(fit) for fit in fits):
        return kept  # no weight is too large
    squared = distance.squared(best.solution.u)
    start = _End(best.solution.u, within.least, squared)
    for _ in range(_CROSSINGS):
        inside = [_end(f) for f in fits if within.holds(f) and _feasible(f)]
        under = min([start, *inside], key=lambda end: end.squared)
        # Optima that are not exact enough for their difference are left out.
        beyond = [_end(f) for f in fits if not within.holds(f) and _feasible(f)]
        beyond = [end for end in beyond if end.squared < under.squared]
        if beyond and np.isfinite(under.squared):
            over = min(beyond, key=lambda end: end.excess)
            now = within.proven(within.between(under.u, over.u), fits)
            kept = min(kept, now or kept, key=lambda near: near.distance_gap)
            weight = (over.excess - under.excess) / (under.squared - over.squared)
        else:
            over, weight = under, 2.0 * max(f.weight for f in fits)
        if _is_proven(kept):
            break
        worth = weight * max(over.squared, _SMALL)
        objective = max((under.excess + weight * under.squared) / 2.0, REFERENCE)
        gap = min(_HALF * DISTANCE_GAP * worth / (2.0 * objective), GAP_TOLERANCE)
        ends = np.array([under.u, over.u]) - distance.nominal
        furthest = RADIUS * float(np.linalg.norm(ends, axis=1).max())
        problem = Compromise(within.scaled, distance, weight, max(reach, furthest))
        try:
            fits.append(problem.optimum(under.u, gap=gap))
        except ConsistentIdError:
            break  # what is kept says how well it is proven
    return kept


def _feasible(fit: PenalisedFit) -> bool:
    return fit.optimality.violation <= FEASIBILITY_TOLERANCE


def _is_proven(near: NearestFit) -> bool:
    certified = near.fit.optimality.verdict == "certified"
    return certified and near.distance_gap <= DISTANCE_GAP


class _WeightedPoint(NamedTuple):
    """Logarithms of a weight and of the share of the slack that it uses."""

    weight: float
    used: float


@dataclass(frozen=True, slots=True)
class _WeightSearch:
    """Search for the weight whose misfit uses up the slack: bracket, interpolate."""

    log_weight: float
    tried: tuple[_WeightedPoint, ...] = ()
    widths: tuple[float, ...] = ()

    def narrowed(self, used: float, aim: float = _AIM) -> "_WeightSearch":
        """Return the next search, given the share of the slack that a weight uses.

        It aims at a weight that uses the share `aim`.
        """
        here = _WeightedPoint(self.log_weight, float(np.log(max(used, _LEAST))))
        tried = (*self.tried, here)
        low = max((p for p in tried if p.used <= 0.0), default=None)
        high = min((p for p in tried if p.used > 0.0), default=None)
        if low is None or high is None:
            step = abs(here.used) / _SLOPE + _BEYOND
            step = min(step * 2.0 ** max(len(tried) - _PATIENCE, 0), _STEP)
            if high is None:
                step = max(step, abs(here.used) / _STEEPEST)
            further = step if high is None else -step
            return _WeightSearch(self.log_weight + further, tried)
        width = high.weight - low.weight
        widths = (*self.widths, width)
        if len(widths) > 2 and width > max(0.5 * widths[-3], _WIDE):
            # Interpolation moves one end only a little: the other end is too far away.
            return _WeightSearch(low.weight + 0.5 * width, tried, widths)
        weight = _interpolated(low, high, tried, float(np.log(aim)))
        weight = min(max(weight, low.weight + 0.05 * width), high.weight - 0.05 * width)
        return _WeightSearch(weight, tried, widths)


def _interpolated(
    low: _WeightedPoint,
    high: _WeightedPoint,
    tried: Sequence[_WeightedPoint],
    aim: float,
) -> float:
    """Return the weight expected to use a share, from the nearest three tried."""
    others = [p for p in tried if p not in (low, high)]
    points = [low, high, *sorted(others, key=lambda p: abs(p.used))[:1]]
    weights, used = np.array(points).T
    if np.diff(np.sort(used)).min() < _APART:
        weights, used = weights[:2], used[:2]
    # Lagrange's polynomial of the weight over the share.
    rest = [np.delete(used, i) for i in range(len(used))]
    share = [np.prod((aim - r) / (u - r)) for u, r in zip(used, rest, strict=True)]
    return float(weights @ np.array(share))
