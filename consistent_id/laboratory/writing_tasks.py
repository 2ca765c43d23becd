"""Writing tasks: a curve in space, its timing, and the tool that writes it.

Newton's method finds where the joints must be.  With the joints' pose exact, velocity
and acceleration follow from the Jacobian, not from differences: ``dq = J^+ v``,
``ddq = J^+ (a - dJ dq)``.  No more joints move than the task fixes coordinates, so the
answer is unique, and ``dq`` the derivative of ``q``.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    Array,
    Matrix,
    Vector,
    array_default,
    checked,
    freeze,
    freeze_arrays,
    frozen,
)
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.laboratory.curves import Curve, arc_length
from consistent_id.robot.kinematics import (
    FrameMotion,
    carrying_joints,
    frame_motion,
    reach,
    turns,
)
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import did_you_mean

TimeLaw = Literal["quintic", "septic", "cycloidal"]

# Coefficients of s^0, s^1, ...: velocity and acceleration are zero at both ends, and of
# the septic law the jerk, too.
_POLYNOMIALS = {
    "quintic": (0.0, 0.0, 0.0, 10.0, -15.0, 6.0),
    "septic": (0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0),
}
_ORTHONORMAL = 1e-9

EXACT = 1e-11
"""Error over reach below which a point counts as reached."""


def time_law(law: TimeLaw, s: ArrayLike, derivatives: int = 2) -> Array:
    """Return a motion from 0 to 1 and its derivatives by ``s``, itself from 0 to 1.

    Parameters
    ----------
    law : {"quintic", "septic", "cycloidal"}
        ``10 s^3 - 15 s^4 + 6 s^5``; ``35 s^4 - 84 s^5 + 70 s^6 - 20 s^7``, whose jerk
        is zero at the ends, too; ``s - sin(2 pi s) / (2 pi)``.
    s : array_like, shape (samples,)
        Before 0 and after 1 it stands still.

    Returns
    -------
    ndarray, shape (derivatives + 1, samples)

    Examples
    --------
    >>> time_law("quintic", [0.0, 0.5, 1.0]).tolist()
    [[0.0, 0.5, 1.0], [0.0, 1.875, 0.0], [0.0, 0.0, 0.0]]
    """
    if law not in get_args(TimeLaw):
        known = ", ".join(get_args(TimeLaw))
        raise ProblemError(f"time law is {law!r}, expected one of {known}")
    s = checked(s, (None,), "s")
    moving = (s > 0.0) & (s < 1.0)
    inside = np.clip(s, 0.0, 1.0)
    values = np.empty((derivatives + 1, len(s)))
    for order in range(derivatives + 1):
        values[order] = _law(law, inside, order)
        if order:
            values[order] = np.where(moving, values[order], 0.0)
    return values


def _law(law: TimeLaw, s: Vector, order: int) -> Vector:
    if law in _POLYNOMIALS:
        polynomial = np.polynomial.Polynomial(_POLYNOMIALS[law])
        return np.asarray(polynomial.deriv(order)(s) if order else polynomial(s))
    w = 2.0 * np.pi
    # The n-th derivative of sin(ws) is w^n sin(ws + n pi / 2).
    wave = w ** (order - 1) * np.sin(w * s + order * np.pi / 2.0)
    straight = (s, np.ones_like(s))[order] if order < 2 else 0.0
    return np.asarray(straight - wave)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Orientation:
    """The orientation of a tool while it writes: constant, or turning about one axis.

    ``R(u) = exp(angle u [axis]) start``, so ``w = axis angle du``.

    Parameters
    ----------
    start : array_like, shape (3, 3)
        Rotation of the frame in the base, where the curve begins.
    axis : array_like, shape (3,)
        In the base; made a unit vector.
    angle : float, [rad]
        Angle by which the frame has turned at the end of the curve.
    """

    start: Matrix
    axis: Vector = array_default((0.0, 0.0, 1.0))
    angle: float = 0.0

    def __post_init__(self) -> None:
        start = frozen(self.start, (3, 3), "orientation: start")
        off = abs(start.T @ start - np.eye(3)).max()
        if off > _ORTHONORMAL or np.linalg.det(start) < 0.0:
            raise ProblemError(
                f"orientation: start is no rotation (R^T R is off by {off:.2g}, "
                f"determinant {np.linalg.det(start):.3g})"
            )
        axis = frozen(self.axis, (3,), "orientation: axis")
        length = float(np.linalg.norm(axis))
        if length == 0.0:
            raise ProblemError("orientation: axis is zero, expected a direction")
        freeze(self, start=start, axis=frozen(axis / length, (3,), "axis"))

    def at(self, u: Vector) -> Array:
        """Return rotations at `u`, shape (samples, 3, 3)."""
        return np.asarray(turns(self.axis, self.angle * u) @ self.start)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class WritingTask:
    """A curve written from rest to rest.

    Parameters
    ----------
    curve : Curve
    duration : float, [s]
    law : {"quintic", "septic", "cycloidal"}
        See `time_law`.
    orientation : Orientation, optional
        Without it, the frame may turn as it likes.
    start : float, [s]
        When it begins to move.

    Examples
    --------
    >>> from consistent_id.laboratory.curves import circle
    >>> task = WritingTask(circle(0.1, centre=[0.4, 0, 0.3]), duration=2.0)
    >>> round(task.length, 6)
    0.628319
    >>> task.evaluate([1.0])[1].round(6).tolist()  # half round, at its fastest
    [[-0.0, -0.589049, 0.0]]
    """

    curve: Curve
    duration: float
    law: TimeLaw = "quintic"
    orientation: Orientation | None = None
    start: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.duration < np.inf:
            raise ProblemError(
                f"writing task: duration is {self.duration} s, expected more than 0"
            )
        if not abs(self.start) < np.inf:
            raise ProblemError(f"writing task: start is {self.start} s")
        time_law(self.law, [0.0])

    @property
    def length(self) -> float:
        """Length of the whole curve [m]."""
        return float(arc_length(self.curve, [1.0])[0])

    def progress(self, time: ArrayLike) -> Array:
        """Return ``u``, ``du/dt`` and ``d2u/dt2``, shape (3, samples)."""
        time = checked(time, (None,), "time")
        values = time_law(self.law, (time - self.start) / self.duration)
        return values / self.duration ** np.arange(3.0)[:, None]

    def evaluate(self, time: ArrayLike) -> Array:
        """Return position, velocity and acceleration, shape (3, samples, 3)."""
        u, du, ddu = self.progress(time)
        c, dc, ddc = self.curve.evaluate(u)
        v = dc * du[:, None]
        return np.array([c, v, ddc * du[:, None] ** 2 + dc * ddu[:, None]])

    def time_at(self, u: float) -> float:
        """Return the time at which the curve's parameter is `u`, [s]."""
        from scipy.optimize import brentq

        if not 0.0 < u < 1.0:
            return self.start + self.duration * (u >= 1.0)
        share = brentq(lambda s: float(time_law(self.law, [s], 0)[0, 0]) - u, 0.0, 1.0)
        return self.start + self.duration * float(share)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Writer:
    """The writing point of a robot's frame, and the joints that move it.

    Parameters
    ----------
    robot : RobotModel
    frame : str
        A moving link, or a link fixed to one.
    point : array_like, shape (3,), [m]
        In that frame.
    joints : tuple of str
        Those that move; by default all that carry the frame.  The others stay where
        they are when the writing starts.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.4)])
    >>> Writer(arm, "link2", [0.3, 0, 0]).joints
    ('joint1', 'joint2')
    """

    robot: RobotModel
    frame: str
    point: Vector = array_default((0.0, 0.0, 0.0))
    joints: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        carrying = carrying_joints(self.robot, self.frame)
        for name in self.joints:
            if name not in carrying:
                near = did_you_mean(name, carrying)
                raise ProblemError(
                    f"joint {name!r} does not move {self.frame!r}; {near}"
                )
        freeze(self, joints=tuple(self.joints) or carrying)
        freeze_arrays(self, {"point": (3,)})

    @property
    def places(self) -> list[int]:
        """Places of the joints that move, among the robot's."""
        return [self.robot.joint_names.index(name) for name in self.joints]

    @property
    def reach(self) -> float:
        """Bound of the point's distance [m]; it scales rotations."""
        return reach(self.robot, self.frame, self.point)

    def motion(self, q: Array, dq: Array | None = None) -> FrameMotion:
        """Return the point's motion; see `frame_motion`."""
        return frame_motion(self.robot, q, dq, frame=self.frame, point=self.point)


