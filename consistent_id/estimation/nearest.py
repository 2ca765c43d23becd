"""The point-to-set stage: of all that fit nearly best, the nearest to nominal."""

from dataclasses import dataclass

import numpy as np

from consistent_id.constraints.distances import NominalDistance
from consistent_id.errors import SolverError
from consistent_id.estimation.best_fit import BestFit
from consistent_id.estimation.penalised import PenalisedFit, penalised_fit

_WEIGHTS = 30  # weights of the prior tried, at the most
_STEP = np.log(30.0)  # by which the weight grows or shrinks until it is bracketed
_AIM = np.log(0.997)  # share of the slack to use up
_SMALL = 0.01  # squared distance that is as good as none

DISTANCE_GAP = 0.01
"""Relative gap of the squared distance (or of 0.01, if it is less) that is allowed."""


@dataclass(frozen=True, slots=True, eq=False)
class Nearest:
    """The nearest point, as the optimum of a penalised fit.

    Parameters
    ----------
    fit : PenalisedFit
    distance_gap : float
        Bound on the relative excess of its squared distance (or of 0.01, where it is
        less) over the least within the slack; infinite if its misfit exceeds that.
    allowed : float
        Squared misfit beyond the least that the slack allows, in scaled units.
    """

    fit: PenalisedFit
    distance_gap: float
    allowed: float


def nearest_within(best: BestFit, distance: NominalDistance, slack: float) -> Nearest:
    """Return the point nearest to nominal whose misfit is within `slack` of the best.

    A weight of the distance makes this a well-conditioned problem; its optimum ``u`` is
    the nearest point for its own misfit.  Any ``v`` within the slack has

    ``distance(v)^2 >= distance(u)^2 - (allowed - excess(u)) / weight - gap``

    and the weight is searched for until that is as good as equality: until the slack is
    used up, or the nominal robot itself fits and raising brings nothing any more.

    Where no weight keeps the misfit within the slack, which data of next to no noise
    can do to a solver, the point of the least misfit is returned, and says so.
    """
    scaled = best.scaled
    least = scaled.excess(best.solution.u)
    allowed = ((1.0 + slack) ** 2 - 1.0) * max(least + scaled.residual**2, 1.0)
    # The proof's ball is to contain the best fit, wherever that is.
    reach = 2.0 * float(np.linalg.norm(best.solution.u - distance.nominal))
    search = _Search(np.log(allowed))
    kept: Nearest | None = None
    closest: PenalisedFit | None = None
    for _ in range(_WEIGHTS):
        start = None if kept is None else kept.fit.solution.u
        weight = float(np.exp(search.log_weight))
        found = penalised_fit(scaled, distance, weight, start=start, reach=reach)
        excess = found.excess - least
        if closest is None or found.excess < closest.excess:
            closest = found
        if excess <= allowed:
            short = (allowed - excess) / weight + found.distance_gap
            gap = short / max(found.squared_distance, _SMALL)
            now = Nearest(found, gap, allowed)
            certified = found.optimality.verdict == "certified"
            if kept is None or (certified and now.distance_gap < kept.distance_gap):
                kept = now
            if kept.distance_gap <= DISTANCE_GAP:
                break
        search = search.narrowed(excess / allowed)
    if kept is not None:
        return kept
    if closest is None:
        raise SolverError("no weight of the prior was tried")
    return Nearest(closest, np.inf, allowed)


@dataclass(frozen=True, slots=True)
class _Search:
    """For the weight whose misfit uses up the slack: bracket, then interpolate."""

    log_weight: float
    low: tuple[float, float] | None = None
    high: tuple[float, float] | None = None

    def narrowed(self, used: float) -> "_Search":
        """Return the next search, knowing what share of the slack a weight uses."""
        here = (self.log_weight, float(np.log(max(used, 1e-12))))
        low, high = (here, self.high) if used <= 1.0 else (self.low, here)
        if low is None:
            return _Search(self.log_weight - _STEP, low, high)
        if high is None:
            return _Search(self.log_weight + _STEP, low, high)
        # Nearly a power law; aimed a little below, so as not to miss from above.
        slope = (high[1] - low[1]) / (high[0] - low[0])
        aim = low[0] + (_AIM - low[1]) / max(slope, 1e-12)
        width = high[0] - low[0]
        aim = min(max(aim, low[0] + 0.05 * width), high[0] - 0.05 * width)
        return _Search(aim, low, high)
