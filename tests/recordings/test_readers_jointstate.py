"""Messages in any order make one recording; what is faulty has joint and time."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_states import JOINTS, START, STEP, logged, state, states

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers import JOINT_STATE, Columns
from consistent_id.recordings.readers.jointstate import (
    BagContent,
    JointMessage,
    recording_of_messages,
)
from consistent_id.recordings.readers.named_arrays import LogName


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
    content = BagContent(messages, {})
    return recording_of_messages(content, joints, columns, LogName("log", "log"), 1.0)


@pytest.mark.slow
@settings(derandomize=True, deadline=None, max_examples=40)
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
    "never seen": (
        [state(START, ["elbow", "wirst"], [1, 2])],
        "'wrist'; other names in the log: wirst. .*--names NAME=wrist",
    ),
    "all others": (
        [state(START, ["A 1", "A 2"], [1, 2])],
        r"names a joint of elbow, wrist.*--names 'A 1=elbow' 'A 2=wrist'",
    ),
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
