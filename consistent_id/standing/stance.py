"""A robot on its feet: contact points, pose, and joints that keep feet in place.

For any motion of the trunk, the fixed feet determine the motion of the legs' joints.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, freeze
from consistent_id._support.tables import brief
from consistent_id.errors import InfeasibleError, ProblemError
from consistent_id.motion.collisions.urdf_bodies import link_bodies
from consistent_id.problems.floating.contact_guess import Foot, feet_of
from consistent_id.recordings.beside import BaseMotion, ContactFlags
from consistent_id.robot.chains import Selection, selected
from consistent_id.robot.kinematics import FrameMotion, frame_motion, reach
from consistent_id.robot.loaders.mjcf_spec import read_spec
from consistent_id.robot.loaders.robot_file import is_mjcf
from consistent_id.robot.loaders.urdf_lint import read_bytes
from consistent_id.robot.loaders.xml import parse
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import did_you_mean, require_known
from consistent_id.standing.trunk_path import TrunkMotion

_STEPS = 12  # of Newton's method; three suffice near the last pose
_REACHED = 1e-9  # m, rad: what is left of a foot's way
_LINE = 1e-3  # m; points that are so near to a line are on it
_SINGULAR = 1e-6  # of J J^T, over its largest eigenvalue: legs that are stretched

_SOLE = 0.8  # share of a sole's sides on which it may be pressed: edges are round
_BENT = 0.15  # of a leg's length, by which the trunk is lowered to bend the knees
_NUDGE = 0.4  # rad, with which knees begin to bend, to their wider side
_BALANCED = 4  # times that the trunk is moved over its feet
_WIDER = 1.5  # ratio of a joint's two ranges from which on it has a wider side


@brief
@dataclass(frozen=True, slots=True, eq=False)
class StandingFoot:
    """A foot that stays where it is.

    Parameters
    ----------
    points : ndarray, shape (points, 3), [m]
        In the frame, at which it is pressed: one of a ball, the corners of a sole.
    flat : bool
        Whether it is a sole, which does not turn either.
    """

    frame: str
    points: Matrix
    flat: bool


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Stance:
    """A pose on feet.

    Parameters
    ----------
    robot : RobotModel
        Robot with a floating base, which is level in this pose.
    pose : ndarray, shape (joints,), [rad or m]

    Attributes
    ----------
    legs : tuple of RobotModel
        The base and what carries each foot.
    """

    robot: RobotModel
    feet: tuple[StandingFoot, ...]
    pose: Vector
    legs: tuple[RobotModel, ...] = field(init=False)

    def __post_init__(self) -> None:
        if not self.robot.floating:
            raise ProblemError(
                f"robot {self.robot.name!r} has a fixed base, and does not stand on "
                "feet; load it with base='floating'"
            )
        legs = (selected(self.robot, Selection(tip=foot.frame)) for foot in self.feet)
        freeze(self, legs=tuple(legs))
        rows = sum(6 if foot.flat else 3 for foot in self.feet)
        if not 0 < rows <= len(self.robot):
            raise ProblemError(
                f"feet {', '.join(foot.frame for foot in self.feet)} hold {rows} "
                f"coordinates, the robot has {len(self.robot)} joints; name other feet"
            )
        corners = np.concatenate([self._places(foot) for foot in self.feet])
        flat = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
        if len(corners) < 3 or flat[1] < _LINE:
            raise ProblemError(
                f"feet {', '.join(foot.frame for foot in self.feet)} touch the "
                f"ground in a line, on which the robot cannot stand; name more of them"
            )

    def _places(self, foot: StandingFoot) -> Matrix:
        """Return where a foot's points are in the base's axes."""
        seen = frame_motion(self.robot, self.pose[None], frame=foot.frame)
        places: Matrix = seen.position[0] + foot.points @ seen.rotation[0].T
        return places

    @property
    def middle(self) -> Vector:
        """The middle of all feet in the base's axes, shape (3,), [m]."""
        places = [self._places(foot).mean(axis=0) for foot in self.feet]
        return np.asarray(np.mean(places, axis=0))

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that keep the feet in place; the others stand still."""
        used = {name for leg in self.legs for name in leg.joint_names}
        return tuple(name for name in self.robot.joint_names if name in used)

    def seen(self, q: Matrix, dq: Matrix | None = None) -> list[FrameMotion]:
        """Return each foot's middle, seen from the base, Jacobians of all joints."""
        return [
            _of_leg(self.robot, leg, foot, q, dq)
            for leg, foot in zip(self.legs, self.feet, strict=True)
        ]

    def contacts(self, samples: int) -> tuple[ContactFlags, ...]:
        """Return the feet as contacts that are closed all the time."""
        closed = np.ones(samples, dtype=np.bool_)
        return tuple(
            ContactFlags(foot.frame, closed, foot.points.mean(axis=0), foot.flat)
            for foot in self.feet
        )


