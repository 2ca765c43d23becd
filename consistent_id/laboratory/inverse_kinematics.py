"""Writing tasks turned into joint motion: along the curve, within limits, exactly.

Newton's method follows the curve ``x(q) = c(u)`` from its start with steps in which no
joint moves far; its points are the initial values at any time.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Vector, checked
from consistent_id._support.tables import brief
from consistent_id.errors import PathError, ProblemError
from consistent_id.laboratory.curves import arc_length
from consistent_id.laboratory.writing_tasks import (
    EXACT,
    Solution,
    Writer,
    WritingTask,
    curve_slope,
    nearest_pose,
    newton_refined,
    task_error,
    with_rates,
)
from consistent_id.recordings.recording import Recording
from consistent_id.robot.model import Joint, RobotModel

_STEP = 0.1  # rad or m: the most that a joint moves between two nodes
_FIRST, _LAST = 2e-2, 1e-5  # longest and shortest step of the curve's parameter
_TRIES = 24  # random poses from which the first point is searched
_CHECKED = 2000  # instants at which limits and singularities are checked


@brief
@dataclass(frozen=True, slots=True, eq=False)
class TaskPath:
    """A writing task as motion of joints: positions at any time, exactly on the curve.

    `follow` finds one.

    Parameters
    ----------
    writer : Writer
    task : WritingTask
    nodes : ndarray, shape (nodes,)
        Parameters of the curve, from 0 to 1.
    positions, slopes : ndarray, shape (nodes, joints)
        Joints there, and their derivatives by the parameter: they choose the branch,
        Newton's method does the rest.
    """

    writer: Writer
    task: WritingTask
    nodes: Vector
    positions: Array
    slopes: Array

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of all of the robot's joints."""
        return self.writer.robot.joint_names

    @property
    def start(self) -> float:
        """Start time [s]."""
        return self.task.start

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.task.duration

    def evaluate(self, time: ArrayLike) -> Array:
        """Return position, velocity and acceleration, shape (3, samples, joints)."""
        return self.solve(time).motion

    def solve(self, time: ArrayLike) -> Solution:
        """Return the motion with its Jacobian's singular values."""
        from scipy.interpolate import CubicHermiteSpline

        progress = self.task.progress(time)
        guess = CubicHermiteSpline(self.nodes, self.positions, self.slopes)
        q = newton_refined(self.writer, self.task, progress[0], guess(progress[0]))
        return with_rates(self.writer, self.task, progress, q)

    def recording(self, rate: float, name: str = "writing task") -> Recording:
        """Sample position, velocity and acceleration, including both ends.

        Parameters
        ----------
        rate : float, [Hz]
            Changed to the nearest that divides the duration into equal steps.
        """
        steps = max(round(self.duration * rate), 1)
        time = self.start + np.linspace(0.0, self.duration, steps + 1)
        q, dq, ddq = self.evaluate(time)
        return Recording(self.joints, time, q, dq, ddq, name=name)


def follow(
    writer: Writer,
    task: WritingTask,
    *,
    start: ArrayLike | None = None,
    worst_condition: float = 100.0,
) -> TaskPath:
    """Find the joint motion that writes a task, within limits.

    Parameters
    ----------
    writer : Writer
    task : WritingTask
    start : array_like, shape (joints,), optional, [rad or m]
        A pose near which to begin, which chooses between elbow up and down, say; joints
        that do not write stay there.  By default the middle of the joints' ranges, and
        random poses if this fails.
    worst_condition : float
        Largest allowed condition number of the Jacobian; see `Solution`.

    Raises
    ------
    ProblemError
        If more joints move than the task fixes.
    PathError
        Where the path leaves what the robot can reach, comes near a singularity, or
        where a joint exceeds its range or its rate.
    """
    fixed = 3 if task.orientation is None else 6
    if len(writer.joints) > fixed:
        raise ProblemError(
            f"{len(writer.joints)} joints move {writer.frame!r}, but the task fixes "
            f"{fixed} coordinates of it, so it has no unique motion; name at most "
            f"{fixed} joints in Writer(joints=...)"
            + (", or give the task an orientation" if fixed == 3 else "")
        )
    robot = writer.robot
    home = _middle(robot) if start is None else checked(start, (len(robot),), "start")
    path = _marched(writer, task, _first(writer, task, home))
    _check(path, worst_condition)
    return path


