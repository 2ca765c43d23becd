"""Columns beside those of joints that are not read as theirs."""

from pathlib import Path

import numpy as np
import pytest

from consistent_id.errors import RecordingError
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.column_words import channel_of

JOINTS = ("hip", "knee")


def pair(*stems):
    return [f"{stem}{number}" for stem in stems for number in (1, 2)]


def guess_of(names, joints=JOINTS, **known):
    return guess_columns(Path("log"), KnownColumns(joints, names=names, **known))


@pytest.mark.parametrize("clock", ["timestamp", "sim_time", "motor.stamp"])
def test_temperatures_called_temps_are_no_clock_beside_one(clock):
    names = [clock, "temps", *pair("q", "tau")]
    assert guess_of(names).columns.time == clock
    assert guess_of(["temps", *pair("q", "tau")]).columns.time == "temps"


def test_a_french_clock_beside_another_one_is_the_one_that_rises(tmp_path):
    log = tmp_path / "log.csv"
    rows = "".join(f"{0.01 * k},{30 - k % 7},1,2,3,4\n" for k in range(50))
    log.write_text("robot_time,temps,q1,q2,tau1,tau2\n" + rows)
    assert guess_columns(log, KnownColumns(JOINTS)).columns.time == "robot_time"


@pytest.mark.parametrize("channel", ["q", "tau"])
def test_a_number_behind_a_word_of_a_channel_is_the_joint_s(channel):
    """Two encoders or sensors of each joint: the first of both joints is read."""
    ends = pair(channel)
    other = {"q": "tau", "tau": "q"}[channel]
    names = ["t", *pair(other), *(f"{end}_s{k}" for k in (1, 2) for end in ends)]
    columns = guess_of(names).columns
    found = {"q": columns.position, "tau": columns.torque}
    assert found == {channel: f"{channel}{{number}}_s1", other: f"{other}{{number}}"}


def test_a_number_of_a_unit_is_no_joint_s():
    names = ["t", *pair("q", "tau"), "dq1 [rad s^-1]", "dq2 [rad s^-1]", *pair("dq_f")]
    assert guess_of(names).columns.velocity == "dq{number} [rad s^-1]"


def test_columns_of_another_body_are_read_last():
    names = ["t", *pair("base_q", "link_q", "base_dq", "tau")]
    guess = guess_of(names)
    assert guess.columns.position == "link_q{number}"
    assert guess.columns.velocity is None
    assert any("base_dq{number} is not read" in note for note in guess.notes)
    hand = ["t", *pair("gripper_q", "gripper_dq", "gripper_tau")]
    assert guess_of(hand).columns.velocity == "gripper_dq{number}"


def test_an_estimated_velocity_is_one():
    assert guess_of(["t", *pair("q", "dq_est", "tau")]).columns.velocity


@pytest.mark.parametrize("speed", ["omega_motor", "vitesse_moteur", "vitesse_max"])
def test_a_speed_of_something_else_is_not_the_joints_velocity(speed):
    guess = guess_of(["t", *pair("q", speed, "tau")])
    assert guess.columns.velocity is None
    assert any(f"--velocity '{speed}{{number}}'" in note for note in guess.notes)
    of_motors = guess_of(["t", *pair("motor_q", "motor_dq_max", "tau")])
    assert of_motors.columns.velocity is None
    of_motors = guess_of(["t", *pair("motor_q", "motor_omega", "tau")])
    assert of_motors.columns.velocity == "motor_omega{number}"


def test_a_speed_per_minute_is_no_minimum():
    names = ["t", *pair("q", "tau"), "dq1 [rev/min]", "dq2 [rev/min]"]
    assert guess_of(names).columns.velocity == "dq{number} [rev/min]"


