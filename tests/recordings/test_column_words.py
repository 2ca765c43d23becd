"""Names of other tools' logs are understood, and their units."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from consistent_id import RecordingError, read_recording, recording_from
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.column_words import channel_of

SIX = tuple(f"axis_{letter}" for letter in "abcdef")


def numbered(*patterns, first=1, count=6):
    return [p.format(k) for p in patterns for k in range(first, first + count)]


def guessed(folder, names, joints=SIX, **options):
    file = folder / "log.csv"
    file.write_text(",".join(names) + "\n" + ",".join("0" for _ in names) + "\n")
    return guess_columns(file, KnownColumns(tuple(joints), **options))


# The names that a log has, and which of them are time, position, velocity and torque of
# the first joint, with the units that are not SI.
LOGS = {
    "UR RTDE": (
        (
            "timestamp",
            *numbered("target_q_{}", "target_qd_{}", first=0),
            *numbered("actual_q_{}", "actual_qd_{}", "actual_current_{}", first=0),
            *numbered("actual_current_as_torque_{}", first=0),
        ),
        ("timestamp", "actual_q_0", "actual_qd_0", "actual_current_as_torque_0"),
        {},
    ),
    "Franka": (
        (
            "state.time",
            *numbered("state.q[{}]", "state.q_d[{}]", "state.dq[{}]", first=0),
            *numbered("state.dq_d[{}]", "state.tau_J_d[{}]", first=0),
            *numbered("state.tau_J[{}]", "state.dtau_J[{}]", first=0),
            *numbered("state.tau_ext_hat_filtered[{}]", first=0),
        ),
        ("state.time", "state.q[0]", "state.dq[0]", "state.tau_J[0]"),
        {},
    ),
    "KUKA RSI": (
        ("Time [ms]", *numbered("ASPos.A{}", "AIPos.A{}", "GearTorque.A{}")),
        ("Time [ms]", "AIPos.A1", None, "GearTorque.A1"),
        {"time": "ms", "position": "deg"},
    ),
    "KUKA KRC": (
        (
            "t",
            *numbered("AXIS_ACT_A{}", "VEL_AXIS_ACT_A{}", "TORQUE_AXIS_ACT_A{}"),
        ),
        ("t", "AXIS_ACT_A1", None, "TORQUE_AXIS_ACT_A1"),
        {"position": "deg"},
    ),
    "KUKA iiwa": (
        (
            "ZeitInSec",
            *numbered("axisQMsr_LBR_1[{}]", "axisQCmd_LBR_1[{}]", first=0),
            *numbered("axisTauExtMsr_LBR_1[{}]", "axisTauMsr_LBR_1[{}]", first=0),
        ),
        ("ZeitInSec", "axisQMsr_LBR_1[0]", None, "axisTauMsr_LBR_1[0]"),
        {},
    ),
    "ABB EGM": (
        (
            "time_ms",
            *numbered("planned.joints.J{}", "feedBack.joints.J{}"),
            *numbered("measuredTorque.J{}"),
        ),
        ("time_ms", "feedBack.joints.J1", None, "measuredTorque.J1"),
        {"time": "ms", "position": "deg"},
    ),
    "Drake": (
        ("time", *(f"arm_{j}_{c}" for c in ("q", "w", "tau") for j in SIX)),
        ("time", "arm_axis_a_q", "arm_axis_a_w", "arm_axis_a_tau"),
        {},
    ),
    "MuJoCo": (
        (
            "time",
            *numbered("qpos_{}", "qvel_{}", "ctrl_{}", "qfrc_bias_{}", first=0),
            *numbered("qfrc_actuator_{}", first=0),
        ),
        ("time", "qpos_0", "qvel_0", "qfrc_actuator_0"),
        {},
    ),
    "Isaac": (
        (
            "t",
            *numbered("joint_pos_{}", "joint_vel_{}", "joint_pos_target_{}", first=0),
            *numbered("computed_torque_{}", "applied_torque_{}", first=0),
        ),
        ("t", "joint_pos_0", "joint_vel_0", "applied_torque_0"),
        {},
    ),
    "LeRobot": (
        (
            "timestamp",
            *(f"action.{j}.pos" for j in SIX),
            *(f"observation.state.{j}.pos" for j in SIX),
            *(f"observation.effort.{j}" for j in SIX),
        ),
        (
            "timestamp",
            "observation.state.axis_a.pos",
            None,
            "observation.effort.axis_a",
        ),
        {},
    ),
    "PlotJuggler": (
        (
            "__time",
            *(f"/{j}/{c}" for c in ("position", "velocity", "effort") for j in SIX),
        ),
        ("__time", "/axis_a/position", "/axis_a/velocity", "/axis_a/effort"),
        {},
    ),
    "Kinova Kortex": (
        (
            "timestamp",
            *numbered("actuators[{}].position", "actuators[{}].velocity", first=0),
            *numbered("actuators[{}].torque", "actuators[{}].current_motor", first=0),
        ),
        (
            "timestamp",
            "actuators[0].position",
            "actuators[0].velocity",
            "actuators[0].torque",
        ),
        {"position": "deg", "velocity": "deg/s"},
    ),
    "motors": (
        (
            "time",
            *numbered("state.theta[{}]", "state.dtheta[{}]", "tau_J{}", first=0),
            *numbered("tau_J_d{}", "dtau_J{}", "tau_ext{}", first=0),
        ),
        ("time", "state.theta[0]", "state.dtheta[0]", "tau_J0"),
        {},
    ),
    "prefixes": (
        ("time", *numbered("ang_{}", "vel_{}", "torq_{}")),
        ("time", "ang_1", "vel_1", "torq_1"),
        {},
    ),
    "angular": (
        ("time", *numbered("joint_angle_{}", "angular_vel_{}", "moment_{}")),
        ("time", "joint_angle_1", "angular_vel_1", "moment_1"),
        {},
    ),
    "one word": (
        (
            "time",
            *numbered("jointpos_deg_{}", "jointvel_degps_{}", "jointtrq_Nm_{}"),
        ),
        ("time", "jointpos_deg_1", "jointvel_degps_1", "jointtrq_Nm_1"),
        {"position": "deg", "velocity": "deg/s"},
    ),
    "short": (
        ("t", *numbered("th{}", "thd{}", "Tq{}", "thdd{}")),
        ("t", "th1", "thd1", "Tq1"),
        {},
    ),
    "measured": (
        ("t", *numbered("qref{}", "qmes{}", "dqmes{}", "taumes{}")),
        ("t", "qmes1", "dqmes1", "taumes1"),
        {},
    ),
    "Beckhoff": (
        ("Time", *numbered("Axis{}.ActPos", "Axis{}.ActVelo", "Axis{}.ActTorque")),
        ("Time", "Axis1.ActPos", None, "Axis1.ActTorque"),
        {"position": "deg"},
    ),
    "own": (
        ("Time (ms)", *numbered("q{}_deg", "dq{} [rpm]", "tau{} [%]")),
        ("Time (ms)", "q1_deg", "dq1 [rpm]", "tau1 [%]"),
        {"time": "ms", "position": "deg", "velocity": "rev/min", "torque": "%"},
    ),
}


@pytest.mark.parametrize("first", [0, 1])
def test_numbers_may_begin_with_zeros(tmp_path, first):
    """The file's values stand in the order of the joints, also after 09."""
    joints = [f"axis_{letter}" for letter in "abcdefghijkl"]
    places = range(first, first + 12)
    names = ["t", *(f"{c}_{k:02d}" for c in ("q", "tau") for k in places)]
    file = tmp_path / "log.csv"
    rows = [[t, *range(12), *range(12)] for t in range(3)]
    file.write_text("\n".join(",".join(map(str, row)) for row in [names, *rows]))
    columns = guess_columns(file, KnownColumns(tuple(joints))).columns
    log = read_recording(file, joints, columns)
    np.testing.assert_array_equal(log.position[0], range(12))
    np.testing.assert_array_equal(log.torque[0], range(12))