class Solution(NamedTuple):
    """Joint motion along a task, with the task's singular values.

    Attributes
    ----------
    motion : ndarray, shape (3, samples, joints)
        Position, velocity, acceleration of all of the robot's joints.
    singular_values : ndarray, shape (samples, moving joints), [m/rad or 1]
        Singular values of the Jacobian, rows of rotation times `Writer.reach`; the
        largest first.
    error : ndarray, shape (samples,), [m]
        Distance that is left, rotations times `Writer.reach` included.
    """

    motion: Array
    singular_values: Array
    error: Vector

    @property
    def condition(self) -> Vector:
        """Largest singular value over the smallest, shape (samples,)."""
        s = self.singular_values
        with np.errstate(divide="ignore"):
            return np.asarray(s[:, 0] / s[:, -1])


def task_error(
    writer: Writer, task: WritingTask, u: Vector, motion: FrameMotion
) -> tuple[Array, Array]:
    """Return the error of the pose, shape (samples, 3 or 6), and its Jacobian."""
    missing = task.curve.evaluate(u, 0)[0] - motion.position
    J = motion.jacobian[:, :3, writer.places]
    if task.orientation is None:
        return missing, J
    from scipy.spatial.transform import Rotation

    turn = task.orientation.at(u) @ motion.rotation.transpose(0, 2, 1)
    rotated = Rotation.from_matrix(turn).as_rotvec()
    lower = writer.reach * motion.jacobian[:, 3:, writer.places]
    return np.hstack([missing, writer.reach * rotated]), np.hstack([J, lower])