@brief
class LegMotion(NamedTuple):
    """Joints over time, and the errors of the feet [m, rad].

    Attributes
    ----------
    q, dq, ddq : ndarray, shape (samples, joints)
    off : float
    singular : bool
        Whether a leg is stretched at some time, so that it cannot follow.
    """

    q: Matrix
    dq: Matrix
    ddq: Matrix
    off: float
    singular: bool


def joint_motion(
    stance: Stance, trunk: TrunkMotion, begin: Vector | None = None
) -> LegMotion:
    """Return the joints' motion that keeps the feet where they stand.

    Feet are solved for by Newton's method from the pose of the stance, or from `begin`;
    velocities and accelerations follow from Jacobians, exactly.
    """
    n = len(trunk.place)
    start = stance.seen(stance.pose[None])
    wanted = [_wanted(trunk, seen) for seen in start]
    q = np.tile(stance.pose if begin is None else begin, (n, 1))
    for _ in range(_STEPS):
        seen = stance.seen(q)
        error = _errors(stance.feet, seen, wanted)
        off = float(abs(error).max())
        if off < _REACHED or not np.isfinite(off):
            break
        J = _stacked(stance.feet, [foot.jacobian for foot in seen])
        q = q + np.clip(_least(J, error), -0.5, 0.5)
    J = _stacked(stance.feet, [foot.jacobian for foot in seen])
    dq = _least(J, _stacked(stance.feet, [w.velocity for w in wanted]))
    bent = [foot.bias for foot in stance.seen(q, dq)]
    pulled = _stacked(stance.feet, [w.acceleration for w in wanted])
    ddq = _least(J, pulled - _stacked(stance.feet, bent))
    spread = np.linalg.eigvalsh(J @ np.swapaxes(J, 1, 2))
    singular = bool((spread[:, 0] < _SINGULAR * spread[:, -1]).any())
    return LegMotion(q, dq, ddq, off, singular)


class _FootPath(NamedTuple):
    """How a foot moves, seen from the trunk, in the trunk's axes."""

    place: Matrix
    rotation: Array
    velocity: Matrix
    acceleration: Matrix


def _wanted(trunk: TrunkMotion, start: FrameMotion) -> _FootPath:
    """Return how a foot that stands still in the world is seen to move."""
    base = trunk.base
    into = np.swapaxes(np.asarray(base.rotation), 1, 2)
    v, a = ((into @ x[..., None])[..., 0] for x in (trunk.velocity, trunk.acceleration))
    w, dw = base.angular_velocity, base.angular_acceleration
    place = (into @ (start.position[0] - trunk.place)[..., None])[..., 0]
    speed = -v - np.cross(w, place)
    pull = -a - np.cross(dw, place) - np.cross(w, speed) + np.cross(w, v)
    return _FootPath(
        place, into @ start.rotation[0], np.hstack([speed, -w]), np.hstack([pull, -dw])
    )


def _of_leg(
    robot: RobotModel, leg: RobotModel, foot: StandingFoot, q: Matrix, dq: Matrix | None
) -> FrameMotion:
    """Return a foot's middle by its own leg, which takes a share of the time."""
    places = [robot.joint_names.index(name) for name in leg.joint_names]
    middle = foot.points.mean(axis=0)
    rates = None if dq is None else dq[:, places]
    moved = frame_motion(leg, q[:, places], rates, frame=foot.frame, point=middle)
    jacobian = np.zeros((len(q), 6, len(robot)))
    jacobian[:, :, places] = moved.jacobian
    return moved._replace(jacobian=jacobian)


def _errors(
    feet: Sequence[StandingFoot],
    seen: Sequence[FrameMotion],
    wanted: Sequence[_FootPath],
) -> Matrix:
    """Return how far feet are off, shape (samples, rows)."""
    both = [
        np.hstack([w.place - s.position, _small_turn(s.rotation, w.rotation)])
        for s, w in zip(seen, wanted, strict=True)
    ]
    return _stacked(feet, both)


