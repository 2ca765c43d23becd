"""A log's own names of joints are found, and mapped only by an option."""

from pathlib import Path
from time import process_time

import numpy as np
import pytest

import consistent_id as ci
from consistent_id.errors import RecordingError
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.own_names import mapping_option, own_names, pairs_of
from consistent_id.recordings.readers.columns import Columns, wanted

ARM = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")


@pytest.mark.parametrize(
    ("pattern", "own"),
    [
        ("{} position", ("Base", "Shoulder", "Wrist 1")),
        ("pos_{}", ("Base", "Shoulder", "Wrist 1")),
        ("/arm/{}/position", ("base", "lift", "roll")),
        ("observation.state.{}.pos", ("shoulder_pan", "shoulder_lift", "elbow")),
        ("{}.q", ("A", "D", "B")),  # not q_d, a command
        ("arm_{}_q", ("left_a", "right_a", "b")),
    ],
)
def test_own_names_are_what_differs(pattern, own):
    names = ["time", *map(pattern.format, own)]
    names += [
        pattern.replace("q", "tau").replace("pos", "torque").format(j) for j in own
    ]
    assert own_names(names) == own


@pytest.mark.parametrize(
    "names", [["time", "q1", "q2"], ["q_1", "q_2"], ["time", "x", "y"], ["q"]]
)
def test_numbers_and_other_columns_are_no_names(names):
    assert own_names(names) == ()


def test_names_that_are_alike_are_paired_in_any_order():
    own = ("elbow", "shoulder_lift", "shoulder_pan")
    assert set(pairs_of(own, ARM)) == {(name, f"{name}_joint") for name in own}


def test_other_names_are_paired_in_their_order():
    assert pairs_of(("Base", "Shoulder", "Elbow"), ARM) == tuple(
        zip(("Base", "Shoulder", "Elbow"), ARM, strict=True)
    )


def test_the_option_is_one_that_a_shell_takes():
    option = mapping_option(["Wrist 1", "a"], ["one", "two"])
    assert option == "--names 'Wrist 1=one' a=two"


def _refused(names):
    with pytest.raises(RecordingError) as caught:
        guess_columns(Path("log.csv"), KnownColumns(ARM, names=names))
    return str(caught.value)


def test_the_message_has_the_option_filled_in():
    own = ("Base", "Shoulder", "Elbow")
    said = _refused(["time", *(f"{j}.{c}" for c in ("q", "tau") for j in own)])
    assert said.endswith(
        "--names Base=shoulder_pan_joint Shoulder=shoulder_lift_joint Elbow=elbow_joint"
    )


def test_the_message_says_which_joints_would_be_left_out():
    own = ("Base 1", "Shoulder 2")
    said = _refused(["time", *(f"{j}.{c}" for c in ("q", "tau") for j in own)])
    assert "elbow_joint would be locked at zero" in said
    own = ("A 1", "B 1", "C 1", "gripper 1")
    said = _refused(["time", *(f"{j}.{c}" for c in ("q", "tau") for j in own)])
    assert "gripper 1 would not be read" in said


def test_a_joint_is_found_by_whole_words():
    names = ["time", *(f"{j}.{c}" for c in ("q", "tau") for j in "ab")]
    found = guess_columns(Path("log"), KnownColumns(("a", "b"), names=names))
    assert found.columns.torque == "{joint}.tau"
    assert found.joints == ("a", "b")


@pytest.mark.parametrize(
    ("own", "joints", "expected"),
    [
        (
            ("l_knee", "knee", "r_knee"),
            ("l_knee", "r_knee", "knee"),
            {"l_knee": "l_knee", "knee": "knee", "r_knee": "r_knee"},
        ),
        (
            ("wrist", "elbow"),
            ("elbow_joint", "forearm"),
            {"wrist": "forearm", "elbow": "elbow_joint"},
        ),
    ],
)
def test_names_that_are_alike_go_before_the_order(own, joints, expected):
    assert dict(pairs_of(own, joints)) == expected


