"""Random paths that violate no guard, from which searches start.

From within a wall a search rarely succeeds.  The joints begin to swing slightly about a
clear pose; then the amplitude of each joint grows separately until a body is in its
way.  So a joint near a wall does not limit the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.excitation.basis import FourierBasis, LimitRows
from consistent_id.excitation.clear_poses import cleared, worst_excess
from consistent_id.excitation.guards import Guard
from consistent_id.excitation.work import Meter

_POSES = 64  # share of the times at which guards measure, if the path violates one
_KEPT = 6  # poses about which swings are tried
_RANGE = 0.8  # share of the joints' ranges in which these poses are
_WIDEST = 0.95  # the same of poses that are moved because all others violate a guard
_SWINGS = (0.25, 0.1, 0.03, 0.01)  # shares of the swing to begin with, tried in order
_GROWTH = 1.6  # of one joint's swing at a time
_LEAST = 1.05  # growth that ends the iteration
_WORK_KEPT = 0.25  # of the work of measuring a path: most distances are only bounded
_WORK_VIOLATED = 0.05  # the same of a path that violates a guard, where it ends


@dataclass(frozen=True, slots=True, eq=False)
class PathLimits:
    """Limits of all paths of one form.

    Parameters
    ----------
    basis : FourierBasis
    rows : LimitRows
        Limits that are linear in the variables.
    guards : sequence of Guard
        Limits that are not.
    time : ndarray, shape (samples,), [s]
        Times at which the guards measure.
    meter : Meter, optional
        Work done so far; a path is not enlarged any more when the limit is reached.
    poses : ndarray, shape (poses, joints), optional
        Poses that violate no guard, if some are known.
    """

    basis: FourierBasis
    rows: LimitRows
    guards: Sequence[Guard]
    time: Vector
    meter: Meter = field(default_factory=Meter)
    poses: Matrix | None = None

    def kept(self, path: Matrix) -> bool:
        """Return whether a path keeps all limits."""
        if self.rows.largest(path).max() > 1.0:
            return False
        motion = self.basis.motion(path, self.time)
        kept = all(guard.kept(motion) for guard in self.guards)
        share = _WORK_KEPT if kept else _WORK_VIOLATED
        seconds = sum(guard.seconds for guard in self.guards)
        self.meter.spent += share * len(self.time) * seconds
        return kept

    def moved_by(self, joint: int) -> "PathLimits":
        """Return the limits that a joint's motion affects."""
        guards = tuple(guard.moved_by(joint) for guard in self.guards)
        return replace(self, guards=guards)


def clear_start(path: Matrix, limits: PathLimits, rng: np.random.Generator) -> Matrix:
    """Return a path that violates no guard: the given one, or a smaller one elsewhere.

    If there is none among some random poses, the given path is returned.

    Parameters
    ----------
    path : ndarray, shape (size, joints)
    """
    if limits.kept(path):
        return path
    basis, guards, meter = limits.basis, limits.guards, limits.meter
    offsets = rng.uniform(-_RANGE, _RANGE, (_POSES, path.shape[1]))
    middle, half = basis.limits.middle, basis.limits.derivative(0)
    worst = worst_excess(middle + offsets * half, guards, meter)
    if not (worst <= 0.0).any():
        poses = limits.poses
        if poses is None:
            span = middle - _WIDEST * half, middle + _WIDEST * half
            poses = cleared(middle + offsets * half, worst, guards, *span, meter)
        else:
            poses = rng.permutation(poses)[:_KEPT]
        worst, offsets = worst_excess(poses, guards, meter), (poses - middle) / half
    kept = [k for k in np.argsort(worst, kind="stable")[:_KEPT] if worst[k] <= 0.0]
    for share in _SWINGS:
        for k in kept:
            candidate = np.vstack([offsets[k], share * path[1:]])
            if limits.kept(candidate):
                return _grown(candidate, path, limits, rng)
    return path


def _grown(
    start: Matrix, path: Matrix, limits: PathLimits, rng: np.random.Generator
) -> Matrix:
    """Enlarge the swing of all joints, then of each, up to that of the given path."""
    share = np.abs(start[1:]).max(axis=0) / np.abs(path[1:]).max(axis=0)

    def widened(wider: Vector, limits: PathLimits = limits) -> bool:
        return limits.kept(np.vstack([start[0], wider * path[1:]]))

    together = _GROWTH
    meter = limits.meter
    while together > _LEAST and (share < 1.0).any() and not meter.over:
        wider = np.minimum(together * share, 1.0)
        if widened(wider):
            share = wider
        else:
            together = np.sqrt(together)
    # The path keeps all limits: one joint's growth violates only those it affects.
    own = [limits.moved_by(j) for j in range(len(share))]
    growth = np.where(share < 1.0, _GROWTH, 1.0)
    while (growth > _LEAST).any():
        for j in rng.permutation(np.flatnonzero(growth > _LEAST)):
            if meter.over:
                return np.vstack([start[0], share * path[1:]])
            wider = share.copy()
            wider[j] = min(share[j] * growth[j], 1.0)
            if widened(wider, own[j]):
                share = wider
            else:
                growth[j] = np.sqrt(growth[j])
            if share[j] == 1.0:
                growth[j] = 1.0
    return np.vstack([start[0], share * path[1:]])
