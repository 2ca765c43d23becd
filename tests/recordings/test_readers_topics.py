"""Inertial units, poses, wrenches and flags of ROS bags, on the joints' clock."""

from dataclasses import replace

import numpy as np
import pytest
import ros_topics as ros
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from some_fast import some_fast

import consistent_id as ci

START = 1_700_000_000_123_456_789  # ns
JOINTS = ("hip", "knee")
UNIT = ci.recordings.BaseColumns("/imu.angular_velocity", "/imu.linear_acceleration")
POSE = ci.recordings.BaseColumns(
    position="/odom.pose.pose.position", orientation="/odom.pose.pose.orientation"
)


def stamps(rate, seconds=6.0, first=0.0):
    times = np.round((first + np.arange(seconds * rate) / rate) * 1e9)
    return [START + int(time) for time in times]


def at(stamp):
    return (stamp - START) / 1e9


def joints(rate=200.0, seconds=6.0, delay=7_000_000):
    def content(t):
        q = [np.sin(3 * t), np.cos(2 * t)]
        return {"name": list(JOINTS), "position": np.array(q)}

    made = [(s, content(at(s))) for s in stamps(rate, seconds)]
    empty = {"velocity": np.zeros(0), "effort": np.zeros(0)}
    messages = [(s + delay, {"header": ros.header(s), **c, **empty}) for s, c in made]
    return "sensor_msgs/msg/JointState", messages


def turned(t):
    """A turn about z by 0.8 sin(2 t): angle and rate."""
    return 0.8 * np.sin(2 * t), 1.6 * np.cos(2 * t)


def imu(rate=500.0, **when):
    def content(t):
        return {
            "angular_velocity": ros.axes([0.1, 0.2, turned(t)[1]]),
            "linear_acceleration": ros.axes([0.0, np.sin(4 * t), 9.81]),
        }

    made = [
        (s + 2_000_000, {"header": ros.header(s), **content(at(s))})
        for s in stamps(rate, **when)
    ]
    return "sensor_msgs/msg/Imu", made


def odometry(rate=250.0, **when):
    def content(k, t):
        half = turned(t)[0] / 2
        sign = -1.0 if k % 7 == 3 else 1.0  # q and -q are the same turn
        turn = sign * np.array([0, 0, np.sin(half), np.cos(half)])
        pose = {
            "position": ros.axes([1.0, 2.0, 0.4 + 0.1 * np.sin(3 * t)]),
            "orientation": ros.axes(turn, "xyzw"),
        }
        return {"pose": {"pose": pose}}

    made = [
        (s, {"header": ros.header(s), **content(k, at(s))})
        for k, s in enumerate(stamps(rate, **when))
    ]
    return "nav_msgs/msg/Odometry", made


def wrench():
    def content(t):
        parts = {"force": ros.axes([1.0, 2.0, 50 * t]), "torque": ros.axes([4, 5, 6])}
        return {"wrench": parts}

    return "geometry_msgs/msg/WrenchStamped", [
        (s, {"header": ros.header(s), **content(at(s))}) for s in stamps(200.0)
    ]


def flags():
    """Without a header: of the time of logging alone."""
    made = [(s, {"data": bool(2.0 <= at(s) < 4.0)}) for s in stamps(20.0, 7.0, -0.5)]
    return "std_msgs/msg/Bool", made


def read(path, columns=None, **beside):
    wanted = replace(
        columns or ci.recordings.JOINT_STATE,
        velocity=None,
        torque=None,
        beside=ci.recordings.BesideColumns(**beside),
    )
    return ci.read_recording(path, JOINTS, wanted)


@pytest.fixture(scope="module", params=some_fast(["mcap", "ros1"]))
def bag(request, tmp_path_factory):
    tmp_path = tmp_path_factory.mktemp("bags")
    topics = {"/joint_states": joints(), "/imu": imu(), "/odom": odometry()}
    topics |= {"/sole": wrench(), "/foot": flags()}
    if request.param == "mcap":
        return ros.write_mcap(tmp_path / "bag", topics)
    return ros.write_ros1(tmp_path / "log.bag", topics)


@pytest.mark.slow
def test_an_inertial_unit_is_read_at_the_joints_samples(bag):
    log = read(bag, base=UNIT)
    assert len(log) > 1190
    inside = (log.time > 0.5) & (log.time < 5.5)
    t = log.time[inside]
    # 500 Hz is filtered to 80 Hz for joints of 200 Hz: signals of 1 Hz stay.
    w = log.base.angular_velocity[inside]
    assert np.allclose(w[:, 2], turned(t)[1], atol=1e-4)
    assert np.allclose(w[:, :2], [0.1, 0.2], atol=1e-6)
    felt = log.base.specific_force[inside]
    assert np.allclose(felt[:, 1], np.sin(4 * t), atol=1e-4)
    assert np.allclose(log.position[inside, 0], np.sin(3 * t), atol=1e-9)


@pytest.mark.slow
def test_odometry_gives_the_bases_motion_whatever_the_quaternions_sign(bag):
    log = read(bag, base=POSE)
    inside = (log.time > 0.5) & (log.time < 5.5)
    t = log.time[inside]
    w = log.base.angular_velocity[inside]
    assert np.allclose(w[:, 2], turned(t)[1], atol=2e-3)
    up = 9.81 - 0.9 * np.sin(3 * t)
    assert np.allclose(log.base.specific_force[inside, 2], up, atol=2e-3)


