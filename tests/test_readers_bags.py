"""Joint states of ROS bags, matched by name, whoever wrote them and in which order."""

import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap_ros2.writer import Writer as McapWriter
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from consistent_id.errors import RecordingError
from consistent_id.problem import load_problem
from consistent_id.readers import JOINT_STATE, Columns, read_recording
from consistent_id.readers.jointstate import JointMessage, recording_of_messages

JOINTS = ("elbow", "wrist")
START = 1_700_000_000_123_456_789  # ns
STEP = 2_000_001
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


def state(stamp, names, position, velocity=None, effort=None):
    """One message: stamp in ns, joints and values; velocity 10 q, effort 100 q."""
    q = np.asarray(position, float)
    velocity = 10 * q if velocity is None else velocity
    return stamp, names, q, velocity, 100 * q if effort is None else effort


def states(count=4, names=("wrist", "elbow", "finger"), start=START):
    return [
        state(start + k * STEP, names, np.arange(len(names)) + 0.5 * k)
        for k in range(count)
    ]


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


def logged(place):
    return START + 500_000_000 + place * STEP  # ns


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


def from_messages(content, joints=JOINTS, columns=JOINT_STATE):
    """Return the recording without a file; messages as a bag gives them."""
    messages = [
        JointMessage(
            logged(place),
            stamp,
            names,
            {"position": q, "velocity": np.asarray(dq), "effort": np.asarray(tau)},
        )
        for place, (stamp, names, q, dq, tau) in enumerate(content)
    ]
    return recording_of_messages(
        messages, joints, columns, where="log", name="log", torque_gain=1.0
    )


def test_joints_are_matched_by_name_and_effort_is_torque(save):
    path = save(states())
    log = read_recording(path, JOINTS, torque_gain=[1.0, -2.0])
    q = np.array([[1, 0], [1.5, 0.5], [2, 1], [2.5, 1.5]])
    np.testing.assert_array_equal(log.position, q)
    np.testing.assert_array_equal(log.velocity, 10 * q)
    np.testing.assert_array_equal(log.torque, 100 * q * [1, -2])
    np.testing.assert_array_equal(log.time, np.arange(4) * STEP / 1e9)
    assert (log.joints, log.name, log.acceleration) == (JOINTS, path.name, None)


def test_the_topic_is_the_one_asked_for(save):
    path = save({"/a/joint_states": states(3), "/b": states(5)})
    assert len(read_recording(path, JOINTS, topic="/b")) == 5
    with pytest.raises(RecordingError, match=r"2 topics of .*/a/joint_states, /b"):
        read_recording(path, JOINTS)
    with pytest.raises(RecordingError, match="no topic '/c'; known: "):
        read_recording(path, JOINTS, topic="/c")


def test_a_topic_of_another_type_is_refused(tmp_path):
    path = write_mcap(tmp_path, {"/joint_states": states()})
    with pytest.raises(RecordingError, match="'/s' is of std_msgs/msg/String, expec"):
        read_recording(path, JOINTS, topic="/s")


def test_a_bag_without_joint_states_is_refused(tmp_path):
    path = write_mcap(tmp_path, {})
    with pytest.raises(RecordingError, match=r"0 topics of .*\(none\)"):
        read_recording(path, JOINTS)
    path = write_rosbag2(tmp_path / "empty", {"/j": []}, rosbag2.StoragePlugin.SQLITE3)
    with pytest.raises(RecordingError, match="topic '/j' has no message"):
        read_recording(path, JOINTS)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(st.data())
def test_the_order_of_joints_may_change_from_message_to_message(data):
    table = np.arange(12.0).reshape(4, 3)
    content = []
    for k, row in enumerate(table):
        order = data.draw(st.permutations(range(3)))
        cut = data.draw(st.integers(0, 3))  # the sample comes in two messages
        for part in (order[:cut], order[cut:]):
            names = ["abc"[i] for i in part]
            content.append(state(START + k * STEP, names, row[list(part)]))
    log = from_messages(content, ("c", "a"))
    np.testing.assert_array_equal(log.position, table[:, [2, 0]])
    np.testing.assert_array_equal(log.torque, 100 * table[:, [2, 0]])


def test_messages_of_other_joints_are_passed_over():
    other = [state(START + k, ["finger"], [0.0], [], [np.nan]) for k in range(9)]
    log = from_messages([*other, *states()])
    np.testing.assert_array_equal(log.position, from_messages(states()).position)


def test_what_joints_lack_that_are_not_wanted_is_tolerated():
    names = ("elbow", "wrist", "finger")
    content = [
        state(START + k, names, [k, 2, np.nan], [1, 2, np.inf], [3, 4, np.nan])
        for k in range(3)
    ]
    np.testing.assert_array_equal(from_messages(content).torque, [[3, 4]] * 3)


def test_a_seldom_joint_decides_which_samples_there_are(caplog):
    fast = [state(START + k, ["elbow"], [k]) for k in range(10)]
    slow = [state(START + k, ["wrist"], [-k]) for k in range(0, 10, 5)]
    log = from_messages(fast + slow)
    np.testing.assert_array_equal(log.position, [[0, 0], [5, -5]])
    assert "8 of 10 samples lack a joint" in caplog.text


def test_a_message_that_was_logged_twice_counts_once():
    content = states()
    assert len(from_messages([content[0], *content])) == 4


