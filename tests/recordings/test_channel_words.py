"""Which columns are a joint's: bare names, forces, measured ones, clocks."""

from pathlib import Path

import numpy as np
import pytest
from guessed_columns import SIX, guessed, numbered

from consistent_id import RecordingError, read_recording
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.column_words import channel_of


@pytest.mark.parametrize(
    ("position", "torque", "unit"),
    [
        ("J{}", "TRQ{}", None),
        ("J{} [deg]", "Torque J{} [Nm]", "deg"),
        ("A{}", "eff_{}", None),
        ("Joint {} (deg)", "jts_{}", "deg"),
    ],
)
def test_bare_names_of_joints_are_positions(tmp_path, position, torque, unit):
    names = ["time", *numbered(position, torque)]
    found = guessed(tmp_path, names).columns
    assert found.position == position.replace("{}", "{number}")
    assert found.torque == torque.replace("{}", "{number}")
    assert found.units.get("position") == unit


def test_bare_names_give_way_to_a_word(tmp_path):
    names = ["time", *numbered("J{}", "pos_{}", "tau_{}")]
    assert guessed(tmp_path, names).columns.position == "pos_{number}"
    names = ["time", *(f"{j}_deg" for j in SIX), *(f"{j}_torque" for j in SIX)]
    found = guessed(tmp_path, names).columns
    assert (found.position, found.units["position"]) == ("{joint}_deg", "deg")


@pytest.mark.parametrize(
    ("name", "channel"),
    [
        ("q_dot_{number}", "velocity"),
        ("pos_dot{number}", "velocity"),
        ("q_ddot_{number}", ""),
        ("q_err_{number}", ""),
        ("pos_acc_{number}", ""),
        ("tau_gravity_{number}", ""),
        ("tau_est_{number}", "torque"),
    ],
)
def test_rates_errors_and_computed_torques_are_told_apart(name, channel):
    assert channel_of(name) == channel


def test_the_only_unknown_columns_are_proposed_as_the_torque(tmp_path):
    names = ["time", *numbered("q_{}", "Ist_{}", "q_err_{}")]
    with pytest.raises(RecordingError, match=r"only Ist_\{1\.\.6\}") as refused:
        guessed(tmp_path, names)
    assert refused.value.options == "--torque 'Ist_{number}'"


def test_arrays_with_brackets_are_not_mapped_by_their_digits(tmp_path):
    names = ["time", *numbered("q[{}]", "tau_J[{}]", first=0, count=5)]
    with pytest.raises(RecordingError) as refused:
        guessed(tmp_path, names, joints=SIX)
    assert refused.value.options == "--lock axis_f"


@pytest.mark.parametrize("fraction", ["nanosec", "nsec", "usec"])
def test_a_clock_of_two_columns_is_their_sum(tmp_path, fraction):
    names = ["stamp.sec", f"stamp.{fraction}", *numbered("q{}", "tau{}", count=2)]
    columns = guessed(tmp_path, names, joints=SIX[:2]).columns
    assert columns.time == f"stamp.sec + stamp.{fraction}"
    unit = 1e-6 if fraction == "usec" else 1e-9
    rows = [f"7,{round(k / 100 / unit)},1,1,1,1" for k in range(9)]
    (tmp_path / "log.csv").write_text("\n".join([",".join(names), *rows]))
    log = read_recording(tmp_path / "log.csv", SIX[:2], columns)
    np.testing.assert_allclose(log.time, 7 + np.arange(9) / 100, rtol=1e-12)


class Watched(str):
    """A column's name that counts how often it is compared or looked into."""

    looks = 0

    def __eq__(self, other):
        Watched.looks += 1
        return str.__eq__(self, other)

    def __hash__(self):
        Watched.looks += 1
        return str.__hash__(self)

    def lower(self):
        Watched.looks += 1
        return str.lower(self)


@pytest.mark.slow
@pytest.mark.parametrize("other", ["sensor_{}", "x{}_torque_extra", "action_{0}_{0}"])
def test_many_columns_are_not_each_compared_with_every_other(other):
    def looks(count):
        others = [other.format(k) for k in range(count)]
        names = ["time", *numbered("q{}", "tau{}"), *others]
        Watched.looks = 0
        known = KnownColumns(SIX, names=[Watched(n) for n in names])
        found = guess_columns(Path("log.csv"), known)
        assert found.columns.position == "q{number}"
        return Watched.looks

    # Four times as many: 16 times, if every name is compared with every other.
    assert 0 < looks(1600) < 6 * looks(400)


