"""A design request as tables, before a search is begun."""

import numpy as np

from consistent_id._support.tables import Table
from consistent_id.excitation.aims import PathForm
from consistent_id.excitation.carried_tool import Moved
from consistent_id.excitation.request import DesignRequest
from consistent_id.excitation.verification import Demands
from consistent_id.motion.limits import MotionLimits


def request_tables(
    moved: Moved, request: DesignRequest, required: Demands
) -> list[Table]:
    """Return form, aim, limits and demands of a path that is requested."""
    form, aim, robot = request.form, request.aim, moved.torque.robot
    rows = moved.torque if moved.sensor is None else moved.sensor
    tried = "; or ".join(_frequencies(one) for one in request.forms)
    bound = f", condition number up to {aim.growth:g} times the least"
    if aim.condition_at_most is not None:
        bound = f", condition number up to {aim.condition_at_most:g}"
    objectives = ", then ".join(aim.objectives) + bound * (len(aim.objectives) > 1)
    pose, times = request.start_pose, request.periods or 1
    lines = [
        ("duration", f"{form.duration:g} s"),
        ("frequencies", tried),
        ("ends", _ends(form)),
        ("played", "once" if times == 1 else f"{times} times"),
        ("start pose", "any" if pose is None else _pose(pose)),
        ("objective", objectives),
        *[("for", ", ".join(aim.interest))] * bool(aim.interest),
        ("column scaling", aim.scaling),
        ("noise", "by default" if aim.noise is None else "as given"),
        ("samples", f"{aim.rate:g} Hz"),
        ("parameters", f"{len(rows.layout)}, by {_measured(moved)}"),
    ]
    plan = Table(
        f"Exciting trajectory of {robot.name}: what would be designed",
        ("", "requested"),
        tuple(lines),
        (*required.notes, *request.notes, *moved.notes),
    )
    return [plan, limits_table(request.limits), *_scene(required)]


def _measured(moved: Moved) -> str:
    if moved.sensor is None:
        return f"the torque of {len(moved.torque.torque_joints)} joints"
    return f"the wrench sensor at {moved.sensor.frame}"


def _frequencies(form: PathForm) -> str:
    """Say which frequencies a form has: harmonics of one, or all of them."""
    every = form.frequencies
    if np.allclose(every, every[0] * np.arange(1, len(every) + 1)):
        return f"{len(every)} harmonics of {every[0]:.4g} Hz"
    return ", ".join(f"{f:.4g}" for f in every) + " Hz"


def _ends(form: PathForm) -> str:
    if not form.rest:
        return "periodic"
    return "from rest to rest" + ", jerk continuous" * form.smooth


def limits_table(limits: MotionLimits) -> Table:
    """Return limits of motion and torque, joint by joint.

    Examples
    --------
    >>> from consistent_id import DHRow, JointLimits, from_modified_dh, motion_limits
    >>> arm = from_modified_dh("arm", [DHRow(0, 0, limits=JointLimits(-1, 2))])
    >>> print(limits_table(motion_limits(arm, velocity=1.0)).text())
    Limits
      joint   lower  upper  velocity  acceleration  jerk  effort
      joint1     -1      2         1           inf   inf     inf
      per joint in rad or m, s, and N m or N
    """
    names = ["lower", "upper", "velocity", "acceleration", "jerk", "effort"]
    over_time = ("effort_rate", "effort_rms")
    names += [n for n in over_time if np.isfinite(getattr(limits, n)).any()]
    values = [getattr(limits, name) for name in names]
    rows = tuple(
        (joint, *(f"{value[j]:.5g}" for value in values))
        for j, joint in enumerate(limits.joints)
    )
    note = "per joint in rad or m, s, and N m or N"
    return Table("Limits", ("joint", *names), rows, (note,))


def _scene(required: Demands) -> list[Table]:
    scene = required.scene
    if scene is None:
        return []
    rows = tuple(
        (*scene.names(pair), f"{pair.wanted * 1e3:.1f}") for pair in scene.pairs
    )
    header = ("one", "other", "by [mm]")
    return [Table("Bodies kept apart", header, rows, scene.remarks)]


def _pose(pose: dict[str, float]) -> str:
    return ", ".join(f"{joint} = {value:.4g}" for joint, value in pose.items())
