"""Joint states of ROS bags, matched by name, whoever wrote them and in which order."""

import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
from joint_states import JOINTS, START, STEP, logged, states
from mcap_ros2.writer import Writer as McapWriter
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from consistent_id.errors import RecordingError
from consistent_id.problems.loading import load_problem
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.readers import JOINT_STATE, Columns, read_recording

TYPES = get_typestore(Stores.ROS2_HUMBLE)
OLD_TYPES = get_typestore(Stores.ROS1_NOETIC)
DEFINITION = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def message(types, stamp, names, position, velocity, effort):
    kinds = types.types
    time = kinds["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
    old = {"seq": 0} if types is OLD_TYPES else {}
    header = kinds["std_msgs/msg/Header"](stamp=time, frame_id="", **old)
    return kinds["sensor_msgs/msg/JointState"](
        header,
        list(names),
        *(np.asarray(v, float) for v in (position, velocity, effort)),
    )


def write_rosbag2(path, topics, storage):
    with rosbag2.Writer(path, version=9, storage_plugin=storage) as bag:
        other = bag.add_connection("/s", "std_msgs/msg/String", typestore=TYPES)
        text = TYPES.types["std_msgs/msg/String"]("free text")
        bag.write(other, START, TYPES.serialize_cdr(text, "std_msgs/msg/String"))
        for topic, content in topics.items():
            kind = "sensor_msgs/msg/JointState"
            connection = bag.add_connection(topic, kind, typestore=TYPES)
            for place, one in enumerate(content):
                raw = TYPES.serialize_cdr(message(TYPES, *one), kind)
                bag.write(connection, logged(place), raw)
    return path


def write_sqlite(folder, topics):
    return write_rosbag2(folder / "bag", topics, rosbag2.StoragePlugin.SQLITE3)


def write_mcap(folder, topics):
    return write_rosbag2(folder / "bag", topics, rosbag2.StoragePlugin.MCAP)


def write_bare_sqlite(folder, topics):
    return next(write_sqlite(folder, topics).glob("*.db3"))


def write_bare_mcap(folder, topics):
    path = folder / "log.mcap"
    with path.open("wb") as file, McapWriter(file) as bag:
        schema = bag.register_msgdef("sensor_msgs/msg/JointState", DEFINITION)
        for topic, content in topics.items():
            for place, (stamp, names, q, dq, tau) in enumerate(content):
                time = {"sec": stamp // 10**9, "nanosec": stamp % 10**9}
                body = {
                    "header": {"stamp": time, "frame_id": ""},
                    "name": list(names),
                    "position": list(q),
                    "velocity": list(dq),
                    "effort": list(tau),
                }
                bag.write_message(topic, schema, body, log_time=logged(place))
    return path


def write_ros1(folder, topics):
    kind, path = "sensor_msgs/msg/JointState", folder / "log.bag"
    with rosbag1.Writer(path) as bag:
        for topic, content in topics.items():
            connection = bag.add_connection(topic, kind, typestore=OLD_TYPES)
            for place, one in enumerate(content):
                raw = OLD_TYPES.serialize_ros1(message(OLD_TYPES, *one), kind)
                bag.write(connection, logged(place), raw)
    return path


WRITERS = [write_sqlite, write_mcap, write_bare_sqlite, write_bare_mcap, write_ros1]


@pytest.fixture(params=WRITERS)
def save(request, tmp_path):
    """Write one topic, or several, in one of the kinds of bags."""

    def saved(content):
        topics = content if isinstance(content, dict) else {"/joint_states": content}
        return request.param(tmp_path, topics)

    return saved


def test_joints_are_matched_by_name_and_effort_is_torque(save):
    path = save(states())
    log = read_recording(path, JOINTS, torque_gain=[1.0, -2.0])
    q = np.array([[1, 0], [1.5, 0.5], [2, 1], [2.5, 1.5]])
    np.testing.assert_array_equal(log.position, q)
    np.testing.assert_array_equal(log.velocity, 10 * q)
    np.testing.assert_array_equal(log.torque, 100 * q * [1, -2])
    np.testing.assert_array_equal(log.time, np.arange(4) * STEP / 1e9)
    assert (log.joints, log.name, log.acceleration) == (JOINTS, path.name, None)


@pytest.mark.slow
def test_the_topic_is_the_one_asked_for(save):
    path = save({"/a/joint_states": states(3), "/b": states(5)})
    assert len(read_recording(path, JOINTS, topic="/b")) == 5
    both = r"2 topics of .*/a/joint_states: wrist.*/b: wrist.*--topic /a/joint_states"
    with pytest.raises(RecordingError, match=both):
        read_recording(path, JOINTS)
    with pytest.raises(RecordingError, match="no topic '/c'; known: "):
        read_recording(path, JOINTS, topic="/c")


@pytest.mark.slow
def test_the_topic_that_names_the_joints_is_taken(save):
    claw = [(stamp, ["claw"], [0.01], [0.0], [0.0]) for stamp, *_ in states(9)]
    path = save({"/gripper": claw, "/joint_states": states(5)})
    assert len(read_recording(path, JOINTS)) == 5
    assert len(read_recording(path, ["claw"])) == 9
    renamed = Columns("header.stamp", "position", names={"claw": "gripper_joint"})
    assert len(read_recording(path, ["gripper_joint"], renamed)) == 9
    with pytest.raises(RecordingError, match=r"2 topics .* 0 of thumb"):
        read_recording(path, ["thumb"])


def test_of_several_topics_the_measured_one_with_effort_is_taken(save):
    bare = [(stamp, names, q, v, []) for stamp, names, q, v, _ in states(7)]
    path = save(
        {"/desired": bare, "/joint_states": states(5), "/cmd/joints": states(9)}
    )
    assert len(read_recording(path, JOINTS)) == 5


@pytest.mark.slow
@pytest.mark.parametrize("topic", ["/sim/joint_states", "/joint_commands", "/model"])
def test_the_only_effort_is_not_that_of_a_simulation_or_of_commands(save, topic):
    bare = [(stamp, names, q, v, []) for stamp, names, q, v, _ in states(7)]
    path = save({"/joint_states": bare, topic: states(5)})
    with pytest.raises(RecordingError, match=r"2 topics .* name joints"):
        read_recording(path, JOINTS)


def test_of_several_measured_topics_one_is_proposed(save):
    path = save({"/left": states(5), "/right": states(7)})
    with pytest.raises(RecordingError, match="2 of them 2 of") as caught:
        read_recording(path, JOINTS)
    assert caught.value.options == "--topic /left"


def test_a_gripper_on_the_same_topic_takes_no_effort_away(save):
    claw = [(stamp + 1, ["claw"], [0.01], [], []) for stamp, *_ in states(5)]
    both = sorted([*states(5), *claw], key=lambda one: one[0])
    path = save({"/joint_states": both})
    columns = guess_columns(path, KnownColumns(tuple(JOINTS))).columns
    assert (columns.velocity, columns.torque) == ("velocity", "effort")


def test_a_topic_of_another_type_is_refused(tmp_path):
    path = write_mcap(tmp_path, {"/joint_states": states()})
    with pytest.raises(RecordingError, match="'/s' is of std_msgs/msg/String, expec"):
        read_recording(path, JOINTS, topic="/s")


def test_a_bag_without_joint_states_is_refused(tmp_path):
    path = write_mcap(tmp_path, {})
    with pytest.raises(RecordingError, match=r"no topic of .*; the bag has /s \(std"):
        read_recording(path, JOINTS)
    path = write_rosbag2(tmp_path / "empty", {"/j": []}, rosbag2.StoragePlugin.SQLITE3)
    with pytest.raises(RecordingError, match="topic '/j' has no message"):
        read_recording(path, JOINTS)


def test_without_stamps_the_time_of_logging_is_used_and_said(save, caplog):
    path = save([(0, *one[1:]) for one in states()])
    log = read_recording(path, JOINTS)
    np.testing.assert_array_equal(log.time, np.arange(4) * STEP / 1e9)
    assert "all stamps are zero" in caplog.text
    assert log.name == f"{path.name} (by time of logging)"


@pytest.mark.parametrize(
    "columns",
    [
        Columns(),
        replace(JOINT_STATE, time="time"),
        replace(JOINT_STATE, acceleration="acceleration"),
        replace(JOINT_STATE, array_joints=JOINTS),
    ],
)
def test_columns_that_joint_states_do_not_have_are_refused(tmp_path, columns):
    with pytest.raises(
        RecordingError, match="not a field of a JointState; its fields are"
    ):
        read_recording(tmp_path / "log.mcap", JOINTS, columns)


@pytest.mark.parametrize("name", ["log.mcap", "log.db3", "log.bag"])
def test_what_is_no_bag_is_refused(tmp_path, name):
    with pytest.raises(RecordingError, match=f"{name}: no such file"):
        read_recording(tmp_path / name, JOINTS)
    (tmp_path / name).write_text("time,q_elbow\n0,1\n" * 500)
    with pytest.raises(RecordingError, match=f"{name}: not readable as ROS bag"):
        read_recording(tmp_path / name, JOINTS)
    with pytest.raises(RecordingError, match=r"without metadata\.yaml is not a bag"):
        read_recording(tmp_path, JOINTS)


def test_no_joints_are_refused(tmp_path):
    with pytest.raises(RecordingError, match="no joint to read"):
        read_recording(write_mcap(tmp_path, {"/j": states()}), ())


def test_a_topic_is_for_bags_only(tmp_path):
    with pytest.raises(RecordingError, match=r"log\.csv: topic '/j' .* only bags"):
        read_recording(tmp_path / "log.csv", JOINTS, topic="/j")


@pytest.mark.slow
@pytest.mark.parametrize("write", WRITERS)
def test_damaged_bags_are_refused_or_read(tmp_path, write):
    path = write(tmp_path, {"/joint_states": states(40)})
    file = path if path.is_file() else next(path.glob("bag*"))
    whole, rng = file.read_bytes(), np.random.default_rng(0)
    for trial in range(16):
        damaged = bytearray(whole)
        for place in rng.integers(0, len(whole), 5):
            damaged[place] = rng.integers(256)
        end = rng.integers(len(whole)) if trial % 4 == 0 else len(whole)
        file.write_bytes(damaged[:end])
        try:
            read_recording(path, JOINTS)
        except RecordingError as refusal:
            assert path.name in str(refusal)
    shutil.rmtree(tmp_path / "bag", ignore_errors=True)


def test_without_rosbags_the_message_says_how_to_install_it(tmp_path, monkeypatch):
    path = write_bare_mcap(tmp_path, {"/j": states()})
    monkeypatch.setitem(sys.modules, "rosbags", None)
    monkeypatch.setitem(sys.modules, "rosbags.rosbag1", None)
    with pytest.raises(RecordingError, match=r"pip install 'consistent-id\[ros\]'"):
        read_recording(path, JOINTS)


def test_a_problem_names_the_topic_and_its_fields(tmp_path):
    write_bare_mcap(tmp_path, {"/arm": states(40, ("J1",)), "/hand": states(40, "x")})
    (tmp_path / "problem.toml").write_text(
        'name = "arm"\n[model]\nmodified_dh = [{alpha_deg = 0, a = 0}]\n'
        '[constraints]\nmasses = "free"\n'
        '[data]\ntopic = "/arm"\n[data.columns]\ntime = "header.stamp"\n'
        'position = "position"\ntorque = "effort"\nnames = {J1 = "joint1"}\n'
        '[[data.recordings]]\nfile = "log.mcap"\nrole = "training"\n'
    )
    (log,) = load_problem(tmp_path).training
    np.testing.assert_array_equal(log.torque, 50 * np.arange(40)[:, None])


def test_a_problem_needs_no_columns_for_joint_states(tmp_path):
    write_mcap(tmp_path, {"/arm": states(40, ("joint1",))})
    (tmp_path / "problem.toml").write_text(
        'name = "arm"\n[model]\nmodified_dh = [{alpha_deg = 0, a = 0}]\n'
        '[constraints]\nmasses = "free"\n'
        '[data]\n[[data.recordings]]\nfile = "bag"\nrole = "training"\n'
    )
    (log,) = load_problem(tmp_path).training
    np.testing.assert_array_equal(log.velocity, 5 * np.arange(40)[:, None])
