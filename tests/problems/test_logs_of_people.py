"""Logs in the forms that people have, from a robot and a file to what is read."""

import numpy as np
import pytest
from logged import URDF, write_arm
from ros_topics import header, write_mcap
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import consistent_id as ci
from consistent_id.problems.robot_logs import robot_logs
from consistent_id.problems.statement import Statement
from consistent_id.recordings.own_names import mapping_option

START = 1_700_000_000_000_000_000
STATES = "sensor_msgs/msg/JointState"
JOINTS = ("shoulder", "elbow")


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """Return the robot's file, and the log as it is in its CSV file."""
    urdf, log = write_arm(tmp_path_factory.mktemp("arm"))
    return urdf, log, robot_logs(urdf, log).read(log)


def _messages(log, names, *, fields=("position", "effort"), every=1):
    stamps = START + np.rint(log.time * 1e9).astype(np.int64)
    values = {"position": log.position, "effort": log.torque}
    return [
        (
            stamps[k],
            {
                "header": header(stamps[k]),
                "name": list(names),
                **{field: values[field][k, : len(names)] for field in fields},
            },
        )
        for k in range(0, len(log), every)
    ]


def _bag(folder, **topics):
    named = {f"/{topic}/joint_states": (STATES, m) for topic, m in topics.items()}
    return write_mcap(folder / "bag", named)


@pytest.mark.slow
def test_a_bag_with_a_gripper_is_read_by_the_arms_topic_which_is_said(arm, tmp_path):
    urdf, _, log = arm
    gripper = _messages(log, ["finger"], every=3)
    bag = _bag(tmp_path, gripper=gripper, arm=_messages(log, JOINTS))
    found = robot_logs(urdf, bag)
    assert found.stated.topic == "/arm/joint_states"
    said = "read from /arm/joint_states, not from /gripper/joint_states"
    assert any(said in note for note in found.notes)
    np.testing.assert_array_equal(found.read(bag).position, log.position)
    draft = ci.draft_problem(urdf, bag, select=False, cutoff=10.0)
    assert draft.problem().table.data.topic == "/arm/joint_states"
    assert said in draft.text(tmp_path)


@pytest.mark.slow
def test_a_velocity_that_was_not_recorded_is_not_read(arm, tmp_path):
    urdf, _, log = arm
    found = robot_logs(urdf, bag := _bag(tmp_path, arm=_messages(log, JOINTS)))
    assert found.columns.velocity is None
    assert any("has no velocity" in note for note in found.notes)
    assert found.read(bag).velocity is None
    assert found.stated.topic is None  # the only one


@pytest.mark.slow
def test_joints_that_a_bag_lacks_are_locked(arm, tmp_path):
    urdf, _, log = arm
    found = robot_logs(urdf, bag := _bag(tmp_path, arm=_messages(log, ["shoulder"])))
    assert found.locked == {"elbow": 0.0}
    assert found.read(bag).joints == ("shoulder",)


@pytest.mark.slow
def test_a_bag_without_effort_is_refused(arm, tmp_path):
    urdf, _, log = arm
    bag = _bag(tmp_path, arm=_messages(log, JOINTS, fields=["position"]))
    with pytest.raises(ci.RecordingError, match="has no effort of shoulder, elbow"):
        robot_logs(urdf, bag)


_POINT = "trajectory_msgs/JointTrajectoryPoint"
_CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"