def _middle(robot: RobotModel) -> Vector:
    ends = np.array([(j.limits.lower, j.limits.upper) for j in robot.driven])
    # Without a range zero; with one end, zero if it is allowed.
    ends = np.where(
        np.isfinite(ends).all(axis=1)[:, None], ends, np.clip(0.0, *ends.T)[:, None]
    )
    return np.asarray(ends.mean(axis=1))


def _first(writer: Writer, task: WritingTask, home: Vector) -> Vector:
    """Return a pose at the path's start, within limits if there is one."""
    robot, places = writer.robot, writer.places
    rng = np.random.default_rng(0)
    lower = np.array([max(j.limits.lower, -np.pi) for j in robot.driven])
    upper = np.array([min(j.limits.upper, np.pi) for j in robot.driven])
    outside: Vector | None = None
    nearest = np.inf
    for number in range(1 + _TRIES):
        q = home.copy()
        if number:
            q[places] = rng.uniform(np.minimum(lower, upper), upper)[places]
        q, left = nearest_pose(writer, task, 0.0, q)
        nearest = min(nearest, left)
        if left < EXACT * writer.reach:
            q = _wound(robot, q, home)
            if all(_excess(robot, q)[places] <= 0.0):
                return q
            outside = q if outside is None else outside
    if outside is not None:
        return outside  # the check says which joint, and by how much
    raise _unreachable(task, 0.0, nearest)


def _wound(robot: RobotModel, q: Vector, home: Vector) -> Vector:
    """Turn joints by whole turns: to near `home`, and into their range if possible."""
    q = q.copy()
    for k, joint in enumerate(robot.driven):
        if joint.kind == "prismatic":
            continue
        q[k] -= 2.0 * np.pi * np.round((q[k] - home[k]) / (2.0 * np.pi))
        for turned in (q[k] - 2.0 * np.pi, q[k] + 2.0 * np.pi):
            inside = joint.limits.lower <= turned <= joint.limits.upper
            if inside and not joint.limits.lower <= q[k] <= joint.limits.upper:
                q[k] = turned
    return q


def _excess(robot: RobotModel, q: Array) -> Array:
    """Return by how much positions are out of range, below zero where they are not."""
    lower = np.array([joint.limits.lower for joint in robot.driven])
    upper = np.array([joint.limits.upper for joint in robot.driven])
    return np.asarray(np.maximum(lower - q, q - upper))


def _marched(writer: Writer, task: WritingTask, q: Vector) -> TaskPath:
    """Follow the curve from its start, with steps that no joint moves far in."""
    u, slope = 0.0, curve_slope(writer, task, 0.0, q)
    nodes, positions, slopes = [u], [q], [slope]
    longest = _FIRST
    while u < 1.0:
        fastest = float(abs(slope).max())
        step = min(longest, _STEP / max(fastest, 1e-300), 1.0 - u)
        following = 1.0 if u + step > 1.0 - 1e-12 else u + step
        guess = q + slope * step
        at = np.array([following])
        new = newton_refined(writer, task, at, guess[None])
        left = np.linalg.norm(task_error(writer, task, at, writer.motion(new))[0])
        met = left < 10.0 * EXACT * writer.reach
        if met and abs(new[0] - guess).max() < _STEP:
            u, q = following, new[0]
            slope = curve_slope(writer, task, u, q)
            nodes.append(u)
            positions.append(q)
            slopes.append(slope)
            longest = min(2.0 * longest, _FIRST)
        elif step <= _LAST:
            raise _stuck(writer, task, u + step, q)
        else:
            longest = step / 2.0
    return TaskPath(
        writer, task, np.array(nodes), np.array(positions), np.array(slopes)
    )