def test_a_message_names_columns_whose_numbers_begin_with_zeros(tmp_path):
    names = ["t", *(f"q_{k:02d}" for k in range(1, 7))]
    unknown = [f"Ist_{k:02d}" for k in range(6)]
    with pytest.raises(RecordingError, match=r"--torque 'Ist_\{index:02d\}'") as said:
        guessed(tmp_path, [*names, *unknown])
    assert "q_{01..06}" in str(said.value)


@pytest.mark.parametrize("tool", LOGS)
def test_names_of_a_tools_logs_are_understood(tool, tmp_path):
    names, (time, *first), units = LOGS[tool]
    columns = guessed(tmp_path, names).columns
    assert columns.time == time
    (place,) = columns.in_log(SIX[:1])
    made = [
        pattern and pattern.format(joint=place, number=1)
        for pattern in (columns.position, columns.velocity, columns.torque)
    ]
    assert made == list(first)
    assert columns.units == units


@pytest.mark.parametrize("tool", ["MuJoCo", "Isaac", "LeRobot"])
def test_arrays_of_all_joints_are_found_by_their_names(tool, tmp_path):
    q, torque = {
        "MuJoCo": ("qpos", "qfrc_actuator"),
        "Isaac": ("dof_pos", "dof_torque"),
        "LeRobot": ("observation.state", "observation.effort"),
    }[tool]
    values = np.arange(24.0).reshape(4, 6)
    arrays = {q: values, "ctrl": 0.0 * values, torque: 2.0 * values}
    if tool == "LeRobot":  # lists in the cells of a table
        file = tmp_path / "log.parquet"
        table = {"timestamp": pa.array([0.0, 0.1, 0.2, 0.3])}
        table |= {name: pa.array(list(array)) for name, array in arrays.items()}
        pq.write_table(pa.table(table), file)
    else:
        file = tmp_path / "log.npz"
        np.savez(file, time=[0.0, 0.1, 0.2, 0.3], **arrays)
    found = guess_columns(file, KnownColumns(SIX))
    log = read_recording(file, SIX, found.columns)
    np.testing.assert_array_equal(log.position, values)
    np.testing.assert_array_equal(log.torque, 2.0 * values)


