"""Names of rows that are no joint's torque: those of a floating base."""

from collections.abc import Sequence

from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import require_known

BASE_ROWS = ("base.fx", "base.fy", "base.fz", "base.nx", "base.ny", "base.nz")
"""Force [N] on a floating base, and moment [N m] about its frame's origin, in its axes.

What acts on the robot from outside, contact forces say: zero in free flight.
"""

BASE_UNITS = dict(zip(BASE_ROWS, ("N",) * 3 + ("N m",) * 3, strict=True))
"""Units of the base rows."""

CONTACT_FREE = "contact-free"
"""The rows that no contact force enters, all of them together."""


def row_names(robot: RobotModel) -> tuple[str, ...]:
    """Return the names of all rows: of a floating base, then of the joints."""
    return (*BASE_ROWS, *robot.joint_names) if robot.floating else robot.joint_names


def rows_in_order(names: Sequence[str], robot: RobotModel) -> tuple[str, ...]:
    """Return the named rows in the robot's order, all of them for none.

    Raises
    ------
    ProblemError
        If the robot has no such row.
    """
    if not robot.connected or tuple(names) == (CONTACT_FREE,):
        return tuple(names)
    known = row_names(robot)
    if names and not robot.joint_names and not set(names) & set(known):
        return tuple(names)  # of one body alone, whose rows somebody else gives
    require_known(names, known, "torque_joints: no joint")
    return tuple(j for j in known if j in names) or known


def in_newton(robot: RobotModel, name: str) -> bool:
    """Return whether a row is a force, in N; else it is a torque, in N m."""
    if name in BASE_UNITS:
        return BASE_UNITS[name] == "N"
    slides = {joint.name for joint in robot.driven if joint.kind == "prismatic"}
    return name in slides
