"""The ROS 2 example: torques that it sends for messages of joint states.

There is no ROS here: messages have the fields that rosbags knows of ROS 2, and calls
are those of rclpy that the node makes.
"""

import runpy
import sys
from pathlib import Path
from time import sleep
from types import ModuleType, SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
import yaml
from carrying import JOINTS, urdf, write_log, write_robot
from estimates import estimate_of
from rosbags.typesys import Stores, get_typestore

from consistent_id import DriveTerms, TorqueModel
from consistent_id.cli import main
from consistent_id.robot import load_urdf
from consistent_id.service import control_model

FOLDER = Path(__file__).parents[2] / "examples" / "ros2"
NODE = runpy.run_path(str(FOLDER / "compensate.py"))
STATED = yaml.safe_load((FOLDER / "compensate.yaml").read_text())
ORDER = ("j2", "j0", "j3", "j1")  # of commands and messages
LEVELS = [1.2, 0.8]  # viscous, dry friction


@pytest.fixture(scope="module")
def control(tmp_path_factory):
    robot = load_urdf(write_robot(tmp_path_factory.mktemp("robot")))
    model = TorqueModel(robot, DriveTerms(viscous=True, coulomb="sign"))
    bodies = [link.nominal for link in robot.links]
    return control_model(estimate_of(model, bodies, np.tile(LEVELS, 4)))


def test_torques_are_gravity_and_a_share_of_friction_in_the_commands_order(control):
    compensation = NODE["Compensation"](control, ORDER)
    model = pin.buildModelFromXML(urdf())
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, dq = rng.uniform(-0.8, 0.8, (2, 4))
        places = [JOINTS.index(joint) for joint in ORDER]
        sent = compensation.torque(
            ["gripper", *ORDER], [0.3, *q[places]], [0.0, *dq[places]]
        )
        held = pin.computeGeneralizedGravity(model, model.createData(), q)
        friction = LEVELS[0] * dq + LEVELS[1] * np.tanh(dq / 0.05)
        np.testing.assert_allclose(sent, (held + 0.8 * friction)[places], rtol=1e-9)


def test_messages_that_cannot_be_answered_are_refused(control):
    compensation = NODE["Compensation"](control, ORDER)
    zeros = [0.0] * 4
    with pytest.raises(ValueError, match="lacks j1"):
        compensation.torque(ORDER[:3], zeros[:3], zeros[:3])
    with pytest.raises(ValueError, match="0 velocities"):
        compensation.torque(ORDER, zeros, [])
    with pytest.raises(ValueError, match="no finite number"):
        compensation.torque(ORDER, [np.nan, 0.0, 0.0, 0.0], zeros)
    with pytest.raises(ValueError, match=r"j\d would get .* N m, the limit is 100"):
        compensation.torque(ORDER, zeros, [1e4] * 4)
    with pytest.raises(ValueError, match="expected those of the model"):
        NODE["Compensation"](control, ("j0", "j1"))
    with pytest.raises(ValueError, match="expected up to 1"):
        NODE["Compensation"](control, ORDER, friction_share=1.2)


def test_the_file_states_the_node_s_parameters():
    assert STATED == {"compensation": {"ros__parameters": NODE["PARAMETERS"]}}


def message_class(store, name):
    """A message that takes the fields of its type, and no other, as rclpy's do."""
    fields = set(store.types[name].__dataclass_fields__) - {"__msgtype__"}

    def init(self, **given):
        assert set(given) <= fields
        self.__dict__.update(given)

    return type(name.rpartition("/")[2], (), {"__init__": init})


@pytest.mark.slow
def test_the_node_answers_joint_states_with_commands(tmp_path, monkeypatch):
    """A log is identified; its states are sent to the node as messages."""
    robot, log = write_robot(tmp_path), write_log(tmp_path / "log.csv", None)
    results = tmp_path / "results"
    words = ["identify", robot, log, "--no-select", "--cutoff", "8"]
    assert main([*map(str, words), "--output", str(results)]) == 0
    stated = {"results": str(results), "joints": ", ".join(ORDER)}
    q = np.loadtxt(log, delimiter=",", skiprows=1)[::100, 1:9]
    sent, closed, timers, options = [], [], [], []
    monkeypatch.setattr("signal.signal", lambda number, handler: None)
    store = get_typestore(Stores.ROS2_HUMBLE)
    state = message_class(store, "sensor_msgs/msg/JointState")
    array = message_class(store, "std_msgs/msg/Float64MultiArray")

    def declare(name, value):
        assert type(stated.get(name, value)) is type(value)
        return SimpleNamespace(value=stated.get(name, value))

    def publisher(kind, topic, depth):
        assert (kind, topic) == (array, "/effort_controller/commands")
        return SimpleNamespace(publish=lambda message: sent.append(message.data))

    def listen(kind, topic, heard, profile):
        assert (kind, topic) == (state, "/joint_states")
        for row in q:
            heard(state(name=[*JOINTS], position=[*row[:4]], velocity=[*row[4:]]))

    node = SimpleNamespace(
        declare_parameter=declare,
        create_publisher=publisher,
        create_subscription=listen,
        create_timer=lambda period, watch: timers.append((period, watch)),
        destroy_node=lambda: closed.append(True),
    )

    def spin(node):
        ((period, watch),) = timers
        assert period == 0.05
        watch()  # states have just come
        sleep(0.11)
        watch()

    modules = {
        "rclpy": {
            "init": lambda signal_handler_options: options.append(
                signal_handler_options
            ),
            "create_node": lambda name: node,
            "spin": spin,
            "try_shutdown": lambda: None,
        },
        "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO="no")},
        "rclpy.qos": {"qos_profile_sensor_data": None},
        "sensor_msgs.msg": {"JointState": state},
        "std_msgs.msg": {"Float64MultiArray": array},
    }
    for name, content in modules.items():
        module = ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)
    with pytest.raises(TimeoutError, match=r"no state came for 0\.1 s"):
        NODE["main"]()
    assert closed and len(sent) == len(q) + 1
    assert sent.pop() == [0.0] * 4  # at the end, before the context is closed
    assert options == ["no"]
    model = pin.buildModelFromXML(urdf())
    held = [pin.computeGeneralizedGravity(model, model.createData(), r[:4]) for r in q]
    friction = LEVELS[0] * q[:, 4:] + LEVELS[1] * np.tanh(q[:, 4:] / 0.05)
    expected = np.array(held) + 0.8 * friction + 0.1  # the drives' offset
    places = [JOINTS.index(joint) for joint in ORDER]
    error = np.array(sent) - expected[:, places]
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(np.mean(expected**2))
