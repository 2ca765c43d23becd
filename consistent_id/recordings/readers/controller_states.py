"""States of trajectory controllers as joint states: the measured part of a message.

``control_msgs/JointTrajectoryControllerState`` names its joints, and has a point each
for the reference, the measured state, the error and the output.
"""

from typing import Any, NamedTuple

JOINT_STATE = "sensor_msgs/msg/JointState"
CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"
STATES = (JOINT_STATE, CONTROLLER_STATE)
"""Kinds of messages with states of named joints, the usual one first."""

_MEASURED = ("feedback", "actual")  # the latter before ROS 2 Humble


class NamedStates(NamedTuple):
    """States of joints as in ``sensor_msgs/JointState``; arrays may be empty."""

    header: Any
    name: Any
    position: Any
    velocity: Any
    effort: Any


def joint_states(message: Any) -> Any:
    """Return a message as joint states; those of that kind as they are."""
    if not hasattr(message, "joint_names"):
        return message
    point = next(getattr(message, field) for field in _fields(message))
    return NamedStates(
        message.header,
        message.joint_names,
        point.positions,
        point.velocities,
        point.effort,
    )


def _fields(message: Any) -> list[str]:
    """Return the measured fields that a message has; newer ones have both."""
    known = [field for field in _MEASURED if hasattr(message, field)]
    filled = [field for field in known if len(getattr(message, field).positions)]
    return filled or known
