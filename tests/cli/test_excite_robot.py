"""``excite`` and ``init`` for a robot that has no log, and no problem file."""

import numpy as np
import pytest
from estimates import estimate_of
from schemas import parsed

from consistent_id import load_problem
from consistent_id.cli import main
from consistent_id.excitation.output import require_places
from consistent_id.motion import read_trajectory

URDF = """
<robot name="two">
  <link name="base"/>
  <link name="one"><inertial><mass value="3"/><origin xyz="0.1 0 0"/>
    <inertia ixx="0.02" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <link name="two"><inertial><mass value="2"/><origin xyz="0.1 0 0.05"/>
    <inertia ixx="0.02" iyy="0.04" izz="0.05" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <joint name="first" type="revolute"><parent link="base"/><child link="one"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="2" effort="40"/></joint>
  <joint name="second" type="revolute"><parent link="one"/><child link="two"/>
    <origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="1.5" velocity="2" effort="20"/></joint>
</robot>
"""
UNBOUND = """
name = "bare"
[model]
modified_dh = [
    { alpha_deg = 0.0, a = 0.0, lower = -3.0, upper = 3.0 },
    { alpha_deg = 90.0, a = 0.0, lower = -1.5, upper = 1.5 },
]
"""


@pytest.fixture
def urdf(tmp_path):
    file = tmp_path / "two.urdf"
    file.write_text(URDF)
    return file


