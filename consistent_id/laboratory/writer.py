"""What writes, and Newton's method for where its joints must be.

With the joints' pose exact, velocity and acceleration follow from the Jacobian, not
from differences: ``dq = J^+ v``, ``ddq = J^+ (a - dJ dq)``.  No more joints move than
the task fixes coordinates, so the answer is unique, and ``dq`` the derivative of ``q``.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import (
    Array,
    Vector,
    array_default,
    freeze,
    freeze_arrays,
)
from consistent_id.errors import ProblemError
from consistent_id.laboratory.writing_tasks import WritingTask
from consistent_id.robot.frame_motion import (
    FrameMotion,
    carrying_joints,
    frame_motion,
    reach,
)
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import did_you_mean

EXACT = 1e-11
"""Error over reach with which a point counts as met."""


@dataclass(frozen=True, slots=True, eq=False)
class Writer:
    """What writes: a point of a robot's frame, and the joints that move it.

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
        """A length that the point stays within [m]; it scales rotations."""
        return reach(self.robot, self.frame, self.point)

    def motion(self, q: Array, dq: Array | None = None) -> FrameMotion:
        """Return the point's motion; see `frame_motion`."""
        return frame_motion(self.robot, q, dq, frame=self.frame, point=self.point)


class Solution(NamedTuple):
    """Joint motion along a task, and how well the task determines it.

    Attributes
    ----------
    motion : ndarray, shape (3, samples, joints)
        Position, velocity, acceleration of all of the robot's joints.
    singular_values : ndarray, shape (samples, moving joints), [m/rad or 1]
        Of the Jacobian, rows of rotation times `Writer.reach`; the largest first.
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
    """Return what is missing, shape (samples, 3 or 6), and the Jacobian to match."""
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
    """Return what the task fixes, derived once and twice by its parameter."""
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
