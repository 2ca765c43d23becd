"""One robot's part in a fleet: its regression without what is its own.

Of a joint's rows ``[Y_o Y_s tau]`` let ``U`` span the own columns.  What the own
parameters can explain, ``U^T [Y_o Y_s tau]``, is kept aside in as many rows as there
are own parameters; the rest, orthogonal to ``U``, is an ordinary regression of the
shared parameters.  The sum of both squares is that of the whole, for all parameters.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import InfeasibleError
from consistent_id.problems.fleet.fleet_model import FleetModel, OwnSet
from consistent_id.regression.correlated_noise import CorrelatedNoise
from consistent_id.regression.linear import DATA_RANK_TOLERANCE
from consistent_id.regression.noise import joint_noise
from consistent_id.regression.regression import Regression, triangle

_RANK = 1e-10  # relative singular value that is rounding
_SILENT = 1e-12  # norm of a column, relative to the largest, that is rounding
_ROUNDING = 1e-9  # relative violation that is


@dataclass(frozen=True, eq=False)
class RobotShare:
    """One robot's part.

    Parameters
    ----------
    shared : Regression
        Of the shared parameters, its `sigma` the robot's own noise.
    own : tuple of ndarray, each shape (rank, own + shared + 1)
        ``[A B t]``: the own parameters ``y`` add ``||A y + B x - t||^2`` to the squared
        misfit, joint by joint, [N m or N].
    torque : float, [N m or N]
        Norm of the torque of all joints.
    alone : float, [N m or N]
        Norm of what least squares of this robot alone leaves.
    level : ndarray, shape (joints,), [N m or N]
        White noise that does as much to parameters as each joint's.
    """

    name: str
    shared: Regression
    own: tuple[Matrix, ...]
    torque: float
    alone: float
    level: Vector


def robot_share(name: str, fleet: FleetModel, regression: Regression) -> RobotShare:
    """Take a robot's own parameters out of its regression."""
    sigma = joint_noise(fleet.whole, regression, base=fleet.base)
    factors, own, scores = [], [], []
    for j, mine in enumerate(fleet.own):
        F = regression.factors[j]
        A, B = F[:, mine], F[:, [*fleet.common, -1]]
        U = span(A)
        taken = U.T @ B
        own.append(np.hstack([U.T @ A, taken]))
        factors.append(triangle(np.asfortranarray(B - U @ taken)))
        if regression.noise is not None:
            N = regression.noise.scores[j]
            C = np.linalg.pinv(U.T @ A) @ taken[:, :-1]
            scores.append(N[:, fleet.common] - N[:, mine] @ C)
    noise = regression.noise
    shared = Regression(
        layout=fleet.shared.layout,
        joints=regression.joints,
        factors=tuple(factors),
        counts=regression.counts,
        sigma=sigma,
        fingerprint=fleet.shared.fingerprint,
        noise=None
        if noise is None
        else CorrelatedNoise(noise.effective, tuple(scores)),
        peaks=regression.peaks,
    )
    counts = np.array(regression.counts, dtype=np.float64)
    columns = [*fleet.base.independent, -1]
    rows = np.vstack([F[:, columns] for F in regression.factors])
    R = triangle(np.asfortranarray(rows))
    return RobotShare(
        name=name,
        shared=shared,
        own=tuple(own),
        torque=float(np.linalg.norm(regression.torque_rms * np.sqrt(counts))),
        alone=float(abs(R[-1, -1])) if len(R) == R.shape[1] else 0.0,
        level=sigma * np.sqrt(regression.correlation),
    )


def span(A: Matrix) -> Matrix:
    """Return orthonormal columns that span those of a matrix, up to rounding."""
    norms = np.linalg.norm(A, axis=0)
    heard = norms > _SILENT * norms.max(initial=0.0)
    U, s, _ = np.linalg.svd(A[:, heard] / norms[heard], full_matrices=False)
    return U[:, s > DATA_RANK_TOLERANCE * s.max(initial=1e-300)]


@dataclass(frozen=True, eq=False)
class OwnFit:
    """A joint's own parameters, and which of their bounds hold them.

    Parameters
    ----------
    values : ndarray, shape (own,)
    bound : tuple of int
        Rows of ``A_in y <= b_in`` that are reached and would be passed.
    """

    values: Vector
    bound: tuple[int, ...]


def own_fit(rows: Matrix, shared: Vector, limits: OwnSet) -> OwnFit:
    """Return the own parameters that fit best beside given shared ones.

    A convex programme with a handful of rows: the first set of them that satisfies the
    optimality conditions is the answer.

    Parameters
    ----------
    rows : ndarray, shape (rank, own + shared + 1)
        See `RobotShare.own`.
    shared : ndarray, shape (shared,)

    Raises
    ------
    InfeasibleError
        If no own parameters satisfy the limits.
    """
    size = rows.shape[1] - len(shared) - 1
    A, t = rows[:, :size], rows[:, -1] - rows[:, size:-1] @ shared
    for number in range(min(size, len(limits.b_in)) + 1):
        for bound in combinations(range(len(limits.b_in)), number):
            y0, Z = _held(limits, bound)
            y = y0 + Z @ np.linalg.lstsq(A @ Z, t - A @ y0, rcond=_RANK)[0]
            inside = limits.A_in @ y - limits.b_in <= _ROUNDING * (1.0 + abs(y).max())
            if inside.all() and _pushed(A.T @ (A @ y - t), limits, bound):
                return OwnFit(y, bound)
    raise InfeasibleError("no friction and offsets of a joint satisfy the constraints")


def bound_rows(rows: Matrix, shared: int, limits: OwnSet, fit: OwnFit) -> Matrix:
    """Return what own parameters cannot explain while they are held at their bounds.

    Returns
    -------
    ndarray, shape (any, shared + 1)
        Rows of the shared parameters and torque.
    """
    size = rows.shape[1] - shared - 1
    y0, Z = _held(limits, fit.bound)
    U = span(rows[:, :size] @ Z)
    rest = rows[:, size:].copy()
    rest[:, -1] -= rows[:, :size] @ y0
    return np.asarray(rest - U @ (U.T @ rest))


def _held(limits: OwnSet, bound: tuple[int, ...]) -> tuple[Vector, Matrix]:
    """Return a point at the bounds, and the steps along them, as columns."""
    E = np.vstack([limits.A_eq, limits.A_in[list(bound)]])
    e = np.append(limits.b_eq, limits.b_in[list(bound)])
    U, s, Vt = np.linalg.svd(E)
    rank = int((s > _RANK).sum())
    y0 = Vt[:rank].T @ ((U[:, :rank].T @ e) / s[:rank])
    return y0, Vt[rank:].T


def _pushed(gradient: Vector, limits: OwnSet, bound: tuple[int, ...]) -> bool:
    """Return whether the misfit would fall beyond each bound, not inside it."""
    if not bound:
        return True
    E = np.vstack([limits.A_eq, limits.A_in[list(bound)]])
    pulls = np.linalg.lstsq(E.T, -gradient, rcond=_RANK)[0][len(limits.b_eq) :]
    return bool((pulls >= -_ROUNDING * (1.0 + abs(gradient).max())).all())