def _stuck(writer: Writer, task: WritingTask, u: float, q: Vector) -> PathError:
    """Return why the path cannot be followed further: out of reach, or singular."""
    new, left = nearest_pose(writer, task, u, q)
    if left > 10.0 * EXACT * writer.reach:
        return _unreachable(task, u, left)
    progress = np.array([[u], [1.0], [0.0]])
    condition = with_rates(writer, task, progress, new[None]).condition
    return _singular(task, u, float(condition[0]), None)


def _check(path: TaskPath, worst_condition: float) -> None:
    """Refuse singularities and violated limits, at the first instant they occur."""
    task, robot = path.task, path.writer.robot
    time = task.start + np.linspace(0.0, task.duration, _CHECKED + 1)
    found, u = path.solve(time), task.progress(time)[0]
    missed = found.error > 10.0 * EXACT * path.writer.reach
    near = missed | (found.condition > worst_condition)
    if near.any():
        i = int(np.argmax(near))
        raise _singular(task, float(u[i]), float(found.condition[i]), worst_condition)
    speed = np.array([joint.limits.velocity for joint in robot.driven])
    excess = {
        "position": _excess(robot, found.motion[0]),
        "velocity": abs(found.motion[1]) - speed,
    }
    tolerance = 1e-9  # rad or m: a path may begin right at a limit
    for what, over in excess.items():
        over = over[:, path.writer.places]
        if (over > tolerance).any():
            i = int(np.argmax((over > tolerance).any(axis=1)))
            k = path.writer.places[int(np.argmax(over[i]))]
            value = float(found.motion[0 if what == "position" else 1][i, k])
            raise _beyond(task, float(u[i]), robot.driven[k], what, value)


def _beyond(
    task: WritingTask, u: float, joint: Joint, what: str, value: float
) -> PathError:
    """Return the error of a joint beyond its range, or too fast."""
    unit = "m" if joint.kind == "prismatic" else "rad"
    allowed = f"from {joint.limits.lower:.4g} to {joint.limits.upper:.4g} {unit}"
    cure = "start from another pose, or move the curve"
    if what == "velocity":
        unit += "/s"
        allowed = f"up to {joint.limits.velocity:.4g} {unit}"
        cure = "take longer"
    reason = (
        f"the {what} of joint {joint.name!r} is {value:.4g} {unit}, allowed is "
        f"{allowed}; {cure}"
    )
    return PathError(reason, joint=joint.name, value=value, **_place(task, u))


def _unreachable(task: WritingTask, u: float, left: float) -> PathError:
    """Return the error of a point that no pose reaches; the nearest is `left` m off."""
    what = "point" if task.orientation is None else "point and orientation"
    reason = (
        f"no pose was found that reaches this {what}; the nearest misses it by "
        f"{left:.3g} m. Move or shrink the curve"
    )
    return PathError(reason, value=left, **_place(task, u))


def _singular(
    task: WritingTask, u: float, condition: float, allowed: float | None
) -> PathError:
    """Return the error of a pose in which the point cannot move in some direction."""
    limit = "" if allowed is None else f", allowed is {allowed:.4g}"
    reason = (
        f"the robot is singular or nearly so: the Jacobian's condition number is "
        f"{condition:.4g}{limit}. Move the curve, or start from another pose"
    )
    return PathError(reason, value=condition, **_place(task, u))


def _place(task: WritingTask, u: float) -> dict[str, Any]:
    return {
        "arc_length": float(arc_length(task.curve, [u])[0]),
        "time": task.time_at(u),
        "point": tuple(task.curve.evaluate([u], 0)[0, 0].tolist()),
    }
