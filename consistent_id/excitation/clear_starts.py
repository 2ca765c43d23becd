"""Random paths that violate no guard: a search from within a wall rarely succeeds."""

from collections.abc import Sequence

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.excitation.basis import FourierBasis
from consistent_id.excitation.guards import Guard
from consistent_id.excitation.limit_rows import LimitRows

_POSES = 64  # at which guards measure, if the path violates one
_KEPT = 6  # poses about which swings are tried
_RANGE = 0.8  # share of the joints' ranges in which these poses are
_SWINGS = (
    1.0,
    0.7,
    0.5,
    0.35,
    0.25,
    0.15,
    0.1,
    0.05,
)  # shares of the swing, tried in order


def clear_start(
    path: Matrix,
    basis: FourierBasis,
    limits: LimitRows,
    guards: Sequence[Guard],
    time: Vector,
    rng: np.random.Generator,
) -> Matrix:
    """Return a path that violates no guard: as given, or smaller, about another pose.

    If there is none among some random poses, the path is returned as it was given.

    Parameters
    ----------
    path : ndarray, shape (size, joints)
    basis : FourierBasis
    limits : LimitRows
    guards : sequence of Guard
    time : ndarray, shape (samples,), [s]
        When the guards measure.
    rng : Generator
    """

    def clear(candidate: Matrix) -> bool:
        motion = basis.motion(candidate, time)
        return all(guard.measure(motion).max() <= 0.0 for guard in guards)

    if clear(path):
        return path
    offsets = rng.uniform(-_RANGE, _RANGE, (_POSES, path.shape[1]))
    worst = _at_rest(offsets, basis, guards)
    kept = [k for k in np.argsort(worst, kind="stable")[:_KEPT] if worst[k] <= 0.0]
    for share in _SWINGS:
        for k in kept:
            candidate = np.vstack([offsets[k], share * path[1:]])
            if limits.largest(candidate).max() <= 1.0 and clear(candidate):
                return candidate
    return path


def _at_rest(offsets: Matrix, basis: FourierBasis, guards: Sequence[Guard]) -> Vector:
    """Return how far the worst guard is above what it allows, pose by pose."""
    motion: Array = np.zeros((3, *offsets.shape))
    motion[0] = basis.limits.middle + offsets * basis.limits.derivative(0)
    measures = [guard.measure(motion).max(axis=1) for guard in guards]
    return np.asarray(np.max(measures, axis=0))