AXES = ("x", "y")
MOVED = ["time", "x_pos", "y_pos"]


def test_forces_of_sliding_joints_are_their_torque(tmp_path):
    names = [*MOVED, "x_force", "y_force"]
    found = guessed(tmp_path, names, AXES, sliding=frozenset(AXES))
    assert found.columns.torque == "{joint}_force"
    with pytest.raises(
        RecordingError, match=r"torque of x is in \{joint\}_force, that"
    ):
        guessed(tmp_path, names, AXES, sliding=frozenset("x"))  # the other turns


@pytest.mark.parametrize(
    "word", ["tcp_force", "contact_force", "force_ext", "gripper_force", "max_force"]
)
def test_other_forces_are_no_torque_of_joints(tmp_path, word):
    names = [*MOVED, f"x_{word}", f"y_{word}"]
    with pytest.raises(RecordingError, match="found no column that is the torque"):
        guessed(tmp_path, names, AXES, sliding=frozenset(AXES))


def test_torque_is_read_before_current_and_current_before_force(tmp_path):
    names = [*MOVED, "x_force", "y_force", "x_current", "y_current"]
    slide = frozenset(AXES)
    found = guessed(tmp_path, names, AXES, currents=True, sliding=slide)
    assert found.columns.torque == "{joint}_current"
    found = guessed(tmp_path, names, AXES, sliding=slide)
    assert found.columns.torque == "{joint}_force"
    found = guessed(tmp_path, [*names, "x_tau", "y_tau"], AXES, sliding=slide)
    assert found.columns.torque == "{joint}_tau"


def test_a_joint_of_one_letter_is_not_found_within_a_word(tmp_path):
    names = ["time", "y_position", "y_velocity", "y_torque"]
    found = guessed(tmp_path, names, ["y"]).columns
    assert found.position == "{joint}_position"
    assert found.velocity == "{joint}_velocity"


def test_greek_letters_are_words(tmp_path):
    found = guessed(tmp_path, ["time", "θ_x", "θ_y", "τ_x", "τ_y"], AXES).columns
    assert (found.position, found.torque) == ("θ_{joint}", "τ_{joint}")


@pytest.mark.parametrize(
    ("position", "torque", "other"),
    [
        ("q_meas_{}", "tau_meas_{}", ("q_sim_{}", "tau_ff_{}")),
        ("q_real_{}", "tau_real_{}", ("q_sim_{}", "tau_sim_{}")),
        ("q_{}", "tau_{}", ("q_max_{}", "tau_model_{}")),
        ("joint_pos{}", "torque{}", ("motor_pos{}", "torque_nominal{}")),
        (
            "A{} Winkel Ist",
            "A{} Drehmoment",
            ("A{} Winkel Soll", "A{} Drehmoment Soll"),
        ),
    ],
)
def test_measured_columns_are_read_before_others(tmp_path, position, torque, other):
    names = ["time", *numbered(*other, position, torque)]
    found = guessed(tmp_path, names).columns
    assert found.position == position.format("{number}")
    assert found.torque == torque.format("{number}")


def test_the_torque_of_a_joint_goes_before_that_of_its_motor():
    names = ["t", "q0", "q1"]
    names += [f"actual_{of}_torque[{k}]" for of in ("motor", "joint") for k in (0, 1)]
    found = guess_columns(Path("log.csv"), KnownColumns(("a", "b"), names=names))
    assert found.columns.torque == "actual_joint_torque[{joint}]"
    found = guess_columns(Path("log.csv"), KnownColumns(("a", "b"), names=names[:5]))
    assert found.columns.torque == "actual_motor_torque[{joint}]"


def test_a_tools_pose_is_no_channel_of_joints():
    names = ["actual_TCP_pose_{number}", "tcp.position", "ee_pos", "tip.torque"]
    assert [channel_of(name) for name in names] == [""] * 4