def _with_controller(folder, log, **topics):
    """Write a bag with the state of a controller, whose joints have another order."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    lines = ["std_msgs/Header header", "string[] joint_names"]
    lines += [f"{_POINT} {part}" for part in ("reference", "feedback", "output")]
    types.register(get_types_from_msg("\n".join(lines), _CONTROLLER))
    states = []
    for stamp, content in _messages(log, JOINTS):
        fields = (("positions", "position"), ("effort", "effort"))
        point = {to: content[of][::-1].copy() for to, of in fields if of in content}
        other = {"positions": 0.0 * point["positions"]}
        message = {"header": content["header"], "joint_names": list(JOINTS[::-1])}
        points = {"reference": other, "feedback": point, "output": other}
        states.append((stamp, message | points))
    named = {f"/{t}/joint_states": (STATES, m) for t, m in topics.items()}
    topics = named | {"/arm/state": (_CONTROLLER, states)}
    return write_mcap(folder / "bag", topics, types)


@pytest.mark.slow
def test_the_state_of_a_controller_is_read_if_no_joint_state_has_the_joints(
    arm, tmp_path
):
    """A gripper alone was read, of which no joint moves."""
    urdf, _, log = arm
    bag = _with_controller(tmp_path, log, gripper=_messages(log, ["finger"], every=3))
    found = robot_logs(urdf, bag).read(bag)
    np.testing.assert_array_equal(found.position, log.position)
    np.testing.assert_array_equal(found.torque, log.torque)


@pytest.mark.slow
def test_a_topic_with_effort_is_proposed_where_the_usual_one_has_none(arm, tmp_path):
    urdf, _, log = arm
    bare = _messages(log, JOINTS, fields=["position"])
    bag = _with_controller(tmp_path, log, arm=bare)
    with pytest.raises(ci.RecordingError, match="but /arm/state has") as caught:
        robot_logs(urdf, bag)
    assert caught.value.options == "--topic /arm/state"
    found = robot_logs(urdf, bag, Statement(topic="/arm/state")).read(bag)
    np.testing.assert_array_equal(found.torque, log.torque)


@pytest.mark.slow
def test_the_option_in_the_message_reads_the_bag(arm, tmp_path):
    urdf, _, log = arm
    bag = _bag(tmp_path, arm=_messages(log, ["Base", "Link 2"]))
    with pytest.raises(ci.RecordingError) as caught:
        robot_logs(urdf, bag)
    option = mapping_option(["Base", "Link 2"], JOINTS)
    assert str(caught.value).endswith(option)
    assert option == "--names Base=shoulder 'Link 2=elbow'"
    names = {"Base": "shoulder", "Link 2": "elbow"}
    found = robot_logs(urdf, bag, Statement(names=names)).read(bag)
    np.testing.assert_array_equal(found.position, log.position)


@pytest.mark.slow
def test_the_option_in_the_message_reads_a_table(arm, tmp_path):
    urdf, csv, log = arm
    head, rows = csv.read_text().split("\n", 1)
    assert head == "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow"
    file = tmp_path / "log.csv"
    file.write_text(f"time,Base q,Link 2 q,Base tau,Link 2 tau\n{rows}")
    with pytest.raises(ci.RecordingError, match="--names Base=shoulder 'Link 2=elbow'"):
        robot_logs(urdf, file)
    names = {"Base": "shoulder", "Link 2": "elbow"}
    found = robot_logs(urdf, file, Statement(names=names)).read(file)
    np.testing.assert_array_equal(found.torque, log.torque)


def test_an_encoding_is_said_in_the_draft(arm, tmp_path):
    urdf, csv, log = arm
    file = tmp_path / "log.csv"
    file.write_bytes(csv.read_text().replace(",", ";").encode("utf-16"))
    found = robot_logs(urdf, file)
    assert found.notes[0] == "log.csv is UTF-16 text"
    np.testing.assert_array_equal(found.read(file).torque, log.torque)


def test_universal_robots_own_torques_are_named_for_what_they_are(arm, tmp_path):
    urdf, csv, _ = arm
    rows = csv.read_text().split("\n", 1)[1].replace(",", " ")
    names = "timestamp actual_q_0 actual_q_1 target_moment_0 target_moment_1"
    file = tmp_path / "log.csv"
    file.write_text(f"{names}\n{rows}")
    advice = r"target_moment_\{0\.\.1\} are computed by the controller.*maker's own"
    with pytest.raises(ci.RecordingError, match=advice):
        robot_logs(urdf, file)
    stated = Statement(torque="target_moment_{index}")
    assert robot_logs(urdf, file, stated).columns.position == "actual_q_{joint}"


def test_a_robot_without_limits_is_drafted(arm, tmp_path):
    _, log, _ = arm
    urdf = tmp_path / "arm.urdf"
    limits = '<limit lower="-3" upper="3" velocity="4" effort="{}"/>'
    text = URDF.replace(limits.format(90), "").replace(limits.format(60), "")
    assert "<limit" not in text
    urdf.write_text(text)
    draft = ci.draft_problem(urdf, log, select=False, cutoff=10.0)
    assert draft.joints == JOINTS
    assert np.isinf(draft.problem().model.robot.joints[0].limits.upper)


@pytest.mark.parametrize(
    "words", [["0", "-9.81", "0"], ["0,-9.81,0"], ["0", "-9.81,0"]]
)
def test_gravity_may_be_three_words(arm, words, capsys):
    from consistent_id.cli import main

    urdf, log, _ = arm
    more = ["--no-select", "--cutoff", "10", "--dry-run"]
    assert main(["init", *map(str, (urdf, log)), *more, "--gravity", *words]) == 0
    assert "gravity = [0.0, -9.81, 0.0]" in capsys.readouterr().out