def test_lists_of_different_lengths_are_refused(tmp_path):
    file = tmp_path / "log.parquet"
    state = pa.array([[1.0] * 6, [1.0] * 5])
    table = {"timestamp": [0.0, 0.1], "observation.state": state}
    pq.write_table(pa.table(table | {"effort": state}), file)
    with pytest.raises(RecordingError, match="lists of different lengths"):
        found = guess_columns(file, KnownColumns(SIX))
        read_recording(file, SIX, found.columns)


def test_currents_stand_for_torque_where_there_is_a_gain(tmp_path):
    names = ["timestamp", *numbered("actual_q_{}", "actual_current_{}", first=0)]
    with pytest.raises(
        RecordingError, match=r"are motor currents.*--torque-gain NUMBER"
    ):
        guessed(tmp_path, names)
    columns = guessed(tmp_path, names, currents=True).columns
    assert columns.torque == "actual_current_{joint}"


def test_columns_are_listed_by_pattern_where_none_fits(tmp_path):
    names = ["time", *numbered("a{}", "b{}_x"), *(f"foo_{j}" for j in SIX)]
    with pytest.raises(RecordingError) as refusal:
        guessed(tmp_path, names)
    assert "the log has time, a{1..6}, b{1..6}_x, foo_{joint}." in str(refusal.value)


def test_joints_that_the_log_does_not_have_are_proposed_to_be_locked(tmp_path):
    names = ["time", *numbered("q_{}", "tau_{}", first=0, count=4)]
    with pytest.raises(RecordingError, match=r"--lock axis_e axis_f$"):
        guessed(tmp_path, names)


@pytest.mark.parametrize(
    ("pattern", "unit"),
    [("qdes{}", None), ("q_cmd_{}", None), ("target_q_{} [deg]", "deg")],
)
def test_commands_stand_for_torque_where_they_are_wanted(tmp_path, pattern, unit):
    names = ["time", *numbered("q{}", pattern, "tau{}", "dq_des{}")]
    found = guessed(tmp_path, names, commands=True).columns
    assert found.position_command == pattern.format("{number}")
    assert found.torque is None
    assert found.units.get("position_command") == unit
    assert guessed(tmp_path, names).columns.position_command is None


TURNING = ["turn_effort [Nm]", "tilt_effort [Nm]"]


def with_lift(folder, *names, **known):
    joints = ("turn", "tilt", "lift")
    every = ["time", *(f"{joint}_q" for joint in joints), *names]
    return guessed(folder, every, joints, **known)


@pytest.mark.parametrize("slides", ["lift_effort [N]", "lift_force [N]", "lift_tau"])
def test_torques_whose_names_differ_by_word_and_unit_are_read_together(
    tmp_path, slides
):
    found = with_lift(tmp_path, *TURNING, slides, sliding=frozenset(["lift"]))
    listed = f"turn_effort [Nm],tilt_effort [Nm],{slides}"
    assert found.columns.torque == f"{{{listed}}}"
    assert f"torque is read from {listed.replace(',', ', ')}" in found.notes
    assert found.columns.torque_joints == ()
    values = {"time": [0.0, 1.0], "turn_q": [0, 0], "tilt_q": [0, 0], "lift_q": [0, 0]}
    table = values | dict(zip(listed.split(","), np.ones((3, 2)), strict=True))
    table[slides] = [3.0, 4.0]
    log = recording_from(table, found.joints, found.columns)
    np.testing.assert_allclose(log.torque, [[1.0, 1.0, 3.0], [1.0, 1.0, 4.0]])