@pytest.mark.slow
def test_many_names_are_paired_and_guessed_in_seconds():
    """The time grows with their number, not with its square."""
    own = [f"robot{k}/elbow" for k in range(10_000)]
    names = ["time", *(f"{name}/position" for name in own)]
    before = process_time()
    assert pairs_of([*own, "lift"], ["elbow", "lift"])[-1] == ("lift", "lift")
    with pytest.raises(RecordingError, match="found no column that is the torque"):
        guess_columns(Path("log.csv"), KnownColumns(("elbow", "lift"), names=names))
    assert process_time() - before < 5.0


@pytest.mark.parametrize("place", ["j{}_pos [{}]", "j{}_pos_{}"])
def test_joints_that_turn_and_slide_are_read_together(tmp_path, place):
    """Names that differ by the unit are those of one channel; no joint is locked."""
    units = ("deg", "deg", "mm", "deg")
    names = ["t", *(place.format(k + 1, unit) for k, unit in enumerate(units))]
    names += [f"j{k + 1}_torque" for k in range(4)]
    rows = [",".join(names), *(",".join(map(str, range(k, k + 9))) for k in range(3))]
    log = tmp_path / "scara.csv"
    log.write_text("\n".join(rows))
    joints = ("j1", "j2", "j3", "j4")
    guess = guess_columns(log, KnownColumns(joints))
    assert guess.joints == joints
    assert guess.columns.units["position"] == units
    read = ci.read_recording(log, joints, columns=guess.columns)
    assert read.position[0] == pytest.approx(
        [1 * np.pi / 180, 2 * np.pi / 180, 3e-3, 4 * np.pi / 180]
    )
    assert any("j3 in mm" in note for note in guess.notes)


def test_their_velocities_are_not_dropped(tmp_path):
    names = ["t", "turn_pos [deg]", "lift_pos [mm]", "turn_vel [deg/s]"]
    names += ["lift_vel [mm/s]", "turn_tau", "lift_tau"]
    log = tmp_path / "log.csv"
    rows = [",".join(map(str, range(k, k + 7))) for k in range(3)]
    log.write_text("\n".join([",".join(names), *rows]))
    guess = guess_columns(log, KnownColumns(("turn", "lift")))
    read = ci.read_recording(log, guess.joints, columns=guess.columns)
    assert read.velocity[0] == pytest.approx([np.radians(3.0), 4e-3])
    assert any("lift in mm/s" in note for note in guess.notes)


def test_a_unit_in_a_pattern_needs_a_unit_of_each_joint():
    with pytest.raises(RecordingError, match=r"\{unit\} with a unit stated for each"):
        wanted(Columns(position="{joint} [{unit}]"), ["a", "b"], "log")


@pytest.mark.parametrize("unit", [" [deg]", " (rad)", "_deg"])
def test_own_names_stand_before_units(unit):
    joints = ["Base", "Elbow", "Wrist_1", "Wrist_2"]
    columns = [f"{joint} Angle{unit}" for joint in joints]
    torques = [f"{joint} Torque [Nm]" for joint in joints]
    assert own_names(["Timestamp", *columns, *torques]) == tuple(joints)
    assert own_names([*columns, *torques], "torque") == tuple(joints)


def test_brackets_around_own_names_are_no_units():
    assert own_names(["position (arm)", "position (leg)"]) != ("", "")
    assert own_names(["arm pos [deg]", "leg pos [deg]"]) == ("arm", "leg")


@pytest.mark.parametrize(
    ("pattern", "own"),
    [
        ("{}Pos", ("base", "roll1", "elbow")),
        ("pos{}", ("Base", "Roll1", "Elbow")),
        ("{}Pos", ("A", "D", "B")),
        ("pos({})", ("base", "roll1", "elbow")),
        ("pos[{}]", ("base", "roll1", "elbow")),
    ],
)
def test_own_names_end_at_a_capital_or_a_bracket(pattern, own):
    names = ["t", *map(pattern.format, own)]
    names += [pattern.replace("os", "osRef").format(joint) for joint in own]
    assert own_names(names) == own