def _small_turn(first: Array, second: Array) -> Matrix:
    """Return the turn from one rotation to another, to first order."""
    turn = second @ np.swapaxes(first, 1, 2)
    return 0.5 * np.stack(
        [
            turn[:, 2, 1] - turn[:, 1, 2],
            turn[:, 0, 2] - turn[:, 2, 0],
            turn[:, 1, 0] - turn[:, 0, 1],
        ],
        axis=1,
    )


def _stacked(feet: Sequence[StandingFoot], parts: Sequence[Array]) -> Array:
    """Return what feet hold: three rows of a ball, six of a sole, below each other."""
    rows = [
        part[:, : 6 if foot.flat else 3] for foot, part in zip(feet, parts, strict=True)
    ]
    return np.concatenate(rows, axis=1)


def _least(J: Array, rows: Matrix) -> Matrix:
    """Return the smallest rates of joints that have these rows."""
    square = J @ np.swapaxes(J, 1, 2)
    ridge = 1e-14 * np.trace(square, axis1=1, axis2=2)[:, None, None]
    square = square + ridge * np.eye(square.shape[1])
    solved = np.linalg.solve(square, rows[..., None])
    return np.asarray((np.swapaxes(J, 1, 2) @ solved)[..., 0])


def standing_feet(
    robot: RobotModel,
    path: Path,
    frames: Sequence[str] = (),
    sole: tuple[float, float] | None = None,
) -> tuple[StandingFoot, ...]:
    """Return feet to stand on: those of the names, or all that the robot has.

    Parameters
    ----------
    path : Path
        Path of its file, with the feet's shapes.
    sole : (float, float), optional, [m]
        Length and width of a sole; by default those of its collision shapes.

    Raises
    ------
    ProblemError
        If there is no such foot, or a sole has no shape.
    """
    known = {foot.frame: foot for foot in feet_of(robot, path)}
    names = {name: foot for foot in known.values() for name in foot.names}
    for frame in frames:
        if frame not in names:
            raise ProblemError(f"no foot {frame!r}; {did_you_mean(frame, list(known))}")
    chosen = [names[frame] for frame in frames] or list(known.values())
    if not chosen:
        raise ProblemError(
            f"{path}: no link is named as a foot (foot, sole, toe, ankle, calf); a "
            f"robot without feet cannot stand"
        )
    return tuple(_standing(path, foot, sole) for foot in chosen)


def _standing(path: Path, foot: Foot, sole: tuple[float, float] | None) -> StandingFoot:
    if not foot.surface:
        return StandingFoot(foot.frame, foot.point[None], False)
    if sole is not None:
        half = 0.5 * _SOLE * np.array(sole)
        low, high = np.array([*-half, 0.0]), np.array([*half, 0.0])
    else:
        corners = _corners(path, foot)
        if not len(corners):
            raise ProblemError(
                f"{path}: foot {foot.frame!r} has no collision shape; state the size "
                f"of its sole: --sole LENGTH,WIDTH"
            )
        low, high = corners.min(axis=0), corners.max(axis=0)
        middle, half = 0.5 * (low + high), 0.5 * _SOLE * (high - low)
        low, high = middle - half, middle + half
        high[2] = low[2] = corners[:, 2].min()
    x, y = [low[0], high[0]], [low[1], high[1]]
    points = np.array([[a, b, low[2]] for a in x for b in y])
    return StandingFoot(foot.frame, points, True)


def _corners(path: Path, foot: Foot) -> Matrix:
    """Return the outermost points of a foot's shapes in the axes of its frame."""
    found: list[Matrix] = [np.zeros((0, 3))]
    axes = np.vstack([np.eye(3), -np.eye(3)])
    if is_mjcf(path):
        found += _mjcf_corners(path, foot.frame)
        return np.vstack(found)
    for link in parse(read_bytes(path)).all("link"):
        if link.name == foot.frame:
            for body in link_bodies(path, link):
                turned = np.asarray(body.rotation)
                points = body.shape.farthest(axes @ turned)
                found.append(points @ turned.T + np.asarray(body.translation))
    return np.vstack(found)