def test_columns_of_numbered_joints_whose_words_differ_are_read_together(tmp_path):
    names = ["time", "J1 angle [deg]", "J2 angle [deg]", "J3 stroke position [mm]"]
    names += ["J1 torque [Nm]", "J2 torque [Nm]", "J3 force [kN]"]
    joints = ("turn", "tilt", "lift")
    found = guessed(tmp_path, names, joints, sliding=frozenset(["lift"])).columns
    assert found.position == "{" + ",".join(names[1:4]) + "}"
    assert found.torque == "{" + ",".join(names[4:]) + "}"
    table = dict(zip(names, np.array([[0.0, 1.0], *np.ones((6, 2))]), strict=True))
    log = recording_from(table, joints, found)
    np.testing.assert_allclose(log.position[0], [np.pi / 180, np.pi / 180, 1e-3])
    np.testing.assert_allclose(log.torque[0], [1.0, 1.0, 1e3])


def test_a_force_of_a_joint_that_turns_is_refused_beside_torques(tmp_path):
    with pytest.raises(RecordingError) as refused:
        with_lift(tmp_path, *TURNING, "lift_force")
    listed = "'{turn_effort [Nm],tilt_effort [Nm],lift_force}'"
    said = f"To read all: --torque {listed}; or, if only the first is one: "
    assert str(refused.value).endswith(f"{said}--torque-joints turn tilt")
    found = with_lift(tmp_path, *TURNING, "lift_tau", torque_joints=("turn", "tilt"))
    assert found.columns.torque == "{joint}_effort [Nm]"


def test_a_log_without_the_torque_of_a_joint_is_read(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("time,turn_q,lift_q,turn_tau,force_x,lift_speed\n")
    found = guess_columns(file, KnownColumns(("turn", "lift"))).columns
    assert found.torque_joints == ("turn",)


def test_commands_in_degrees_are_read_in_radians(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("time,q_hip,q_cmd_hip [deg]\n0,0,180\n1,0,90\n2,0,-180\n")
    columns = guess_columns(file, KnownColumns(("hip",), commands=True)).columns
    command = read_recording(file, ["hip"], columns).position_command
    np.testing.assert_allclose(command[:, 0], [np.pi, np.pi / 2, -np.pi])


def test_numbered_columns_may_count_joints_that_are_held(tmp_path):
    file = tmp_path / "log.csv"
    names = ["time", *numbered("q{}", "tau{}")]
    rows = [[t, *(10.0 * n + t for n in range(12))] for t in (0.0, 1.0)]
    file.write_text("\n".join(",".join(map(str, row)) for row in (names, *rows)))
    moving = [name for name in SIX if name != SIX[1]]
    known = KnownColumns(tuple(moving), all_joints=SIX)
    columns = guess_columns(file, known).columns
    log = read_recording(file, moving, columns)
    np.testing.assert_array_equal(log.position[0], [0.0, 20.0, 30.0, 40.0, 50.0])
    np.testing.assert_array_equal(log.torque[0], [60.0, 80.0, 90.0, 100.0, 110.0])


def test_what_a_lerobot_follower_is_told_is_a_command_of_position():
    assert channel_of("action.{joint}.pos") == "position_command"
    assert channel_of("action.{joint}.vel") == ""
    # Policies of legged robots log scaled steps, which no name says to be positions.
    assert channel_of("actions_{index}") == ""
    assert channel_of("observation.state.{joint}.pos") == "position"


def test_of_a_robot_with_branches_what_is_not_of_the_chain_is_proposed(tmp_path):
    names = ["time", *numbered("q_{}", "tau_{}", first=0, count=4)]
    arm = ("axis_b", "axis_c", "axis_d", "axis_e")
    both = r"from axis_b to axis_e \(those from axis_a to axis_d .*axis_a axis_f$"
    with pytest.raises(RecordingError, match=both):
        guessed(tmp_path, names, rows={4: [arm, SIX[:4]]})
    with pytest.raises(RecordingError, match=r"the joints at rest: --lock JOINT"):
        guessed(tmp_path, names, rows={})


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