def test_interleaved_publishers_need_not_be_in_order():
    arm = [state(START + k * 10, ["elbow"], [k]) for k in range(4)]
    hand = [state(START + k * 10, ["wrist"], [k]) for k in range(4)]
    log = from_messages([arm[0], arm[1], hand[0], arm[2], arm[3], *hand[1:]])
    np.testing.assert_array_equal(log.position, np.arange(4)[:, None] * [1, 1])


def test_without_stamps_the_time_of_logging_is_used_and_said(save, caplog):
    path = save([(0, *one[1:]) for one in states()])
    log = read_recording(path, JOINTS)
    np.testing.assert_array_equal(log.time, np.arange(4) * STEP / 1e9)
    assert "all stamps are zero" in caplog.text
    assert log.name == f"{path.name} (by time of logging)"


def test_the_time_of_logging_may_be_asked_for(caplog):
    content = [(START, *one[1:]) for one in states()]
    log = from_messages(content, columns=replace(JOINT_STATE, time="log_time"))
    np.testing.assert_array_equal(log.time, np.arange(4) * STEP / 1e9)
    assert not caplog.text


def test_time_keeps_its_nanoseconds():
    content = [state(START + k, JOINTS, [0, k]) for k in range(3)]
    np.testing.assert_array_equal(from_messages(content).time, [0, 1e-9, 2e-9])


def test_simulated_time_may_start_at_zero():
    assert from_messages(states(start=0)).duration == 3 * STEP / 1e9


def test_channels_and_names_can_be_chosen():
    columns = Columns(
        "header.stamp", "position", torque="effort", names={"J1": "elbow"}
    )
    content = [state(START + k, ["J1"], [k], []) for k in range(3)]
    log = from_messages(content, ["elbow"], columns)
    assert log.velocity is None
    np.testing.assert_array_equal(log.torque, [[0], [100], [200]])


AT = r"1700000000\.123456789 s"
GOOD = state(START, JOINTS, [1, 2])
FAULTY = {
    "empty velocity": (
        [state(START, JOINTS, [1, 2], [])],
        f"no velocity of joint 'elbow' at {AT} .0 values, 2 names.*Leave velocity out",
    ),
    "empty effort": (
        [state(START, JOINTS, [1, 2], None, [])],
        "no effort of joint 'elb",
    ),
    "short position": (
        [state(START, JOINTS, [1], [1, 2])],
        "no position of joint 'elb",
    ),
    "nan": (
        [state(START, JOINTS, [1, 2], None, [3, np.nan])],
        f"effort of joint 'wrist' is nan at {AT}",
    ),
    "inf later": (
        [GOOD, state(START + 10**9, JOINTS, [-np.inf, 2], [1, 2], [1, 2])],
        r"position of joint 'elbow' is -inf at 1700000001\.123456789 s",
    ),
    "never seen": ([state(START, ["elbow", "wirst"], [1, 2])], "'wrist'; known: wirst"),
    "twice": (
        [state(START, ["elbow", "wrist", "elbow"], [1, 2, 3])],
        "names joint 'elbow' twice",
    ),
    "two values": (
        [GOOD, state(START, JOINTS, [1, 3])],
        f"'wrist' has two values at {AT}",
    ),
    "back in time": (
        [GOOD, state(START - 10**9, JOINTS, [1, 2])],
        rf"joint 'elbow' goes from {AT} back to 1699999999\.123456789 s",
    ),
    "some stamps": (
        [state(0, JOINTS, [1, 2]), GOOD],
        "some stamps of joint 'elbow' are z",
    ),
    "one sample": ([GOOD], "1 samples, expected 2"),
    "apart": (
        [state(START + k, [JOINTS[k % 2]], [1]) for k in range(6)],
        "'elbow' and 'wrist' come in messages .* 0 of 3 samples have all",
    ),
}


@pytest.mark.parametrize(("content", "message"), FAULTY.values(), ids=FAULTY)
def test_faulty_messages_are_refused_with_joint_and_time(content, message):
    with pytest.raises(RecordingError, match=f"log: .*{message}"):
        from_messages(content)


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
    with pytest.raises(RecordingError, match="nothing of a JointState; its fields are"):
        read_recording(tmp_path / "log.mcap", JOINTS, columns)


@pytest.mark.parametrize("name", ["log.mcap", "log.db3", "log.bag"])
def test_what_is_no_bag_is_refused(tmp_path, name):
    with pytest.raises(RecordingError, match=f"{name}: no such file"):
        read_recording(tmp_path / name, JOINTS)
    (tmp_path / name).write_text("time,q_elbow\n0,1\n" * 500)
    with pytest.raises(RecordingError, match=f"{name}: not readable as ROS bag"):
        read_recording(tmp_path / name, JOINTS)
    with pytest.raises(RecordingError, match=r"without metadata\.yaml is no bag"):
        read_recording(tmp_path, JOINTS)


def test_no_joints_are_refused(tmp_path):
    with pytest.raises(RecordingError, match="no joint to read"):
        read_recording(write_mcap(tmp_path, {"/j": states()}), ())


def test_a_topic_is_for_bags_only(tmp_path):
    with pytest.raises(RecordingError, match=r"log\.csv: topic '/j' .* only bags"):
        read_recording(tmp_path / "log.csv", JOINTS, topic="/j")


@pytest.mark.parametrize("write", WRITERS)
def test_damaged_bags_are_refused_or_read(tmp_path, write):
    path = write(tmp_path, {"/joint_states": states(40)})
    file = path if path.is_file() else next(path.glob("bag*"))
    whole, rng = file.read_bytes(), np.random.default_rng(0)
    for trial in range(40):
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