def test_columns_without_a_word_are_names_if_torques_have_them():
    own = ("base", "roll1", "elbow")
    names = ["t", *own, *(f"{joint}_tq" for joint in own)]
    assert own_names(names) == own
    mapping = dict(zip(ARM, own, strict=True))
    known = KnownColumns(ARM, names=names).renamed(mapping)
    assert guess_columns(Path("log.csv"), known).columns.position == "{joint}"


def test_columns_that_pandas_numbers_are_one_for_each_joint(tmp_path):
    """The first of six columns of one name has no number: it is the first joint's."""
    names = ["t", "pos", "pos.1", "pos.2", "tau", "tau.1", "tau.2"]
    guess = guess_columns(Path("log.csv"), KnownColumns(ARM, names=names))
    assert guess.joints == ARM
    assert guess.columns.torque == "{tau,tau.1,tau.2}"
    log = tmp_path / "log.csv"
    log.write_text(",".join(names) + "\n0,1,2,3,4,5,6\n1,2,3,4,5,6,7\n")
    with pytest.raises(RecordingError, match="found no column") as caught:
        guess_columns(log, KnownColumns(ARM[:2]))
    assert "--" not in caught.value.options


def in_pandas(names, joints=ARM):
    return guess_columns(Path("log.csv"), KnownColumns(joints, names=names))


def test_columns_twice_in_a_table_do_not_hide_those_of_all_joints():
    names = ["t", *(f"{c}{k}" for c in ("q", "tau") for k in (1, 2, 3))]
    for more in (["tau1.1"], [f"{name}.1" for name in names]):
        guess = in_pandas([*names, *more])
        assert guess.columns.position == "q{number}"
        assert guess.columns.torque == "tau{number}"
    assert "torque is read from tau{number}, not from tau{number}.1" in guess.notes
    both = ["t", "q1", "q2", "q1.1", "q2.1", "tau1", "tau2"]  # as many as joints
    assert in_pandas(both, ARM[:2]).columns.position == "q{number}"


def test_numbers_after_a_point_are_the_logs_own_if_the_first_has_one():
    numbers = (1, 2, 3)
    names = ["t", "tau", *(f"{c}.{k}" for c in ("q", "tau") for k in numbers)]
    assert in_pandas(names).columns.torque == "tau.{number}"
    from_zero = ["t", "q.0", "q.1", "tau", "tau.1"]
    guess = in_pandas(from_zero, ARM[:2])
    assert guess.columns.torque == "{tau,tau.1}"


OF_UNIT = {
    "position": ["temp{}_deg", "{}_backlash_deg"],
    "velocity": ["motor{}_rpm", "{}_fan_rpm", "{} gyro [deg/s]", "M{}_rpm"],
    "torque": ["J{}_max_Nm", "load_cell{}_Nm", "{} brake [Nm]", "{} load [Nm]"],
}


@pytest.mark.parametrize(
    ("channel", "text"), [(c, text) for c, texts in OF_UNIT.items() for text in texts]
)
def test_a_unit_says_no_channel_of_a_name_with_other_words(channel, text):
    plain = {"position": "q{}", "velocity": "dq{}", "torque": "tau{}"}
    names = ["t"]
    for each, usual in plain.items():
        said = text if each == channel else usual
        names += [
            said.format(joint if said[0] == "{" else k)
            for k, joint in enumerate(ARM, 1)
        ]
    if channel == "velocity":
        assert in_pandas(names).columns.velocity is None
        return
    with pytest.raises(RecordingError, match="found no column") as caught:
        in_pandas(names)
    of_another = "max" in text or "temp" in text
    assert (f"--{channel}" in caught.value.options) != of_another


def test_names_of_joints_are_not_mapped_to_themselves():
    """It was proposed, because a limit in degrees has them, and changed nothing."""
    names = ["t", *(f"{c}_{joint}" for c in ("load", "p") for joint in ARM)]
    names += [f"limit_{joint}_deg" for joint in ARM]
    with pytest.raises(RecordingError, match="found no column") as caught:
        in_pandas(names)
    assert "--names" not in caught.value.options
    assert own_names([f"limit_{k}_deg" for k in ("a", "b")]) == ()
    assert own_names(["x[0] [deg]", "x[1] [deg]"]) == ()


