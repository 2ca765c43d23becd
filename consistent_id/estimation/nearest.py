"""The point-to-set stage: of all that fit nearly best, the nearest to nominal."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id.constraints.distances import NominalDistance
from consistent_id.errors import SolverError
from consistent_id.estimation.best_fit import BestFit
from consistent_id.estimation.penalised import PenalisedFit, penalised_fit

_WEIGHTS = 30  # weights of the prior tried, at the most,
_UNPROVEN = 5  # and without a certified fit in a row: the next proves no more
_FIRST = -12.0  # logarithm of the first weight over the slack: what real logs end near
_SLOPE = 1.2  # of the share used up over the weight, in logarithms, where it matters
_STEEPEST = 2.0  # the same far below: what a faint pull moves grows with its square
_PATIENCE = 3  # steps in one direction, after which they grow twofold each
_WIDE = 0.3  # width of a bracket in which interpolation may go astray
_BEYOND = 0.3  # by how much to step beyond what that slope says, so as to bracket
_STEP = np.log(1e3)  # by which the weight grows or shrinks, at the most
_AIM = 0.98  # share of the slack to use up, unless the proof asks for more
_HALF = 0.5  # of the allowed gap that the slack's unused rest is to cost
_LEAST = 1e-6  # share of the slack, of which less is rounding: no step hangs on it
_APART = 1e-6  # shares closer than that, in logarithms, show no curvature
_SMALL = 0.01  # squared distance that is as good as none

DISTANCE_GAP = 0.01
"""Relative gap of the squared distance (or of 0.01, if it is less) that is allowed."""


@dataclass(frozen=True, slots=True, eq=False)
class Nearest:
    """The nearest point, as the optimum of a penalised fit.

    Parameters
    ----------
    distance_gap : float
        Bound on the relative excess of its squared distance (or of 0.01, where it is
        less) over the least within the slack; infinite if its misfit exceeds that.
    allowed : float
        Squared misfit beyond the least that the slack allows, in scaled units.
    """

    fit: PenalisedFit
    distance_gap: float
    allowed: float


def nearest_within(
    best: BestFit,
    distance: NominalDistance,
    slack: float,
    *,
    first: float | None = None,
) -> Nearest:
    """Return the point nearest to nominal whose misfit is within `slack` of the best.

    A weight of the distance makes this a well-conditioned problem; its optimum ``u`` is
    the nearest point for its own misfit.  Any ``v`` within the slack has

    ``distance(v)^2 >= distance(u)^2 - (allowed - excess(u)) / weight - gap``

    and the weight is searched for until that is as good as equality: until the slack is
    used up, or the nominal robot itself fits and raising brings nothing any more.

    Where no weight keeps the misfit within the slack, which data of next to no noise
    can do to a solver, the point of the least misfit is returned, and says so.

    Parameters
    ----------
    slack : float
        Relative misfit that may be given up.
    first : float, optional
        Weight that is tried first, such as that of nearly the same data.
    """
    scaled = best.scaled
    least = scaled.excess(best.solution.u)
    allowed = ((1.0 + slack) ** 2 - 1.0) * max(least + scaled.residual**2, 1.0)
    # The proof's ball is to contain the best fit, wherever that is.
    reach = 2.0 * float(np.linalg.norm(best.solution.u - distance.nominal))
    search = _Search(
        float(np.log(allowed) + _FIRST if first is None else np.log(first))
    )
    kept: Nearest | None = None
    closest: PenalisedFit | None = None
    unproven = 0
    for _ in range(_WEIGHTS):
        start = None if kept is None else kept.fit.solution.u
        weight = float(np.exp(search.log_weight))
        found = penalised_fit(scaled, distance, weight, start=start, reach=reach)
        excess = found.excess - least
        certified = found.optimality.verdict == "certified"
        unproven = 0 if certified else unproven + 1
        if closest is None or found.excess < closest.excess:
            closest = found
        if excess <= allowed:
            short = (allowed - excess) / weight + found.distance_gap
            gap = short / max(found.squared_distance, _SMALL)
            now = Nearest(found, gap, allowed)
            if kept is None or (certified and now.distance_gap < kept.distance_gap):
                kept = now
            if kept.distance_gap <= DISTANCE_GAP or unproven >= _UNPROVEN:
                break
        # Of the proof's gap, the unused rest of the slack costs (1 - share) / worth.
        worth = weight * max(found.squared_distance, _SMALL) / allowed
        aim = max(_AIM, 1.0 - _HALF * DISTANCE_GAP * worth)
        search = search.narrowed(excess / allowed, aim)
    if kept is not None:
        return kept
    if closest is None:
        raise SolverError("no weight of the prior was tried")
    return Nearest(closest, np.inf, allowed)


class _Point(NamedTuple):
    """Logarithms of a weight and of the share of the slack that it uses."""

    weight: float
    used: float


@dataclass(frozen=True, slots=True)
class _Search:
    """For the weight whose misfit uses up the slack: bracket, then interpolate."""

    log_weight: float
    tried: tuple[_Point, ...] = ()
    widths: tuple[float, ...] = ()

    def narrowed(self, used: float, aim: float = _AIM) -> "_Search":
        """Return the next search, knowing what share of the slack a weight uses.

        It aims at a weight that uses the share `aim`.
        """
        here = _Point(self.log_weight, float(np.log(max(used, _LEAST))))
        tried = (*self.tried, here)
        low = max((p for p in tried if p.used <= 0.0), default=None)
        high = min((p for p in tried if p.used > 0.0), default=None)
        if low is None or high is None:
            step = abs(here.used) / _SLOPE + _BEYOND
            step = min(step * 2.0 ** max(len(tried) - _PATIENCE, 0), _STEP)
            if high is None:
                step = max(step, abs(here.used) / _STEEPEST)
            return _Search(self.log_weight + (step if high is None else -step), tried)
        width = high.weight - low.weight
        widths = (*self.widths, width)
        if len(widths) > 2 and width > max(0.5 * widths[-3], _WIDE):
            # Interpolation moves one end by little: the other one is too far away.
            return _Search(low.weight + 0.5 * width, tried, widths)
        weight = _interpolated(low, high, tried, float(np.log(aim)))
        weight = min(max(weight, low.weight + 0.05 * width), high.weight - 0.05 * width)
        return _Search(weight, tried, widths)


def _interpolated(
    low: _Point, high: _Point, tried: Sequence[_Point], aim: float
) -> float:
    """Return the weight that is to use a share, from the nearest three tried."""
    others = [p for p in tried if p not in (low, high)]
    points = [low, high, *sorted(others, key=lambda p: abs(p.used))[:1]]
    weights, used = np.array(points).T
    if np.diff(np.sort(used)).min() < _APART:
        weights, used = weights[:2], used[:2]
    # Lagrange's polynomial of the weight over the share.
    rest = [np.delete(used, i) for i in range(len(used))]
    share = [np.prod((aim - r) / (u - r)) for u, r in zip(used, rest, strict=True)]
    return float(weights @ np.array(share))
