"""The point-to-set stage: of all that fit nearly best, the nearest to nominal."""

from dataclasses import dataclass

import numpy as np

from consistent_id.distances import NominalDistance
from consistent_id.errors import SolverError
from consistent_id.estimators.best_fit import BestFit
from consistent_id.estimators.penalised import PenalisedFit, penalised_fit

_WEIGHTS = 20  # weights of the prior tried, at the most
_STEP = np.log(30.0)  # by which the weight grows or shrinks until it is bracketed
_STILL = 0.01  # change of the robot, in distances, below which a weight is enough
_USED = 0.5  # share of the slack that must be used up


@dataclass(frozen=True, slots=True, eq=False)
class Nearest:
    """The nearest point, as the optimum of a penalised fit.

    Parameters
    ----------
    fit : PenalisedFit
    share : float
        Bound on the relative excess of its squared distance (or of 0.01, where it is
        less) over the least for its misfit; infinite if its misfit exceeds the slack.
    """

    fit: PenalisedFit
    share: float


def nearest_within(best: BestFit, distance: NominalDistance, slack: float) -> Nearest:
    """Return the point nearest to nominal whose misfit is within `slack` of the best.

    The weight of the distance is raised until the misfit uses up the slack, or the
    nominal robot fits within it and raising brings nothing any more.  The optimum for a
    weight is the nearest point for its own misfit, and, unlike a bound on the misfit,
    it is a well-conditioned problem.

    Where no weight keeps the misfit within the slack, which data of next to no noise
    can do to a solver, the point of the least misfit is returned, and says so.
    """
    scaled = best.scaled
    least = scaled.excess(best.solution.u)
    total = least + scaled.residual**2
    allowed = ((1.0 + slack) ** 2 - 1.0) * max(total, 1.0)
    low, high = -np.inf, np.inf
    log_weight = np.log(allowed)
    kept: PenalisedFit | None = None
    closest: PenalisedFit | None = None
    # The proof's ball is to contain the best fit, wherever that is.
    reach = 2.0 * float(np.linalg.norm(best.solution.u - distance.nominal))
    for _ in range(_WEIGHTS):
        start = None if kept is None else kept.solution.u
        found = penalised_fit(
            scaled, distance, float(np.exp(log_weight)), start=start, reach=reach
        )
        excess = found.excess - least
        if closest is None or found.excess < closest.excess:
            closest = found
        if excess <= allowed:
            moved = np.inf
            if kept is not None:
                at = kept.solution.u
                step = distance.local(at).G @ (found.solution.u - at)
                moved = float(np.linalg.norm(step))
            settled = excess >= _USED * allowed or moved <= _STILL
            if kept is None or found.optimality.verdict == "certified":
                kept, low = found, log_weight
            if settled:
                break
        else:
            high = log_weight
        if np.isinf(low) or np.isinf(high):
            log_weight += _STEP if np.isinf(high) else -_STEP
        else:
            log_weight = (low + high) / 2
    if kept is not None:
        return Nearest(kept, kept.distance_gap / max(kept.squared_distance, _STILL))
    if closest is None:
        raise SolverError("no weight of the prior was tried")
    return Nearest(closest, np.inf)
