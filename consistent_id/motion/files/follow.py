"""consistent-id: motion.  Plays a file on a ROS 2 robot; needs rclpy and control_msgs.

    python3 follow.py trajectory.yaml ACTION [--approach SECONDS]

ACTION is a ``control_msgs/action/FollowJointTrajectory``, such as
``/joint_trajectory_controller/follow_joint_trajectory``.  The robot must be at the
file's first point, else nothing is played; ``--approach`` first moves it there,
straight in joint space, along a path that nobody has checked.  Ctrl-C cancels the
motion.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

_NEAR = 0.02  # rad or m from the first point, beyond which nothing is played
_PATIENCE = 10.0  # seconds to wait for the robot to answer


def main(words: list[str] | None = None) -> int:
    """Play a file; return 0 if the controller says that it followed."""
    parser = argparse.ArgumentParser(description="Play a trajectory on a ROS 2 robot.")
    parser.add_argument("file", type=Path, help="trajectory.yaml")
    parser.add_argument("action", help="name of the FollowJointTrajectory action")
    parser.add_argument("--approach", type=float, metavar="SECONDS")
    parser.add_argument("--joint-states", default="/joint_states", metavar="TOPIC")
    options = parser.parse_args(words)
    if options.approach is not None and not options.approach > 0.0:
        parser.error("--approach is the time of the motion to the start, more than 0")
    message = json.loads(options.file.read_text(encoding="utf-8"))

    import rclpy
    from rclpy.signals import SignalHandlerOptions

    # Without handlers of its own, so that the motion can be cancelled at an interrupt.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("consistent_id_motion")
    try:
        said = play(node, message, options)
    finally:
        node.destroy_node()
        rclpy.shutdown()
    if said:
        sys.stderr.write(f"{options.file}: {said}\n")
    return 1 if said else 0


def play(node: Any, message: dict[str, Any], options: argparse.Namespace) -> str:
    """Move to the start if requested, then along the file; return the error."""
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionClient

    client = ActionClient(node, FollowJointTrajectory, options.action)
    if not client.wait_for_server(timeout_sec=_PATIENCE):
        return f"no server of the action {options.action}; see `ros2 action list`"
    if options.approach is not None:
        seconds = int(options.approach)
        nanoseconds = round(1e9 * (options.approach - seconds))
        first = {
            "positions": message["points"][0]["positions"],
            "velocities": [0.0] * len(message["joint_names"]),
            "time_from_start": {"sec": seconds, "nanosec": nanoseconds},
        }
        if said := follow(node, client, message | {"points": [first]}):
            return said
    return far_from_start(node, message, options.joint_states) or follow(
        node, client, message
    )


def far_from_start(node: Any, message: dict[str, Any], topic: str) -> str:
    """Return the joint that is not at the file's first point, or nothing."""
    import rclpy
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import JointState

    future = rclpy.task.Future()
    places: dict[str, float] = {}

    def heard(state: Any) -> None:
        places.update(zip(state.name, state.position, strict=False))
        if set(message["joint_names"]) <= set(places) and not future.done():
            future.set_result(None)

    listener = node.create_subscription(
        JointState, topic, heard, qos_profile_sensor_data
    )
    rclpy.spin_until_future_complete(node, future, timeout_sec=_PATIENCE)
    node.destroy_subscription(listener)
    for joint, start in zip(
        message["joint_names"], message["points"][0]["positions"], strict=True
    ):
        if joint not in places:
            return f"{topic} has no joint {joint!r}"
        if not abs(places[joint] - start) <= _NEAR:
            return (
                f"joint {joint!r} is at {places[joint]:.4f}, the motion begins at "
                f"{start:.4f}; move it there, or give --approach SECONDS"
            )
    return ""


def follow(node: Any, client: Any, message: dict[str, Any]) -> str:
    """Send a trajectory and wait for its end; return the error."""
    import rclpy

    sent = client.send_goal_async(goal_of(message))
    rclpy.spin_until_future_complete(node, sent)
    handle = sent.result()
    if not handle.accepted:
        return "the controller rejects the trajectory; see its log"
    ended = handle.get_result_async()
    try:
        rclpy.spin_until_future_complete(node, ended)
    except KeyboardInterrupt:
        rclpy.spin_until_future_complete(node, handle.cancel_goal_async())
        return "cancelled"
    result = ended.result().result
    if result.error_code != result.SUCCESSFUL:
        return f"error {result.error_code} of the controller: {result.error_string}"
    return ""


def goal_of(message: dict[str, Any]) -> Any:
    """Return the goal of an action."""
    from builtin_interfaces.msg import Duration
    from control_msgs.action import FollowJointTrajectory
    from trajectory_msgs.msg import JointTrajectoryPoint

    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = message["joint_names"]
    goal.trajectory.points = [
        JointTrajectoryPoint(
            **point | {"time_from_start": Duration(**point["time_from_start"])}
        )
        for point in message["points"]
    ]
    return goal


if __name__ == "__main__":
    sys.exit(main())
