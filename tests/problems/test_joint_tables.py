"""One joint's table states what it has else than all; the rest is as of all."""

from pathlib import Path

import pytest
from logged import URDF

from consistent_id import load_problem
from consistent_id.problems.file import DriveTable, JointTable
from consistent_id.problems.file import problem_table as decoded
from consistent_id.problems.kept_text import toml_text

DRIVE = """
[drive]
viscous = true
coulomb = "tanh"
velocity_scale = 0.02
offset = true
load_friction = true
"""
ALL = ("viscous", "coulomb", "load_friction", "offset")

TABLES = {
    "nothing": ("", ALL),
    "one more": ("spring = true", (*ALL, "spring")),
    "one less": ("offset = false", ("viscous", "coulomb", "load_friction")),
    "motor alone": ("gear_ratio = 100.0", ALL),
    "no direction": ('coulomb = "none"', ("viscous", "offset")),
    "two levels": (
        "asymmetric = true",
        ("viscous", "coulomb_positive", "coulomb_negative", "load_friction"),
    ),
}


def problem(folder, more, drive=DRIVE):
    (folder / "arm.urdf").write_text(URDF)
    text = f'name = "arm"\n[model]\nurdf = "arm.urdf"\n{drive}\n{more}\n'
    (folder / "problem.toml").write_text(text)
    return load_problem(folder)


@pytest.mark.parametrize("case", TABLES)
def test_a_key_of_one_joint_is_over_that_of_all(case, tmp_path):
    table, names = TABLES[case]
    shoulder, elbow = problem(tmp_path, f"[joints.elbow]\n{table}").model.terms
    assert shoulder.names == ALL
    assert elbow.names == names


def test_a_shape_of_one_joint_is_its_own(tmp_path):
    more = "[joints.elbow]\nvelocity_scale = 0.1"
    shoulder, elbow = problem(tmp_path, more).model.terms
    assert (shoulder.velocity_scale, elbow.velocity_scale) == (0.02, 0.1)
    more = '[joints.elbow]\ncoulomb = "sign"'
    shoulder, elbow = problem(tmp_path, more).model.terms
    assert (shoulder.velocity_scale, elbow.velocity_scale) == (0.02, None)


def test_zero_takes_away_a_number_that_all_have(tmp_path):
    drive = DRIVE + "stribeck_velocity = 0.1\n"
    more = "[joints.elbow]\nstribeck_velocity = 0"
    shoulder, elbow = problem(tmp_path, more, drive).model.terms
    assert "stribeck" in shoulder.names
    assert "stribeck" not in elbow.names


def test_a_joint_that_carries_nothing_has_no_friction_of_the_load(tmp_path):
    # The forearm on the axis of its joint, without inertia about it: no torque there.
    still = URDF.replace("0.15 0.02 0.01", "0 0 0.01")
    still = still.replace('iyy="0.03" iyz="0" izz="0.03"', 'iyy="0.01" iyz="0" izz="0"')
    folder = tmp_path / "still"
    folder.mkdir()
    problem(tmp_path, "")
    (folder / "arm.urdf").write_text(still)
    (folder / "problem.toml").write_text((tmp_path / "problem.toml").read_text())
    shoulder, elbow = load_problem(folder).model.terms
    assert "load_friction" in shoulder.names
    assert "load_friction" not in elbow.names


def test_a_joint_without_a_measured_torque_has_no_terms(tmp_path):
    more = """[data]
torque_joints = ["shoulder"]
[[data.recordings]]
file = "log.csv"
role = "training"
"""
    shoulder, elbow = problem(tmp_path, more).model.terms
    assert (shoulder.names, elbow.names) == (ALL, ())


def test_a_joints_table_that_is_written_is_read_as_it_was():
    drive = DriveTable(
        viscous=True, coulomb="tanh", velocity_scale=0.02, stribeck_velocity=0.1
    )
    own = JointTable(
        viscous=False, coulomb="sign", velocity_scale=None, stribeck_velocity=None
    )
    text = f'name = "x"\n[model]\nurdf = "x"\n[joints.a]\n{toml_text(own, {})}'
    again = decoded(text, Path("problem.toml")).joints["a"]
    assert again.over(drive).terms.names == own.over(drive).terms.names == ("coulomb",)