def test_an_angular_velocity_of_a_base_or_in_space_is_no_joint_s():
    axes = [f"omega_{axis}" for axis in "xyz"]
    names = ["t", "theta", *axes, "tau"]
    assert guess_of(names, ("hip",)).columns.velocity is None
    assert guess_of(["t", "theta", "omega", "tau"], ("hip",)).columns.velocity
    assert channel_of("imu_omega{number}") == ""
    assert channel_of("omega{number}") == "velocity"
    assert channel_of("q_dot_dot_{number}") == ""


def test_one_column_of_a_flat_log_does_not_hide_currents(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("t,q1,q2,couple,i1,i2\n0,1,2,3,4,5\n1,1,2,3,4,5\n")
    found = guess_columns(log, KnownColumns(JOINTS, currents=True)).columns
    assert found.torque == "i{number}"


@pytest.mark.parametrize(
    ("text", "channel"),
    [
        ("位置偏差{number}", ""),
        ("位置误差{number}", ""),
        ("重力力矩{number}", ""),
        ("外力トルク{number}", ""),
        ("给定力矩{number}", ""),
        ("设定位置{number}", "position_command"),
        ("couple_erreur{number}", ""),
        ("Schleppfehler_Position{number}", ""),
        ("위치오차{number}", ""),
    ],
)
def test_errors_and_commands_in_other_languages_are_not_measured(text, channel):
    assert channel_of(text) == channel


def test_a_reading_that_says_no_more_may_be_the_torque_beside_positions():
    for position in ("q", "J"):
        with pytest.raises(RecordingError, match="only fbk") as caught:
            guess_of(["t", *pair(position, "dq", "fbk_")])
        assert caught.value.options == "--torque 'fbk_{number}'"
    with pytest.raises(RecordingError) as caught:  # fbk are the positions
        guess_of(["t", *pair("fbk_")])
    assert not caught.value.options


def test_commands_of_torque_do_not_hide_other_columns_that_may_be_torque():
    with pytest.raises(RecordingError, match="commands of torque") as caught:
        guess_of(["t", *pair("q", "tau_cmd", "load")])
    assert "only load{1..2} are as many" in str(caught.value)
    assert not caught.value.options  # which of them is open


@pytest.mark.parametrize(
    ("names", "position"),
    [
        (pair("fbk_", "J"), "J{number}"),
        (pair("feedback_J", "J"), "J{number}"),
        (pair("fbk_"), "fbk_{number}"),
        (
            [*pair("fbk_"), "1 pos [deg]", "2 pos [mm]"],
            "{1 pos [deg],2 pos [mm]}",
        ),
    ],
)
def test_a_reading_of_anything_is_a_position_only_if_nothing_else_is(names, position):
    assert guess_of(["t", *names, *pair("tau")]).columns.position == position
    three = ["t", *(f"q{k}" for k in (1, 2, 3)), *pair("fbk_", "tau")]
    with pytest.raises(RecordingError, match="3 columns, the robot has 2"):
        guess_of(three)


def test_commands_in_the_plural_are_not_measured():
    assert channel_of("pos_commands{number}") == "position_command"


@pytest.mark.parametrize("shape", [(9, 3), (9,)])
def test_arrays_that_are_not_of_the_joints_are_left_out(tmp_path, shape):
    """An angular velocity in space, and a torque of a tool beside currents."""
    log = tmp_path / "log.npz"
    of_joints = {name: np.arange(18.0).reshape(9, 2) for name in ("q", "i")}
    others = {name: np.ones(shape) for name in ("omega", "couple")}
    np.savez(log, t=np.arange(9.0), **of_joints, **others)
    guess = guess_columns(log, KnownColumns(JOINTS, currents=True))
    assert guess.columns.velocity is None
    assert guess.columns.torque == "i"
    assert "omega is not read as the velocity" in " ".join(guess.notes)
    np.savez(log, t=np.arange(9.0), **of_joints, omega=of_joints["q"])
    guess = guess_columns(log, KnownColumns(JOINTS, currents=True))
    assert guess.columns.velocity == "omega"
