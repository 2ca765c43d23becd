"""Poses in which a robot can rest, and paths about them, from which searches start.

Poses are clear of all bodies, and within all torque limits.  Among random poses few are
clear if a scene is narrow.  The least bad ones are then moved, by Gauss-Newton steps on
what they violate: the least change of the joints after which the linearised violations
are gone.

Paths violate no guard either: from within a wall a search rarely succeeds.  The joints
begin to swing slightly about a clear pose; then the amplitude of each joint grows
separately until a body is in its way.  So a joint near a wall does not limit the
others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.errors import InfeasibleError
from consistent_id.excitation.basis import FourierBasis, LimitRows
from consistent_id.excitation.guards import Guard
from consistent_id.excitation.verification import Demands
from consistent_id.excitation.work import Meter
from consistent_id.motion.collisions.farthest import distance_words, pose_words
from consistent_id.motion.collisions.scene import Scene
from consistent_id.motion.collisions.separation import nearest

_MOVED = 12  # poses that are moved at most,
_ENOUGH = 4  # and of which so many are clear
_RANDOM = 64  # random poses among which clear ones are searched for first
_STEPS = 25  # most steps of each,
_STALLED = 12  # and most of them one after another without a better pose,
_STALLED_CLEAR = 4  # or from a pose that is clear, to one with more room
_MARGIN = 0.1  # from a limit, in a guard's unit, that a step aims at,
_ROOM = 0.05  # and that ends the steps: paths swing about these poses
_NEAR = 0.1  # of a guard's unit: items so near to their limits are included
_REACH = 0.3  # most change of a joint in a step, in rad or m
_LOOKS = 256  # poses that are tried before a scene is refused
_INSIDE = 0.95  # share of the joints' ranges in which they are
_POSES = 64  # share of the times at which guards measure, if the path violates one
_KEPT = 6  # poses about which swings are tried
_RANGE = 0.8  # share of the joints' ranges in which these poses are
_WIDEST = 0.95  # the same of poses that are moved because all others violate a guard
_SWINGS = (0.25, 0.1, 0.03, 0.01)  # shares of the swing to begin with, tried in order
_GROWTH = 1.6  # of one joint's swing at a time
_LEAST = 1.05  # growth that ends the iteration
_WORK_KEPT = 0.25  # of the work of measuring a path: most distances are only bounded
_WORK_VIOLATED = 0.05  # the same of a path that violates a guard, where it ends


def worst_excess(
    poses: Matrix, guards: Sequence[Guard], meter: Meter | None = None
) -> Vector:
    """Return the largest excess of all guards at rest, pose by pose.

    The work is added to the meter.
    """
    motion = _at_rest(poses)
    _count(len(poses), guards, meter)
    measures = [guard.measure(motion).max(axis=1) for guard in guards]
    return np.asarray(np.max(measures, axis=0))


def cleared(
    poses: Matrix,
    worst: Vector,
    guards: Sequence[Guard],
    low: Vector,
    high: Vector,
    meter: Meter | None = None,
) -> Matrix:
    """Return the least bad poses, moved until they violate no guard, best first.

    Parameters
    ----------
    poses : ndarray, shape (poses, joints), [rad or m]
    worst : ndarray, shape (poses,)
        See `worst_excess`.
    low, high : ndarray, shape (joints,), [rad or m]
        Least and greatest positions.
    meter : Meter, optional
        The work is added to it.

    Returns
    -------
    ndarray, shape (poses, joints)
        Fewer than given ones; some may still violate guards.
    """
    moved: list[Vector] = []
    excess: list[float] = []
    for k in np.argsort(worst, kind="stable")[:_MOVED]:
        moved.append(_moved(poses[k], guards, low, high, meter))
        excess.append(float(worst_excess(moved[-1][None], guards, meter)[0]))
        if sum(one <= 0.0 for one in excess) == _ENOUGH:
            break
    return np.asarray(moved)[np.argsort(excess, kind="stable")]


def _count(poses: int, guards: Sequence[Guard], meter: Meter | None) -> None:
    if meter is not None:
        meter.spent += poses * sum(guard.seconds for guard in guards)


def _at_rest(poses: Matrix) -> Array:
    motion: Array = np.zeros((3, *poses.shape))
    motion[0] = poses
    return motion


def _moved(
    pose: Vector,
    guards: Sequence[Guard],
    low: Vector,
    high: Vector,
    meter: Meter | None,
) -> Vector:
    best, least, stalled = pose, np.inf, 0
    for _ in range(_STEPS):
        values, slopes = _violations(pose, guards)
        _count(1, guards, meter)
        if not len(values):
            return pose
        stalled += 1
        if values.max() < least:
            best, least, stalled = pose, float(values.max()), 0
        most = _STALLED_CLEAR if least <= 0.0 else _STALLED
        if least <= -_ROOM or stalled >= most:
            break
        step = -np.linalg.pinv(slopes, rcond=1e-3) @ np.maximum(values + _MARGIN, 0.0)
        step *= min(1.0, _REACH / max(float(abs(step).max()), 1e-12))
        pose = np.clip(pose + step, low, high)
    return best


def _violations(pose: Vector, guards: Sequence[Guard]) -> tuple[Vector, Matrix]:
    """Return the values near their limits or beyond, and their slopes in the joints."""
    values, slopes = [np.zeros(0)], [np.zeros((0, len(pose)))]
    for guard in guards:
        measure = guard.measure(_at_rest(pose[None]))[0]
        items = np.flatnonzero(measure > -_NEAR)
        if len(items):
            rows = guard.rows(_at_rest(np.tile(pose, (len(items), 1))), items)
            values.append(rows.values)
            slopes.append(rows.slopes[:, 0])
    return np.concatenate(values), np.concatenate(slopes)


def poses_apart(demands: Demands, scene: Scene, seed: int = 0) -> Matrix:
    """Return some poses in which all bodies are apart, whatever torque they need.

    Returns
    -------
    ndarray, shape (poses, joints)

    Raises
    ------
    InfeasibleError
        If none was found; with the two bodies, their distance and the pose where they
        are farthest apart.
    """
    low, high = _ranges(demands)
    rng = np.random.default_rng(seed)
    middle = demands.limits.middle
    poses = np.vstack([middle, rng.uniform(low, high, (_LOOKS, len(low)))])
    guards = [guard for guard in demands.guards if guard.keeps_apart]
    worst = worst_excess(poses, guards)
    if not (worst <= 0.0).any():
        poses = cleared(poses, worst, guards, low, high)
        worst = worst_excess(poses, guards)
    if not (worst <= 0.0).any():
        raise InfeasibleError(_impossible(scene, poses[0]))
    return np.asarray(poses[worst <= 0.0])


def clear_poses(demands: Demands, seed: int = 0) -> Matrix | None:
    """Return some poses that violate no guard, best first; None where none is near.

    Random paths of all forms begin about these if random poses are hardly ever clear:
    they are searched for once.

    Returns
    -------
    ndarray, shape (poses, joints), or None
        None, too, without a scene, whose poses are all clear.

    Raises
    ------
    InfeasibleError
        See `poses_apart`.
    """
    guards, scene = demands.guards, demands.scene
    bodies = [guard for guard in guards if guard.keeps_apart]
    if scene is None or not bodies:
        return None
    low, high = _ranges(demands)
    poses = np.random.default_rng(seed).uniform(low, high, (_RANDOM, len(low)))
    worst = worst_excess(poses, guards)
    if np.count_nonzero(worst <= 0.0) < _ENOUGH:
        if not (worst_excess(poses, bodies) <= 0.0).any():
            # Torque matters only where bodies can be apart.
            poses = np.vstack([poses_apart(demands, scene, seed), poses])
            worst = worst_excess(poses, guards)
        poses = cleared(poses, worst, guards, low, high)
        worst = worst_excess(poses, guards)
    order = np.argsort(worst, kind="stable")
    clear = poses[order[worst[order] <= 0.0]]
    return clear if len(clear) else None


def _ranges(demands: Demands) -> tuple[Vector, Vector]:
    """Return the least and greatest positions of poses."""
    limits = demands.limits
    half = _INSIDE * (limits.upper - limits.lower) / 2.0
    return limits.middle - half, limits.middle + half


def _impossible(scene: Scene, pose: Vector) -> str:
    near = nearest(scene, pose[None])
    k = int(near.slack[0].argmin())
    first, second = scene.names(scene.pairs[k])
    distance, wanted = float(near.distance[0, k]), scene.pairs[k].wanted
    where = pose_words(scene.robot, pose)
    pair = scene.bodies[scene.pairs[k].first], scene.bodies[scene.pairs[k].second]
    mend = (
        "Move the obstacle (a floor: a lower --ground), require less (--clearance), "
        "widen the joints' ranges"
    )
    if all(body.frame is not None for body in pair):
        mend = (
            "Both belong to the robot: lock the joints between them where they are "
            "apart (--lock JOINT=POSITION), end the robot before them (--tip LINK), "
            "require less (--clearance)"
        )
    return (
        f"no pose was found that keeps all bodies apart. In the best one, {where}, "
        f"bodies {first!r} and {second!r} {distance_words(distance)}, but "
        f"{wanted * 1e3:.1f} mm and 2 mm to spare are required. {mend}, or, if the two "
        f"may touch, name them: --allowed {first},{second}"
    )


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
