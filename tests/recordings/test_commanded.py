"""Torque of PD-controlled joints: what gains make of commands."""

from dataclasses import replace

import numpy as np
import pytest

from consistent_id import Columns, Recording, RecordingError, read_recording, resampled
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.signals import PDGains, commanded

TIME = np.arange(200) / 100.0
GAINS = PDGains(np.array([20.0, 50.0]), np.array([1.5, 2.0]))


def log(**changed):
    q = np.column_stack([np.sin(TIME), np.cos(2 * TIME)])
    dq = np.column_stack([np.cos(TIME), -2 * np.sin(2 * TIME)])
    told = np.column_stack([0.3 * TIME, 1.0 - 0.5 * TIME])
    made = Recording(("hip", "knee"), TIME, q, dq, position_command=told)
    return replace(made, **changed)


def before_and_after(told):
    """A held command in the mean: the one before a sample counts as much as its own."""
    return np.vstack([told[:1], (told[:-1] + told[1:]) / 2.0])


def test_torque_is_what_a_pd_drive_does():
    raw = log(velocity_command=np.ones((200, 2)), torque_command=np.full((200, 2), 0.7))
    expected = (
        GAINS.kp * (before_and_after(raw.position_command) - raw.position)
        + GAINS.kd * (1.0 - raw.velocity)
        + 0.7
    )
    np.testing.assert_allclose(commanded(raw, GAINS).torque, expected, atol=1e-13)


def test_a_velocity_that_was_not_told_is_zero():
    here = np.full((200, 2), 0.4)  # at its goal: damping alone is left
    raw = log(position=here, position_command=here)
    expected = -GAINS.kd * raw.velocity
    np.testing.assert_allclose(commanded(raw, GAINS).torque, expected, atol=1e-13)


def test_a_drive_clips_its_torque():
    limited = PDGains(20.0, 1.5, np.array([2.0, np.inf]))
    free, clipped = (commanded(log(), g).torque for g in (PDGains(20.0, 1.5), limited))
    assert abs(free[:, 0]).max() > 2.0
    np.testing.assert_array_equal(clipped[:, 0], np.clip(free[:, 0], -2.0, 2.0))
    np.testing.assert_array_equal(clipped[:, 1], free[:, 1])


def test_late_commands_are_those_of_an_earlier_time():
    delay = 0.0137  # no whole number of samples; a ramp is the same in between
    late, now = (commanded(log(), GAINS, delay=d).torque for d in (delay, 0.0))
    moved = np.array([-0.3, 0.5]) * delay * GAINS.kp
    np.testing.assert_allclose((late - now)[5:], np.tile(moved, (195, 1)), atol=1e-12)


@pytest.mark.parametrize(
    ("gains", "said"),
    [
        (lambda: PDGains(-1.0, 0.0), "kp is -1.0, expected 0 or more"),
        (lambda: PDGains(1.0, 0.0, 0.0), "torque_limit is 0.0, expected positive"),
        (
            lambda: commanded(log(), PDGains(np.ones(3), 0.0)),
            r"kp has 3 values for 2 joints \(hip, knee\); give one for all",
        ),
        (lambda: commanded(log(), GAINS, delay=-1e-3), "expected 0 or more"),
        (
            lambda: commanded(log(position_command=None), GAINS),
            "no position_command",
        ),
    ],
)
def test_what_makes_no_sense_is_refused(gains, said):
    with pytest.raises(RecordingError, match=said):
        gains()


def test_commands_hold_between_samples_when_a_clock_is_made_uniform():
    steps = np.floor(TIME * 10.0)[:, None] * np.ones(2)  # jumps ten times a second
    jittered = log(time=TIME + 2e-3 * np.sin(7e1 * TIME), position_command=steps)
    even = resampled(jittered, 100.0)
    between = ~np.isin(even.position_command[:, 0], steps)
    jumps = np.count_nonzero(np.diff(steps[:, 0]))
    assert np.count_nonzero(between) <= jumps  # one sample, the mean around the jump
    assert (np.diff(even.position_command[:, 0]) >= 0.0).all()


def test_commands_go_with_their_joints_and_samples():
    part = log().of(["knee"]).samples(slice(10, 20))
    assert part.channels == ("position", "velocity", "position_command")
    np.testing.assert_array_equal(
        part.position_command[:, 0], log().position_command[10:20, 1]
    )


def test_commands_are_read_by_the_names_of_their_columns(tmp_path):
    file = tmp_path / "log.csv"
    rows = np.column_stack([TIME, log().position, log().position_command])
    head = "t,q1,q2,qdes1,qdes2"
    np.savetxt(file, rows, delimiter=",", header=head, comments="")
    columns = Columns("t", "q{number}", position_command="qdes{number}")
    read = read_recording(file, ("hip", "knee"), columns)
    np.testing.assert_allclose(
        read.position_command, log().position_command, atol=1e-15
    )
    assert read.torque is None


def guessed(folder, names, joints=("hip", "knee"), **known):
    """Return the guess of a log's columns, with gains for its commands."""
    file, values = folder / "log.csv", np.column_stack([TIME, *[TIME] * len(names)])
    header = ",".join(["time", *names])
    np.savetxt(file, values[:50], delimiter=",", header=header, comments="")
    return guess_columns(file, KnownColumns(joints, commands=True, **known))


@pytest.mark.parametrize(
    "form", "{}.cmd cmd_{} command_{} target_{} goal_{} action_{} {}_des".split()
)
def test_with_gains_a_lone_command_is_one_of_position(tmp_path, form):
    names = [f.format(j) for f in ("{}_pos", form) for j in ("hip", "knee")]
    found = guessed(tmp_path, names)
    assert found.columns.position_command == form.format("{joint}")
    assert "is taken as the position_command" in found.notes[0]
    with pytest.raises(RecordingError, match="found no column that is the torque"):
        guess_columns(tmp_path / "log.csv", KnownColumns(("hip", "knee")))
    better = [*names, "q_des_hip", "q_des_knee"]
    assert guessed(tmp_path, better).columns.position_command == "q_des_{joint}"


def test_of_two_lone_commands_none_is_taken_and_only_real_columns_are_proposed(
    tmp_path,
):
    names = ["hip_pos", "knee_pos", "cmd_hip", "cmd_knee", "goal_hip", "goal_knee"]
    with pytest.raises(RecordingError) as caught:
        guessed(tmp_path, names)
    said = "--position-command 'cmd_{joint}' or --position-command 'goal_{joint}'"
    assert said in str(caught.value)
    for several in (["tau_cmd_hip", "tau_cmd_knee"], ["cmd_hip"], ["fan_1", "fan_2"]):
        with pytest.raises(RecordingError, match="no column that is the") as caught:
            guessed(tmp_path, ["hip_pos", "knee_pos", *several])
        assert "q_des" not in str(caught.value)


@pytest.mark.parametrize("stated", [{}, {"position_command": "commanded_{joint}"}])
def test_exact_names_of_joints_go_before_their_numbers(tmp_path, stated):
    """Numbers of joint_0.0 and joint_1.0 (an Allegro hand) would rename the joints."""
    joints = ("joint_0.0", "joint_1.0")
    names = [f"{kind}_{j}" for kind in ("measured", "commanded") for j in joints]
    found = guessed(tmp_path, names, joints, channels=stated).columns
    assert (found.position, found.names) == ("measured_{joint}", {})
    assert found.position_command == "commanded_{joint}"