def _mjcf_corners(path: Path, frame: str) -> list[Matrix]:
    import mujoco

    model = read_spec(path, mujoco).compile()
    found = []
    for geom in range(model.ngeom):
        touches = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if model.body(int(model.geom_bodyid[geom])).name != frame or not touches:
            continue
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, model.geom_quat[geom])
        middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
        corners = middle + signs * half
        found.append(corners @ R.reshape(3, 3).T + model.geom_pos[geom])
    return found


def standing_pose(
    robot: RobotModel,
    path: Path,
    feet: tuple[StandingFoot, ...],
    given: Mapping[str, float] | None = None,
) -> Vector:
    """Return the pose in which a robot stands.

    Joints that are not given are as in the keyframe of an MJCF file that is named home
    or stand, or its first; without one, at zero, the knees bent with the feet below
    where they are then.

    Raises
    ------
    ProblemError
        If there is no such joint.
    InfeasibleError
        If the knees cannot be bent.
    """
    stated = dict(given or {})
    require_known(stated, robot.joint_names, "--stance: no joint")
    keyed = _keyframe(path)
    if keyed or stated:
        known = {**keyed, **stated}
        return np.array([known.get(name, 0.0) for name in robot.joint_names])
    return _bent(robot, feet)


def _keyframe(path: Path) -> dict[str, float]:
    if not is_mjcf(path):
        return {}
    import mujoco

    model = read_spec(path, mujoco).compile()
    keys = [model.key(k).name for k in range(model.nkey)]
    if not keys:
        return {}
    named = [k for k, name in enumerate(keys) if "home" in name or "stand" in name]
    qpos = model.key((*named, 0)[0]).qpos
    return {
        model.joint(j).name: float(qpos[model.jnt_qposadr[j]])
        for j in range(model.njnt)
        if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE
    }


def _bent(robot: RobotModel, feet: tuple[StandingFoot, ...]) -> Vector:
    """Return the pose at zero, lowered until the knees are bent.

    The trunk also moves until the centre of mass is above the middle of the feet.
    """
    limits = [joint.limits for joint in robot.joints if joint.driven]
    low, high = (np.array([getattr(x, s) for x in limits]) for s in ("lower", "upper"))
    zero = np.clip(np.zeros(len(robot)), low, high)
    ahead, back = high - zero, zero - low
    side = np.where(
        ahead > _WIDER * back, 1.0, np.where(back > _WIDER * ahead, -1.0, 0)
    )
    upright = Stance(robot, feet, zero)
    legs = np.isin(robot.joint_names, upright.joints)
    longest = max(
        reach(leg, foot.frame, foot.points[0])
        for leg, foot in zip(upright.legs, feet, strict=True)
    )
    begin, over = zero + _NUDGE * side * legs, np.zeros(2)
    for _ in range(_BALANCED):
        moved = _lowered(upright, begin, np.array([*over, -_BENT * longest]))
        pose = moved.q[0]
        inside = bool(((pose >= low) & (pose <= high)).all())
        if moved.off > 1e-6 or moved.singular or not inside:
            break
        found, begin = pose, pose
        over = over + _unbalanced(robot, feet, pose)
    else:
        return np.asarray(found)
    if not over.any():
        raise InfeasibleError(
            "no pose with bent knees is found from all joints at zero; state the "
            "pose: --stance JOINT=POSITION ..."
        )
    return np.asarray(found)


def _lowered(upright: Stance, begin: Vector, by: Vector) -> LegMotion:
    """Return the pose in which the trunk has moved, and the feet have not."""
    still = np.zeros((1, 3))
    base = BaseMotion.at_rest(1, gravity=upright.robot.gravity)
    return joint_motion(upright, TrunkMotion(by[None], still, still, base), begin=begin)


def _unbalanced(
    robot: RobotModel, feet: tuple[StandingFoot, ...], pose: Vector
) -> Vector:
    """Return the way from the centre of mass to the middle of the feet, [m]."""
    masses, centres = [], []
    for link in robot.links:
        if link.nominal is not None and link.nominal.mass > 0.0:
            seen = frame_motion(robot, pose[None], frame=link.name)
            masses.append(link.nominal.mass)
            centres.append(seen.position[0] + seen.rotation[0] @ link.nominal.com)
    if not masses:
        return np.zeros(2)
    centre = np.average(centres, axis=0, weights=masses)
    places = Stance(robot, feet, pose).middle
    return np.asarray((places - centre)[:2])