@pytest.mark.parametrize(
    ("name", "channel"),
    [
        ("out.q.time", ""),
        ("q.signals.dimensions", ""),
        ("observation/robot_state/joint_velocities", "velocity"),
        ("observation/robot_state/motor_torques", "torque"),
        ("observation.state", "position"),
    ],
)
def test_clocks_and_other_channels_of_a_state_are_no_positions(name, channel):
    assert channel_of(name) == channel


@pytest.mark.parametrize(
    "marks",
    [
        ("L_{}", "R_{}"),
        ("{}_left_", "{}_right_"),
        ("{}_a_", "{}_b_"),
        ("arm1.{}", "arm2.{}"),
    ],
)
def test_the_torque_is_that_of_the_arm_whose_position_is_read(tmp_path, marks):
    """Of two arms with equal names, the order of columns does not mix them."""
    one, other = (f"{mark}{{{{}}}}" for mark in marks)
    order = [one.format("q"), other.format("q"), other.format("tau"), one.format("tau")]
    columns = guessed(tmp_path, ["time", *numbered(*order)]).columns
    assert columns.position == one.format("q").format("{number}")
    assert columns.torque == one.format("tau").format("{number}")
    stated = {"position": other.format("q").format("{number}")}
    columns = guessed(tmp_path, ["time", *numbered(*order)], channels=stated).columns
    assert columns.torque == other.format("tau").format("{number}")


def test_the_last_number_is_the_joints_unless_a_word_says_so(tmp_path):
    """Of two arms with two joints each, either number may count."""
    two = SIX[:2]
    grid = [f"robot{r}.{c}_{k}" for c in ("q", "tau") for r in (1, 2) for k in (1, 2)]
    columns = guessed(tmp_path, ["time", *grid], joints=two).columns
    assert columns.position == "robot1.q_{number}"
    assert columns.torque == "robot1.tau_{number}"
    grid = [f"joint{k}.{c}{s}" for c in ("pos", "tau") for s in (1, 2) for k in (1, 2)]
    columns = guessed(tmp_path, ["time", *grid], joints=two).columns
    assert columns.position == "joint{number}.pos1"
    assert columns.torque == "joint{number}.tau1"


def test_the_position_is_that_of_which_all_channels_are(tmp_path):
    """Here r is a reference and m a measurement, of which no word is known."""
    names = ["time", *numbered("q_r{}", "q_m{}", "dq_m{}", "tau_r{}", "tau_m{}")]
    columns = guessed(tmp_path, names).columns
    assert (columns.position, columns.velocity) == ("q_m{number}", "dq_m{number}")
    assert columns.torque == "tau_m{number}"


def test_a_plain_position_goes_before_one_with_a_further_word(tmp_path):
    names = ["time", *numbered("q{}", "q_filt{}", "dq_filt{}", "tau_filt{}", "tau{}")]
    columns = guessed(tmp_path, names).columns
    assert (columns.position, columns.torque) == ("q{number}", "tau{number}")


@pytest.mark.parametrize("word", ["meas", "msr", "fbk"])
def test_measured_numbers_of_joints_are_positions(tmp_path, word):
    names = ["time", *numbered(f"A{{}}_{word}", "A{}_cmd", "A{}_torque")]
    assert guessed(tmp_path, names).columns.position == f"A{{number}}_{word}"


def test_commands_of_torque_are_proposed_where_none_is_measured(tmp_path):
    names = ["time", *numbered("q{}", "tau_cmd{}", "tau_ext{}")]
    with pytest.raises(RecordingError, match="commands of torque, not") as refused:
        guessed(tmp_path, names)
    assert refused.value.options == "--torque 'tau_cmd{number}'"
    with pytest.raises(RecordingError, match="cannot be found without torque"):
        guessed(tmp_path, names[:7] + names[13:])


def test_a_drives_turns_are_read_in_radians(tmp_path):
    names = [f"axis{k}.encoder.{c}_estimate" for c in ("pos", "vel") for k in range(6)]
    names += [f"axis{k}.motor.torque_estimate" for k in range(6)]
    units = guessed(tmp_path, ["time", *names]).columns.units
    assert units == {"position": "rev", "velocity": "rev/s"}
