"""The ROS 2 client: what it sends, when it refuses, and that it cancels.

There is no ROS here.  A robot stands in whose messages have the fields that rosbags
knows of ROS 2, and whose calls are those of rclpy that the client makes.
"""

import runpy
import shutil
import sys
from types import ModuleType, SimpleNamespace

import pytest
from rosbags.typesys import Stores, get_typestore

from consistent_id.motion import PolynomialPath, write_trajectory
from consistent_id.motion.files import follow

STORE = get_typestore(Stores.ROS2_HUMBLE)
ACTION = "/arm/follow_joint_trajectory"


def message_class(name):
    """A message that takes the fields of its type, and no other, as rclpy's do."""
    fields = set(STORE.types[name].__dataclass_fields__) - {"__msgtype__"}

    def init(self, **given):
        assert set(given) <= fields, f"{name} has no {set(given) - fields}"
        for field in fields:
            setattr(self, field, given.get(field, []))

    return type(name.rpartition("/")[2], (), {"__init__": init, "__slots__": [*fields]})


class Robot:
    """What stands behind the action: where it is, what it has been told."""

    def __init__(self, position, *, serves=True, accepts=True, error=0, stops=False):
        self.position, self.serves, self.accepts = dict(position), serves, accepts
        self.error, self.stops = error, stops
        self.goals, self.cancelled, self.open = [], False, False

    def took(self, goal):
        self.goals.append(goal)
        return done(
            SimpleNamespace(
                accepted=self.accepts,
                get_result_async=lambda: self.moved(goal),
                cancel_goal_async=self.cancel,
            )
        )

    def moved(self, goal):
        if self.stops:
            return "interrupted"
        last = goal.trajectory.points[-1].positions
        self.position |= dict(zip(goal.trajectory.joint_names, last, strict=True))
        result = SimpleNamespace(
            error_code=self.error, SUCCESSFUL=0, error_string="path tolerance"
        )
        return done(SimpleNamespace(result=result))

    def cancel(self):
        self.cancelled = True
        return done(None)


def done(value):
    return SimpleNamespace(result=lambda: value)


class Node:
    def __init__(self, robot):
        self.robot = robot

    def create_subscription(self, kind, topic, heard, profile):
        state = kind(
            name=[*self.robot.position], position=[*self.robot.position.values()]
        )
        heard(state)
        return heard

    def destroy_subscription(self, listener):
        assert listener

    def destroy_node(self):
        self.robot.open = False


class Future:
    answer = done_already = False

    def done(self):
        return self.done_already

    def set_result(self, value):
        self.done_already = True


def client_class(robot):
    class Client:
        def __init__(self, node, action, name):
            assert name == ACTION

        def wait_for_server(self, timeout_sec):
            return robot.serves

        def send_goal_async(self, goal):
            return robot.took(goal)

    return Client


def spin(node, future, timeout_sec=None):
    if future == "interrupted":
        raise KeyboardInterrupt


@pytest.fixture
def ros(monkeypatch):
    """Install a robot's ROS."""

    def install(robot):
        trajectory = message_class("trajectory_msgs/msg/JointTrajectory")
        goal = type(
            "Goal", (), {"__init__": lambda s: setattr(s, "trajectory", trajectory())}
        )
        modules = {
            "rclpy": {
                "init": lambda signal_handler_options: setattr(robot, "open", True),
                "shutdown": lambda: None,
                "create_node": lambda name: Node(robot),
                "spin_until_future_complete": spin,
                "task": SimpleNamespace(Future=Future),
            },
            "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO=0)},
            "rclpy.action": {"ActionClient": client_class(robot)},
            "rclpy.qos": {"qos_profile_sensor_data": 0},
            "control_msgs": {},
            "control_msgs.action": {
                "FollowJointTrajectory": SimpleNamespace(Goal=goal)
            },
        }
        for name in (
            "sensor_msgs/msg/JointState",
            "builtin_interfaces/msg/Duration",
            "trajectory_msgs/msg/JointTrajectoryPoint",
        ):
            package, _, kind = name.split("/")
            modules[package] = {}
            modules[f"{package}.msg"] = {kind: message_class(name)}
        for name, content in modules.items():
            module = ModuleType(name)
            vars(module).update(content)
            monkeypatch.setitem(sys.modules, name, module)
        return robot

    return install