def newton_refined(writer: Writer, task: WritingTask, u: Vector, q: Array) -> Array:
    """Newton's method at all samples at once, from good guesses."""
    q = q.copy()
    before = np.inf
    for _ in range(12):
        missing, J = task_error(writer, task, u, writer.motion(q))
        worst = abs(missing).max(initial=0.0)
        # As exact as rounding allows: stop where another step brings nothing.
        if worst == 0.0 or (worst < EXACT * writer.reach and worst > before / 4.0):
            break
        before = worst
        step = np.linalg.pinv(J, rcond=1e-12) @ missing[..., None]
        q[:, writer.places] += np.clip(step[..., 0], -0.5, 0.5)
    return q


def with_rates(
    writer: Writer, task: WritingTask, progress: Array, q: Array
) -> Solution:
    """Return velocities and accelerations that belong to poses `q` on the curve.

    `progress` is the curve's parameter and its derivatives by time, (3, samples).
    """
    u, du, ddu = progress
    missing, J = task_error(writer, task, u, writer.motion(q))
    slope, bend = _tangents(writer, task, u)
    v = slope * du[:, None]
    a = bend * du[:, None] ** 2 + slope * ddu[:, None]
    inverse = np.linalg.pinv(J)
    motion = np.zeros((3, *q.shape))
    motion[0] = q
    motion[1][:, writer.places] = (inverse @ v[..., None])[..., 0]
    bias = writer.motion(q, motion[1]).bias
    bias[:, 3:] *= writer.reach
    rest = a - bias[:, : a.shape[1]]
    motion[2][:, writer.places] = (inverse @ rest[..., None])[..., 0]
    return Solution(
        motion,
        np.asarray(np.linalg.svd(J, compute_uv=False), dtype=np.float64),
        np.asarray(np.linalg.norm(missing, axis=1), dtype=np.float64),
    )


def curve_slope(writer: Writer, task: WritingTask, u: float, q: Vector) -> Vector:
    """Return the joints' derivative by the curve's parameter, shape (joints,)."""
    at = np.array([u])
    _, J = task_error(writer, task, at, writer.motion(q[None]))
    slope = np.zeros(len(q))
    slope[writer.places] = np.linalg.pinv(J[0]) @ _tangents(writer, task, at)[0][0]
    return slope


def _tangents(writer: Writer, task: WritingTask, u: Vector) -> tuple[Array, Array]:
    """Return the first two derivatives of the pose by the task's parameter."""
    _, slope, bend = task.curve.evaluate(u)
    if task.orientation is None:
        return slope, bend
    turn = writer.reach * task.orientation.angle * task.orientation.axis
    turns = np.broadcast_to(turn, slope.shape)
    return np.hstack([slope, turns]), np.hstack([bend, np.zeros_like(turns)])


def nearest_pose(
    writer: Writer, task: WritingTask, u: float, q: Vector
) -> tuple[Vector, float]:
    """Return the pose nearest to the task that Levenberg's method finds, and its error.

    In metres, rotations times the reach.
    """
    at, q = np.array([u]), q.copy()
    missing, J = task_error(writer, task, at, writer.motion(q[None]))
    damping = 0.1 * writer.reach
    for _ in range(200):
        size = float(np.linalg.norm(missing))
        if size < EXACT * writer.reach or damping > 1e6 * writer.reach:
            break
        A = J[0].T @ J[0] + damping**2 * np.eye(J.shape[2])
        trial = q.copy()
        trial[writer.places] += np.clip(
            np.linalg.solve(A, J[0].T @ missing[0]), -0.5, 0.5
        )
        tried = task_error(writer, task, at, writer.motion(trial[None]))
        if np.linalg.norm(tried[0]) < size:
            q, (missing, J), damping = trial, tried, damping / 5.0
        else:
            damping *= 5.0
    return q, float(np.linalg.norm(missing))
