"""Random paths that violate no guard: a search from within a wall rarely succeeds.

About a pose that is clear the joints begin to swing a little; then each one's swing
grows by itself for as long as nothing is in its way.  So a joint that meets a wall soon
does not keep the others still.
"""

from collections.abc import Callable, Sequence

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.excitation.basis import FourierBasis
from consistent_id.excitation.guards import Guard
from consistent_id.excitation.limit_rows import LimitRows

_POSES = 64  # at which guards measure, if the path violates one
_KEPT = 6  # poses about which swings are tried
_RANGE = 0.8  # share of the joints' ranges in which these poses are
_SWINGS = (0.25, 0.1, 0.03, 0.01)  # shares of the swing to begin with, tried in order
_GROWTH = 1.6  # of one joint's swing at a time
_LEAST = 1.02  # growth that is not worth another look


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
    time : ndarray, shape (samples,), [s]
        When the guards measure.
    """

    def clear(candidate: Matrix) -> bool:
        if limits.largest(candidate).max() > 1.0:
            return False
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
            if clear(candidate):
                return _grown(candidate, path, clear, rng)
    return path


def _grown(
    start: Matrix,
    path: Matrix,
    clear: Callable[[Matrix], bool],
    rng: np.random.Generator,
) -> Matrix:
    """Let each joint swing further by itself, up to as far as in the given path."""
    share = np.abs(start[1:]).max(axis=0) / np.abs(path[1:]).max(axis=0)
    growth = np.full(path.shape[1], _GROWTH)
    while (growth > _LEAST).any():
        for j in rng.permutation(np.flatnonzero(growth > _LEAST)):
            wider = share.copy()
            wider[j] = min(share[j] * growth[j], 1.0)
            candidate = np.vstack([start[0], wider * path[1:]])
            if clear(candidate):
                share = wider
            else:
                growth[j] = np.sqrt(growth[j])
            if share[j] == 1.0:
                growth[j] = 1.0
    return np.vstack([start[0], share * path[1:]])


def _at_rest(offsets: Matrix, basis: FourierBasis, guards: Sequence[Guard]) -> Vector:
    """Return how far the worst guard is above what it allows, pose by pose."""
    motion: Array = np.zeros((3, *offsets.shape))
    motion[0] = basis.limits.middle + offsets * basis.limits.derivative(0)
    measures = [guard.measure(motion).max(axis=1) for guard in guards]
    return np.asarray(np.max(measures, axis=0))
