"""Why a path cannot be followed, with the place on it."""

from typing import Any

from consistent_id.errors import PathError
from consistent_id.laboratory.curves import arc_length
from consistent_id.laboratory.writing_tasks import WritingTask
from consistent_id.robot.model import RobotModel


def beyond(
    task: WritingTask, u: float, robot: RobotModel, k: int, what: str, value: float
) -> PathError:
    """Tell of a joint beyond its range, or too fast."""
    joint = robot.joints[k]
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


def unreachable(task: WritingTask, u: float, left: float) -> PathError:
    """Tell of a point that no pose reaches; the nearest misses it by `left` metres."""
    what = "point" if task.orientation is None else "point and orientation"
    reason = (
        f"no pose was found that reaches this {what}; the nearest misses it by "
        f"{left:.3g} m. Move or shrink the curve"
    )
    return PathError(reason, value=left, **_place(task, u))


def singular(
    task: WritingTask, u: float, condition: float, allowed: float | None
) -> PathError:
    """Tell of a pose in which no joint moves the point in some direction."""
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
