"""A robot on its feet: joints that keep these in place, however the trunk moves."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, freeze
from consistent_id.errors import ProblemError
from consistent_id.excitation.standing.trunk_path import TrunkMotion
from consistent_id.recordings.contacts import ContactFlags
from consistent_id.robot.chains import Selection, selected
from consistent_id.robot.frame_motion import FrameMotion, frame_motion
from consistent_id.robot.model import RobotModel

_STEPS = 12  # of Newton's method; three suffice near the last pose
_REACHED = 1e-9  # m, rad: what is left of a foot's way
_LINE = 1e-3  # m; points that are so near to a line are on it
_SINGULAR = 1e-6  # of J J^T, over its largest eigenvalue: legs that are stretched


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


@dataclass(frozen=True, slots=True, eq=False)
class Stance:
    """A pose on feet.

    Parameters
    ----------
    robot : RobotModel
        Whose base floats; it is level in this pose.
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
                f"feet {', '.join(foot.frame for foot in self.feet)} touch the ground "
                "in a line, on which nothing can stand; name more of them"
            )

    def _places(self, foot: StandingFoot) -> Matrix:
        """Return where a foot's points are in the base's axes."""
        seen = frame_motion(self.robot, self.pose[None], frame=foot.frame)
        places: Matrix = seen.position[0] + foot.points @ seen.rotation[0].T
        return places

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


class JointMotion(NamedTuple):
    """Joints over time, and how far feet are off where they should be [m, rad].

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
) -> JointMotion:
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
    return JointMotion(q, dq, ddq, off, singular)


class _Wanted(NamedTuple):
    """How a foot moves, seen from the trunk, in the trunk's axes."""

    place: Matrix
    rotation: Array
    velocity: Matrix
    acceleration: Matrix


def _wanted(trunk: TrunkMotion, start: FrameMotion) -> _Wanted:
    """Return how a foot that stands still in the world is seen to move."""
    base = trunk.base
    into = np.swapaxes(np.asarray(base.rotation), 1, 2)
    v, a = ((into @ x[..., None])[..., 0] for x in (trunk.velocity, trunk.acceleration))
    w, dw = base.angular_velocity, base.angular_acceleration
    place = (into @ (start.position[0] - trunk.place)[..., None])[..., 0]
    speed = -v - np.cross(w, place)
    pull = -a - np.cross(dw, place) - np.cross(w, speed) + np.cross(w, v)
    return _Wanted(
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
    feet: Sequence[StandingFoot], seen: Sequence[FrameMotion], wanted: Sequence[_Wanted]
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