@pytest.mark.slow
def test_the_screen_of_a_design_is_short_and_names_the_folder_once(
    urdf, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    call = ["excite", urdf, "--acceleration", "5", "--duration", "6", "--starts", "1"]
    call += ["--harmonics", "4", "--workers", "1", "--output", "motion"]
    assert main([str(word) for word in call]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 25 and max(map(len, lines)) <= 100
    (said,) = (line for line in lines if line.startswith("written in motion: "))
    assert "problem.toml" in said and "trajectory.csv" in said


@pytest.mark.slow
def test_a_robot_alone_gets_a_motion_and_a_problem_file(urdf, tmp_path, capsys):
    folder = tmp_path / "motion"
    call = ["excite", urdf, "--acceleration", "5", "--duration", "6", "--starts", "1"]
    call += ["--harmonics", "4", "--workers", "1", "--output", folder, "--json"]
    assert main([str(word) for word in call]) == 0
    record = parsed(capsys.readouterr().out)
    assert record["limits"]["acceleration"] == [5.0, 5.0]
    assert {"trajectory.yaml", "follow.py"} <= {file.name for file in folder.iterdir()}
    assert record["form"]["duration_s"] == 6.0
    assert record["stages"][-1]["proven"]
    # Noise is assumed: half a percent of the effort limits.
    assert record["aim"]["noise"] == [0.2, 0.1] and record["aim"]["noise_is_assumed"]
    require_places(folder, ("csv", "yaml"))  # a second design may take its place
    again = load_problem(folder / "problem.toml", trust=True).table.excitation
    assert (again.duration, again.harmonics) == (6.0, 4)
    assert again.limits.acceleration == 5.0


def test_an_edited_problem_file_is_not_replaced_and_no_search_is_lost(
    urdf, tmp_path, capsys, monkeypatch
):
    def searched(*given, **options):
        pytest.fail("searched before the file was looked at")

    monkeypatch.setattr("consistent_id.excitation.playable.playable_design", searched)
    folder = tmp_path / "motion"
    folder.mkdir()
    mine = folder / "problem.toml"
    mine.write_text('name = "mine"\n')
    call = ["excite", str(urdf), "--acceleration", "5", "--output", str(folder)]
    assert main(call) == 2
    told = capsys.readouterr().err
    assert "problem.toml is there already" in told
    assert f"consistent-id excite {folder}" in told
    assert mine.read_text() == 'name = "mine"\n'


def test_init_writes_the_problem_into_a_folder_that_is_there(urdf, tmp_path, capsys):
    folder = tmp_path / "study"
    folder.mkdir()
    assert main(["init", str(urdf), "--output", str(folder)]) == 0
    assert f"written: {folder / 'problem.toml'}" in capsys.readouterr().out
    assert (folder / "problem.toml").exists()


def test_init_takes_a_name_without_an_ending_for_a_folder(urdf, tmp_path, capsys):
    folder = tmp_path / "study"
    assert main(["init", str(urdf), "--output", str(folder)]) == 0
    assert f"written: {folder / 'problem.toml'}" in capsys.readouterr().out
    bare = tmp_path / "bare"  # a file that is there is not made a folder
    bare.write_text("mine\n")
    assert main(["init", str(urdf), "--output", str(bare)]) == 2
    assert bare.read_text() == "mine\n"


def test_no_line_of_info_is_broken_by_drive_terms_that_all_joints_have(
    urdf, tmp_path, capsys
):
    assert main(["init", str(urdf), "--output", str(tmp_path / "study")]) == 0
    capsys.readouterr()
    assert main(["info", str(tmp_path / "study"), "--verbose"]) == 0
    said = capsys.readouterr().out
    assert said.count("viscous, coulomb") == 1
    assert "drive terms of 2 joints (as below): viscous, coulomb" in said


def test_init_without_a_log_says_what_to_record(urdf, tmp_path, capsys):
    file = tmp_path / "study.toml"
    assert main(["init", str(urdf), "--output", str(file)]) == 0
    assert "next: consistent-id excite" in capsys.readouterr().out
    problem = load_problem(file)
    assert problem.table.data is None and len(problem.model.robot) == 2
    assert "[excitation]" in file.read_text()
    assert main(["init", str(urdf), "--torque", "tau_{joint}", "--dry-run"]) == 2
    assert "--torque describes a log" in capsys.readouterr().err


def test_an_arm_without_datasheet_or_limits_says_which_keys_are_missing(
    tmp_path, capsys
):
    file = tmp_path / "problem.toml"
    file.write_text(UNBOUND)
    assert main(["excite", str(file), "--dry-run"]) == 2
    said = capsys.readouterr().err
    assert "'joint1'" in said and "[excitation.limits]" in said
    assert "velocity = 1.0" in said and "--velocity" in said
    assert main(["excite", str(file), "--velocity", "2", "--dry-run"]) == 0


def test_a_format_is_refused_before_anything_is_read(tmp_path, capsys):
    missing = tmp_path / "nothing.toml"
    assert main(["excite", str(missing), "--format", "foo"]) == 2
    assert "format 'foo'" in capsys.readouterr().err


def test_options_take_the_place_of_keys(tmp_path, capsys):
    rx60 = ["excite", "problems/rx60", "--dry-run", "--verbose"]
    assert main(rx60) == 0
    assert "condition, then D" in capsys.readouterr().out
    assert main([*rx60, "--objective", "D", "--duration", "4"]) == 0
    shown = capsys.readouterr().out
    assert "then D" not in shown and "4 s" in shown


WITH_FRICTION = """
name = "two"
[model]
urdf = "two.urdf"
[drive]
viscous = true
[excitation]
duration = 5.0
harmonics = 3
[excitation.limits]
acceleration = 5.0
"""


@pytest.mark.slow
def test_torque_limits_are_kept_by_the_worst_of_several_estimates(
    urdf, tmp_path, capsys
):
    file = tmp_path / "problem.toml"
    file.write_text(WITH_FRICTION)
    model = load_problem(file).model
    links = [link.nominal for link in model.robot.links]
    # At 2 rad/s the second robot needs 30 N m of its second joint's 20.
    robots = [estimate_of(model, links, [1.0, 3.0]), estimate_of(model, links, [9, 15])]
    files = [str(one.save(tmp_path / f"{k}.json")) for k, one in enumerate(robots)]
    call = ["excite", str(file), "--starts", "1", "--workers", "1", "--json"]
    folder = tmp_path / "motion"
    assert main([*call, "--output", str(folder), "--parameters", *files]) == 0
    capsys.readouterr()
    move = read_trajectory(folder / "trajectory.json")
    time = np.linspace(move.start, move.start + move.duration, 5001)
    motion = move.evaluate(time)
    shares = [
        abs(model.predict(one.parameters, *motion)).max(axis=0) / [40.0, 20.0]
        for one in robots
    ]
    assert np.max(shares) <= 1.0 and shares[1][1] > 0.7
    assert 15.0 * abs(motion[1, :, 1]).max() < 22.0

    assert main([*call, "--dry-run", "--parameters", str(file)]) == 2
    assert "not JSON" in capsys.readouterr().err
    file.write_text(WITH_FRICTION.replace("viscous = true", "offset = true"))
    assert main([*call, "--dry-run", "--parameters", *files]) == 2
    assert "its parameters are not those of robot 'two'" in capsys.readouterr().err
