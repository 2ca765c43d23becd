"""Points near the nominal robot for several slacks at once, without proofs.

The point nearest to the nominal robot within a slack is the optimum of a penalised fit
for some weight of the distance (`nearest_within` searches for it, and proves it).  For
errors on data left out, every tenfold weight is enough: a point between two optima
satisfies the constraints, which are convex, and is chosen to use up the slack exactly.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.constraints.priors import NominalDistance
from consistent_id.estimation.best_fit import BestFit
from consistent_id.estimation.penalised import PenalisedFit, penalised_fit

_STEP = 10.0  # from one weight of the distance to the next
_STRONGEST = 1e3  # weight at which the distance counts a thousand residuals
_WEAKEST = 1e-14  # below it, rounding counts more than the distance
_GAP = 1e-6  # relative gap of a fit


class NearPoint(NamedTuple):
    """A point near the nominal robot.

    Parameters
    ----------
    u : ndarray, shape (parameters,)
        See `ScaledFit`.
    weight : float
        Of the distance: between those of the two optima beside it.
    """

    u: Vector
    weight: float


def nearest_points(
    best: BestFit, distance: NominalDistance, slacks: Sequence[float], *, first: float
) -> list[NearPoint]:
    """Return about the nearest point to nominal within each slack of the best fit.

    Parameters
    ----------
    slacks : sequence of float
        Allowed relative increases of the misfit.
    first : float
        Weight that is tried first: a power of ten.

    Raises
    ------
    InfeasibleError, SolverError
        See `constrained_least_squares`.
    """
    scaled = best.scaled
    least = scaled.excess(best.solution.u)
    # Misfits below one, a millionth of the torque, count as that: see `ScaledFit`.
    total = max(least + scaled.residual**2, 1.0)
    limits = least + ((1.0 + np.array(slacks)) ** 2 - 1.0) * total

    def fitted(weight: float, start: PenalisedFit | None = None) -> PenalisedFit:
        near = None if start is None else start.solution.u
        return penalised_fit(scaled, distance, weight, start=near, gap=_GAP)

    path = [fitted(first)]
    while path[0].excess < limits.max() and path[0].weight < _STRONGEST:
        path.insert(0, fitted(path[0].weight * _STEP, path[0]))
    while path[-1].excess > limits.min() and path[-1].weight > _WEAKEST:
        path.append(fitted(path[-1].weight / _STEP, path[-1]))
    return [_between(best, path, limit) for limit in limits]


def next_first(weights: Sequence[float]) -> float:
    """Return the weight to try first with nearly the same data and the same slacks."""
    return float(10.0 ** np.ceil(np.log10(max(weights))))


def _between(best: BestFit, path: Sequence[PenalisedFit], limit: float) -> NearPoint:
    """Return the point of a path, strongest weight first, whose excess is a limit.

    On the line from ``u`` to ``v`` the excess is ``||r + t d||^2`` with ``r = M u - z``
    and ``d = M (v - u)``.
    """
    inside = [k for k, fit in enumerate(path) if fit.excess <= limit]
    k = inside[0] if inside else len(path) - 1
    near = path[k]
    if k == 0 or not inside:
        return NearPoint(near.solution.u, near.weight)
    far = path[k - 1]
    scaled, u, step = best.scaled, near.solution.u, far.solution.u - near.solution.u
    r, d = scaled.M @ u - scaled.z, scaled.M @ step
    a, b, c = float(d @ d), float(d @ r), float(r @ r) - limit
    # The root beyond zero, without cancellation; c <= 0 and the far end is outside.
    t = -c / (b + np.sqrt(max(b * b - a * c, 0.0))) if c < 0.0 else 0.0
    t = float(np.clip(t, 0.0, 1.0))
    weight = near.weight ** (1.0 - t) * far.weight**t
    return NearPoint(u + t * step, float(weight))
