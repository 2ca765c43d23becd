"""Lets an arm float: sends the gravity and friction of its identified model.

    python3 compensate.py --ros-args --params-file compensate.yaml

A ROS 2 node between joint states and an effort controller of ros2_control.  The
estimate is that of a folder of results; one whose verdict is ``do not use`` is refused.
A state that lacks a joint or a number, or whose torque exceeds the limits, is not
answered: the node ends, and so it does if no state comes for ``oldest_state`` seconds.
Effort controllers hold the last command for ever, so the node sends zero torque at its
end: the arm sinks, or its brakes hold it.  If the node is killed, or the network fails,
nothing is sent: keep the emergency stop at hand, or give the drives a time-out.
"""

import signal
from collections.abc import Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Any

import numpy as np

import consistent_id as ci

PARAMETERS = {
    "results": "results/robot",
    "states": "/joint_states",
    "commands": "/effort_controller/commands",
    "joints": "",
    "friction_share": 0.8,
    "friction_velocity": 0.05,
    "effort_share": 0.5,
    "oldest_state": 0.1,
}


@dataclass(frozen=True)
class Compensation:
    """Torque that holds an arm; without ROS.

    Parameters
    ----------
    control : ControlModel
    joints : tuple of str
        Order of the commands.
    friction_share : float
    effort_share : float
        Of the effort limits of the robot's file.
    """

    control: Any
    joints: tuple[str, ...]
    friction_share: float = 0.8
    effort_share: float = 0.5

    def __post_init__(self) -> None:
        if sorted(self.joints) != sorted(self.control.joints):
            raise ValueError(
                f"joints of the commands are {', '.join(self.joints)}, expected those "
                f"of the model in any order: {', '.join(self.control.joints)}"
            )
        if not (0.0 <= self.friction_share <= 1.0 and 0.0 < self.effort_share <= 1.0):
            raise ValueError("friction_share and effort_share: expected up to 1")
        if not np.isfinite(self.limits).all():
            raise ValueError("the robot's file states no effort limit for some joints")

    @property
    def limits(self) -> np.ndarray:
        """Largest torques that may be sent, shape (joints,), [N m or N]."""
        robot = self.control.model.robot
        effort = np.array([joint.limits.effort for joint in robot.driven])
        return self.effort_share * effort

    def torque(
        self, names: Sequence[str], position: Sequence[float], velocity: Sequence[float]
    ) -> list[float]:
        """Return the torques for a message of joint states, in the commands' order.

        Raises
        ------
        ValueError
            If the message lacks a joint or a number, or a torque exceeds its limit.
        """
        own = self.control.joints
        missing = [joint for joint in own if joint not in names]
        if missing or not len(names) == len(position) == len(velocity):
            raise ValueError(
                f"the message has {len(names)} joints, {len(position)} positions, "
                f"{len(velocity)} velocities and lacks {', '.join(missing) or 'none'}"
            )
        places = [list(names).index(joint) for joint in own]
        q, dq = np.asarray(position)[places], np.asarray(velocity)[places]
        if not np.isfinite([q, dq]).all():
            raise ValueError("a position or velocity is no finite number")
        torque = self.control.gravity(q) + self.control.springs(q)
        torque += self.friction_share * self.control.friction(dq, q)
        over = abs(torque) > self.limits
        if over.any():
            worst = int(np.argmax(abs(torque) / self.limits))
            raise ValueError(
                f"{own[worst]} would get {torque[worst]:.4g} N m, the limit is "
                f"{self.limits[worst]:.4g}"
            )
        return [float(torque[own.index(joint)]) for joint in self.joints]


def compensation_of(settings: dict[str, Any]) -> Compensation:
    """Return the compensation that the node's parameters state."""
    estimate = ci.open_results(settings["results"]).delivered
    control = ci.service.control_model(
        estimate, friction_velocity=settings["friction_velocity"]
    )
    stated = [name.strip() for name in settings["joints"].split(",") if name.strip()]
    return Compensation(
        control,
        tuple(stated) or control.joints,
        settings["friction_share"],
        settings["effort_share"],
    )


def main() -> None:
    """Run the node until it is interrupted, or a state cannot be answered."""
    import rclpy
    from rclpy.qos import qos_profile_sensor_data
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    # Handlers of rclpy would close the context before the last command is sent.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    node = rclpy.create_node("compensation")
    settings = {
        name: node.declare_parameter(name, value).value
        for name, value in PARAMETERS.items()
    }
    compensation = compensation_of(settings)
    sender = node.create_publisher(Float64MultiArray, settings["commands"], 1)
    oldest = settings["oldest_state"]
    last = [monotonic()]  # when the last state came, or the node began

    def heard(state: Any) -> None:
        torque = compensation.torque(state.name, state.position, state.velocity)
        sender.publish(Float64MultiArray(data=torque))
        last[0] = monotonic()

    def watch() -> None:
        if monotonic() - last[0] > oldest:
            raise TimeoutError(f"no state came for {oldest:g} s")

    try:
        node.create_subscription(
            JointState, settings["states"], heard, qos_profile_sensor_data
        )
        node.create_timer(0.5 * oldest, watch)
        rclpy.spin(node)
    finally:
        sender.publish(Float64MultiArray(data=[0.0] * len(compensation.joints)))
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