@pytest.fixture
def file(tmp_path):
    # From 0.5 and -1 to 0.7 and -0.8, at rest at both ends.
    control = [[0.5, -1.0]] * 3 + [[0.7, -0.8]] * 3
    path = PolynomialPath(("elbow", "wrist"), control, 1.5)
    return write_trajectory(path, tmp_path / "trajectory.yaml", rate=100.0)


AT_START = {"wrist": -1.0, "other": 3.0, "elbow": 0.501}


def test_a_robot_at_the_start_gets_the_whole_file(ros, file):
    robot = ros(Robot(AT_START))
    assert follow.main([str(file), ACTION]) == 0
    (goal,) = robot.goals
    assert goal.trajectory.joint_names == ["elbow", "wrist"]
    points = goal.trajectory.points
    assert len(points) == 151
    assert points[0].positions == [0.5, -1.0] and points[-1].positions == [0.7, -0.8]
    assert points[-1].velocities == pytest.approx([0.0, 0.0], abs=1e-12)
    assert (points[-1].time_from_start.sec, points[-1].time_from_start.nanosec) == (
        1,
        500_000_000,
    )
    assert not robot.open


def test_a_robot_elsewhere_gets_nothing_and_the_joint_is_named(ros, file, capsys):
    robot = ros(Robot(AT_START | {"elbow": 0.6}))
    assert follow.main([str(file), ACTION]) == 1
    assert not robot.goals
    assert "'elbow' is at 0.6000, the motion begins at 0.5000" in (
        capsys.readouterr().err
    )


def test_it_is_moved_to_the_start_if_that_is_asked_for(ros, file):
    robot = ros(Robot(AT_START | {"elbow": 0.6}))
    assert follow.main([str(file), ACTION, "--approach", "4.5"]) == 0
    approach, motion = robot.goals
    (point,) = approach.trajectory.points
    assert point.positions == [0.5, -1.0] and point.velocities == [0.0, 0.0]
    assert (point.time_from_start.sec, point.time_from_start.nanosec) == (
        4,
        500_000_000,
    )
    assert len(motion.trajectory.points) == 151


@pytest.mark.parametrize(
    ("robot", "says"),
    [
        (Robot(AT_START, serves=False), f"no server of the action {ACTION}"),
        (Robot(AT_START, accepts=False), "rejects"),
        (Robot(AT_START, error=-4), "error -4 of the controller: path tolerance"),
        (Robot({"elbow": 0.5}), "has no joint 'wrist'"),
    ],
)
def test_what_the_robot_refuses_is_said(ros, file, capsys, robot, says):
    ros(robot)
    assert follow.main([str(file), ACTION]) == 1
    assert says in capsys.readouterr().err


def test_an_interrupt_cancels_the_motion(ros, file, capsys):
    robot = ros(Robot(AT_START, stops=True))
    assert follow.main([str(file), ACTION]) == 1
    assert robot.cancelled and not robot.open
    assert "cancelled" in capsys.readouterr().err


def test_a_copy_of_the_script_runs_by_itself(ros, file, tmp_path, monkeypatch):
    robot = ros(Robot(AT_START))
    copy = shutil.copy(follow.__file__, tmp_path / "play.py")
    monkeypatch.setattr(sys, "argv", ["follow.py", str(file), ACTION])
    with pytest.raises(SystemExit, match="0"):
        runpy.run_path(str(copy), run_name="__main__")
    assert len(robot.goals) == 1
