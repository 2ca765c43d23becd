"""Half-spaces that hold every possible robot: what one fit says of the next.

Where a constrained fit ends, at base parameters ``b``, its squared misfit rises towards
every possible robot: ``slope.(v - b) >= 0``, ``slope`` its gradient.  That holds of the
constraints, whatever the log.  So the misfit to another log is at least what its least
squares leaves in the half-space, which takes one triangular solve and no programme.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.constraints.cones.certificate import GAP_TOLERANCE
from consistent_id.diagnosis.channel_factors import ChannelFactors
from consistent_id.estimation.best_fit import BestFit
from consistent_id.regression.linear import DATA_RANK_TOLERANCE


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """``slope.(v - point) >= 0`` for the base parameters ``v`` of possible robots.

    Parameters
    ----------
    slope, point : ndarray, shape (base,)
    """

    slope: Vector
    point: Vector


def cuts_at(factors: ChannelFactors, fit: BestFit) -> list[Cut]:
    """Return the half-space that a log's best possible robot gives, if it is certified.

    None where constraints cost that fit nothing: its slope is rounding then.

    Parameters
    ----------
    factors : ChannelFactors
    fit : BestFit
        Of the factors, under constraints.
    """
    if fit.optimality.verdict != "certified":
        return []
    R = factors.joined()
    point = factors.base.projection @ fit.parameters
    rest = R @ np.append(point, -1.0)
    cost = float(np.sum(rest[:-1] ** 2))
    if cost <= GAP_TOLERANCE * float(np.sum(rest**2)):
        return []
    return [Cut(R[:, :-1].T @ rest, point)]


def least_within(R: Matrix, cuts: Sequence[Cut]) -> float:
    """Return the least norm of ``R [v, -1]`` in the half-space that asks for most.

    Parameters
    ----------
    R : ndarray, shape (base + 1, base + 1)
        Triangular; see `ChannelFactors.joined`.  Where it leaves base parameters open,
        half-spaces are taken to ask for nothing.
    cuts : sequence of Cut
    """
    from scipy.linalg import solve_triangular

    n = R.shape[1] - 1
    A, least = R[:n, :n], float(np.linalg.norm(R[n:, n]))
    norms = np.linalg.norm(A, axis=0)
    if len(A) < n or (abs(np.diag(A)) <= DATA_RANK_TOLERANCE * norms).any():
        return least
    free = solve_triangular(A, R[:n, n])
    beyond = [0.0]
    for cut in cuts:
        outside = float(cut.slope @ (cut.point - free))
        turned = solve_triangular(A, cut.slope, trans="T")
        if outside > 0.0:
            beyond.append(outside / float(np.linalg.norm(turned)))
    return float(np.hypot(least, max(beyond)))