@pytest.mark.slow
def test_wrenches_and_flags_of_other_topics(bag):
    sole = ci.recordings.WrenchColumns("left_sole", "/sole.wrench")
    foot = ci.recordings.ContactColumns("left_foot", "/foot.data")
    log = read(bag, wrenches=[sole], contacts=[foot])
    (measured,), (closed,) = log.wrenches, log.contacts
    expected = np.column_stack(
        [np.ones_like(log.time), 2 + 0 * log.time, 50 * log.time]
    )
    assert np.allclose(measured.values[:, :3], expected, atol=1e-5)
    assert np.allclose(measured.values[:, 3:], [4, 5, 6])
    # The flag comes 20 times a second and holds until the next.
    inner = (log.time > 2.05) & (log.time < 3.95)
    outer = (log.time < 1.95) | (log.time > 4.05)
    assert closed.closed[inner].all() and not closed.closed[outer].any()
    force = ci.recordings.ContactColumns(
        "left_foot", "/sole.wrench.force.z", threshold=100.0
    )
    (pressed,) = read(bag, contacts=[force]).contacts
    assert np.array_equal(pressed.closed, log.time > 2.0 + 1e-6)


@pytest.mark.slow
def test_a_gap_of_a_topic_is_left_out_and_said(tmp_path, caplog):
    kind, messages = imu(200.0)
    messages = [m for m in messages if not 2.0 < at(m[0]) < 2.5]
    topics = {"/joint_states": joints(), "/imu": (kind, messages)}
    log = read(ros.write_mcap(tmp_path / "bag", topics), base=UNIT)
    assert "/imu.angular_velocity has no message around" in caplog.text
    assert "the first gap is at t = 2" in caplog.text
    assert not ((log.time > 2.01) & (log.time < 2.49)).any()
    # Nothing is differentiated across the gap: its edges are as right as the rest.
    slope = log.base.angular_acceleration[:, 2]
    assert np.allclose(slope, -3.2 * np.sin(2 * log.time), atol=2e-2)


def test_a_pose_with_jittered_stamps_is_differentiated_by_its_own_times(tmp_path):
    rng = np.random.default_rng(0)
    time = np.sort(0.01 * np.arange(600) + rng.uniform(-2e-3, 2e-3, 600))
    angle, rate = turned(time)
    still = np.zeros(600)
    base = ci.signals.base_from_pose(
        time,
        np.column_stack([still, still, 0.1 * np.sin(3 * time)]),
        np.column_stack([still, still, np.sin(angle / 2), np.cos(angle / 2)]),
        order="xyzw",
        cutoff=None,
    )
    inside = slice(10, -10)
    assert np.allclose(base.angular_velocity[inside, 2], rate[inside], atol=2e-3)
    up = 9.81 - 0.9 * np.sin(3 * time)
    assert np.allclose(base.specific_force[inside, 2], up[inside], atol=5e-3)


@pytest.mark.slow
def test_slower_topics_are_named_with_the_frequency_that_they_allow(tmp_path, caplog):
    topics = {"/joint_states": joints(), "/imu": imu(50.0)}
    read(ros.write_mcap(tmp_path / "bag", topics), base=UNIT)
    assert "comes 50 times a second" in caplog.text
    assert "below 20 Hz" in caplog.text


@pytest.mark.slow
def test_topics_without_an_instant_in_common_are_refused(tmp_path):
    topics = {"/joint_states": joints(), "/imu": imu(first=100.0)}
    path = ros.write_mcap(tmp_path / "bag", topics)
    with pytest.raises(ci.RecordingError, match=r"no joint state lies .*log_time"):
        read(path, base=UNIT)


@pytest.mark.slow
def test_by_time_of_logging_all_topics_are(tmp_path):
    kind, messages = imu()
    # Its header counts from zero, and is of no use.
    messages = [(log, {**c, "header": ros.header(log - START)}) for log, c in messages]
    topics = {"/joint_states": joints(delay=2_000_000), "/imu": (kind, messages)}
    path = ros.write_mcap(tmp_path / "bag", topics)
    log = read(path, replace(ci.recordings.JOINT_STATE, time="log_time"), base=UNIT)
    inside = (log.time > 0.5) & (log.time < 5.5)
    expected = turned(log.time[inside])[1]
    assert np.allclose(log.base.angular_velocity[inside, 2], expected, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("/imu", "names no field of a topic's messages"),
        ("/inu.angular_velocity", "no topic '/inu'; known: /imu"),
        (
            "/imu.angular_velocty",
            "/imu has no field 'angular_velocty'; known: angular",
        ),
        ("/imu.header", "holds str"),
        ("/imu.orientation", "4 columns, expected 3"),
    ],
)
def test_faulty_names_are_told(tmp_path, name, message):
    topics = {"/joint_states": joints(seconds=2.0), "/imu": imu(seconds=2.0)}
    path = ros.write_mcap(tmp_path / "bag", topics)
    with pytest.raises(ci.RecordingError, match=message):
        read(path, base=replace(UNIT, angular_velocity=name))


@pytest.mark.slow
def test_kinds_that_the_bag_defines_are_read(tmp_path):
    types = get_typestore(Stores.ROS2_HUMBLE)
    text = "std_msgs/Header header\nfloat32[4] force\n"
    types.register(get_types_from_msg(text, "maker_msgs/msg/Feet"))
    made = [
        (s, {"header": ros.header(s), "force": np.array([1, 2, 3, 60 * at(s)], "f4")})
        for s in stamps(200.0)
    ]
    topics = {"/joint_states": joints(), "/feet": ("maker_msgs/msg/Feet", made)}
    path = ros.write_mcap(tmp_path / "bag", topics, types)
    foot = ci.recordings.ContactColumns("rear", "/feet.force[3:4]", threshold=120.0)
    (pressed,) = (log := read(path, contacts=[foot])).contacts
    assert np.array_equal(pressed.closed, log.time > 2.0 + 1e-6)