def test_a_simulated_channel_is_read_with_a_note():
    names = ["t", *(f"{c}{k}" for c in ("q", "tau_sim_") for k in (1, 2, 3))]
    (note,) = in_pandas(names).notes
    assert note == "tau_sim_{number} is taken as the torque: no other column is"


def test_columns_in_a_unit_of_velocity_that_are_not_read_are_named():
    names = ["t", *(f"{c}{k}" for c in ("q", "tau") for k in (1, 2, 3))]
    guess = in_pandas([*names, *(f"spin{k} [deg/s]" for k in (1, 2, 3))])
    assert "--velocity 'spin{number} [deg/s]'" in guess.notes[0]


def test_currents_beside_torques_of_another_thing_need_gains():
    names = ["t", *(f"q{k}" for k in (1, 2, 3)), *(f"brake{k}_Nm" for k in (1, 2, 3))]
    with pytest.raises(RecordingError, match="are motor currents"):
        in_pandas([*names, *(f"iq{k}" for k in (1, 2, 3))])


@pytest.mark.parametrize("mark", ["_{}", " [{}]"])
def test_units_alone_say_the_channels_of_own_names(mark):
    """As in base_deg, base_degps, base_Nm."""
    own = ("base", "roll1", "elbow")
    units = ("deg", "degps", "Nm")
    names = ["t", *(f"{j}{mark.format(unit)}" for unit in units for j in own)]
    assert own_names(names) == own
    known = KnownColumns(ARM, names=names).renamed(dict(zip(ARM, own, strict=True)))
    columns = guess_columns(Path("log.csv"), known).columns
    each = [f"{{joint}}{mark.format(unit)}" for unit in units]
    assert [columns.position, columns.velocity, columns.torque] == each
    notes = guess_columns(Path("log.csv"), known).notes
    assert f"{each[2]} is taken as the torque: no other column is" in notes
    assert columns.units["velocity"] == "deg/s"


def test_names_that_are_parts_of_those_of_one_arm_are_mapped_to_it(tmp_path):
    """In their order they were mapped to the head and most of the left arm."""
    joints = ["head", *(f"{side}_{j}" for side in ("left", "right") for j in "abc")]
    names = ["t", *(f"{j}_{c}" for c in ("position", "effort") for j in "abc")]
    log = tmp_path / "log.csv"
    log.write_text(",".join(names) + "\n0,1,2,3,4,5,6\n1,2,3,4,5,6,7\n")
    with pytest.raises(RecordingError) as caught:
        guess_columns(log, KnownColumns(tuple(joints)))
    assert caught.value.options == "--names a=left_a b=left_b c=left_c"
    assert "(left_a and so on; right_a would fit as well)" in str(caught.value)
    assert pairs_of(["b", "a"], ["a_1", "b_1"]) == (("b", "b_1"), ("a", "a_1"))


@pytest.mark.parametrize(
    "form",
    ["measured_position/{} [rad]", "{}_actual_q_rad", "load pos {}", "{} pos ist"],
)
def test_names_of_joints_stand_beside_several_words_of_a_channel(form):
    """They were found without other words, or with the word for measured."""
    names = ["t", *(form.format(own) for own in ("Base", "Arm", "Wrist"))]
    assert own_names(names) == ("Base", "Arm", "Wrist")


def test_a_column_of_a_joint_is_no_array_of_all_joints():
    """One of them was read as an array, as its name was not found behind two words."""
    own = ("Base", "Arm", "Wrist")
    names = ["t", *(f"{c}/{o}" for c in ("actual_q", "load_torque") for o in own)]
    with pytest.raises(RecordingError, match="found no column") as caught:
        in_pandas(names)
    assert caught.value.options == mapping_option(own, ARM)
