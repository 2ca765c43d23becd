"""Gains between currents and torque, by a load of known mass."""

import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from carrying import JOINTS, LOAD, urdf, write_log, write_robot
from schemas import parsed
from shown import assert_reached

from consistent_id import ModelError, ProblemError, RecordingError, draft_problem
from consistent_id.cli import main
from consistent_id.problems.file import GainsTable
from consistent_id.service import check_gains, weigh_load
from consistent_id.service.gain_check import (
    GainCheck,
    _reasons,
    gains_off,
    problem_gains,
)

GAINS = np.array([12.0, 11.0, 9.0, 7.0])  # N m/A, of the simulated drives
STATED = [12.0, 10.0, 10.0, 7.0]
WORDS = ["--no-select", "--cutoff", "8", "--torque-gain", *map(str, STATED)]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The robot, and currents without and with the load."""
    folder = tmp_path_factory.mktemp("currents")
    return {
        "robot": write_robot(folder),
        "empty": write_log(folder / "empty.csv", None, gains=GAINS),
        "loaded": write_log(folder / "loaded.csv", LOAD, gains=GAINS, seed=1),
    }


@pytest.fixture(scope="module")
def found(files):
    problem = draft_problem(
        files["robot"], files["empty"], select=False, cutoff=8.0, torque_gain=STATED
    ).problem()
    return check_gains(problem, files["loaded"], known_mass=LOAD.mass, link="flange")


@pytest.mark.slow
def test_gains_are_those_of_the_simulated_drives(found):
    assert_reached("tests/service/test_gain_check.py", found)
    half = found.half_intervals
    assert (abs(found.gains - GAINS) < 1.5 * half).all()
    # Joints that gravity loads show their gains; the first turns about the vertical.
    assert (half[1:] < 0.1 * GAINS[1:]).all()
    assert found.off[1:].tolist() == [True, True, False]
    np.testing.assert_array_equal(found.stated, STATED)


@pytest.mark.slow
def test_the_table_states_what_the_problem_file_needs(found):
    table = found.table()
    assert {row[-1] for row in table.rows} <= {"off", "not off"}
    (line,) = [note for note in table.notes if note.startswith("torque_gain")]
    listed = [float(word) for word in line.split("[")[1].rstrip("]").split(",")]
    np.testing.assert_allclose(listed, found.gains, rtol=1e-4)
    assert [row[0] for row in table.rows] == list(JOINTS)
    for option, values in (
        ("--torque-gain ", found.gains),
        ("--gain-errors ", 100.0 * found.factors.relative_errors),
    ):
        (line,) = [note for note in table.notes if option in note]
        shown = [float(word) for word in line.split(option)[1].split()]
        np.testing.assert_allclose(shown, values, rtol=0.06)  # two digits


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 0.1])
def test_gains_are_not_off_where_none_is_stated(found, scale):
    """A log in amperes is read with `--torque-gain 1`; one in N m may be, too."""
    near = scale * GAINS
    factors = replace(found.factors, gains=near, covariance=1e-6 * np.eye(len(near)))
    check = GainCheck(factors, np.ones(len(near)), found.verdict)
    unstated = {(row[1], *row[4:]) for row in check.table().rows} == {("-", "-", "-")}
    assert check.unstated == unstated == (scale == 1.0)
    assert check.off.any() != unstated
    kinds = [reason.kind for reason in _reasons(factors, check.stated)]
    assert ("gains are off" in kinds) != unstated


@pytest.mark.slow
def test_a_wrong_mass_makes_all_gains_wrong_by_the_same_factor(files, found):
    problem = draft_problem(
        files["robot"], files["empty"], select=False, cutoff=8.0, torque_gain=STATED
    ).problem()
    heavy = check_gains(problem, files["loaded"], known_mass=2.0 * LOAD.mass)
    np.testing.assert_allclose(heavy.gains, 2.0 * found.gains, rtol=1e-3)


@pytest.mark.slow
def test_the_shell_prints_and_writes_gains(files, found, tmp_path, capsys):
    words = ["gains", files["robot"], files["empty"], "--loaded", files["loaded"]]
    words += ["--known-mass", LOAD.mass, *WORDS, "--output", tmp_path / "out"]
    assert main(list(map(str, words))) == 0
    assert "torque_gain = [" in capsys.readouterr().out
    record = parsed((tmp_path / "out" / "gains.json").read_text())
    gains = [record["gains"][joint]["gain"] for joint in JOINTS]
    np.testing.assert_allclose(gains, found.gains, rtol=1e-6)
    assert record["verdict"] == found.verdict.word


@pytest.mark.slow
def test_without_a_load_a_problem_s_bodies_imply_the_gains(files, capsys):
    """The simulated arm has the bodies of its file; stated gains do not matter."""
    draft = draft_problem(
        files["robot"], files["empty"], select=False, cutoff=8.0, torque_gain=STATED
    )
    file = files["robot"].parent / "problem.toml"
    file.write_text(draft.text(file.parent))
    assert main(["gains", str(file), "--json"]) == 0
    of_problem = parsed(capsys.readouterr().out, "model-gains-1")["gains"]
    words = ["gains", files["robot"], files["empty"], *WORDS, "--json"]
    assert main(list(map(str, words))) == 0
    of_log = parsed(capsys.readouterr().out, "model-gains-1")["gains"]
    assert of_problem.keys() == of_log.keys() == set(JOINTS)
    for joint, gain in zip(JOINTS, GAINS, strict=True):
        one, other = of_problem[joint], of_log[joint]
        assert abs(one["gain"] - gain) < one["half_interval"]
        # The problem cuts the log into rows for training and for validation, which
        # have other noise.
        assert abs(one["gain"] - other["gain"]) < 0.1 * one["half_interval"]


def test_a_load_and_its_mass_are_stated_together(files, capsys):
    words = ["gains", str(files["robot"]), str(files["empty"]), *WORDS]
    for alone in (["--loaded", str(files["loaded"])], ["--known-mass", "3"]):
        assert main([*words, *alone]) == 2
        assert "needs both its logs and its mass" in capsys.readouterr().err


def test_a_file_without_masses_needs_a_load(files, tmp_path):
    bare = re.sub(r"<inertial>.*?</inertial>", "", urdf())
    (file := tmp_path / "bare.urdf").write_text(bare)
    problem = draft_problem(
        file, files["empty"], select=False, cutoff=8.0, torque_gain=STATED
    ).problem()
    with pytest.raises(RecordingError, match=r"implies no gains.* weigh a known load"):
        problem_gains(problem)


@pytest.mark.slow
def test_logs_without_the_load_show_no_gain(files, tmp_path, capsys):
    again = write_log(tmp_path / "again.csv", None, gains=GAINS, seed=2)
    words = ["gains", files["robot"], files["empty"], "--loaded", again]
    words += ["--known-mass", LOAD.mass, *WORDS]
    assert main(list(map(str, words))) == 1
    out = capsys.readouterr().out
    assert out.startswith("do not use: gains; gains not identifiable")
    assert "torque_gain" not in out and "e+" not in out


def _independent(relative_errors):
    return np.diag(relative_errors**2)


@pytest.mark.parametrize(("z", "joints", "off"), [(2.2, 1, True), (2.2, 4, False)])
def test_several_gains_are_tested_together(found, z, joints, off):
    """One gain is off by 2.2 standard errors: 1.96 for one, 2.49 for four (Sidak)."""
    gains = np.ones(4)[:joints]
    gains[0] = 1.1
    own = replace(
        found.factors,
        joints=JOINTS[:joints],
        gains=gains,
        covariance=_independent(np.full(joints, 0.1 / z) / gains),
        linear=gains,
        current_noise=gains,
    )
    assert gains_off(own).tolist() == [off, *[False] * (joints - 1)]


def test_the_quantile_is_that_of_all_joints(found):
    for z, off in ((2.48, False), (2.50, True)):
        own = replace(
            found.factors,
            gains=np.full(4, 1.1),
            covariance=_independent(np.full(4, 0.1 / z / 1.1)),
        )
        assert gains_off(own).tolist() == [off] * 4
    small = replace(
        found.factors,
        gains=np.full(4, 1.019),
        covariance=_independent(np.full(4, 1e-4)),
    )
    assert not gains_off(small).any()  # less than 2 %


def test_torques_of_commands_have_no_gains_of_currents(files):
    problem = draft_problem(
        files["robot"], files["empty"], select=False, cutoff=8.0
    ).problem()
    data = msgspec.structs.replace(problem.table.data, gains=GainsTable(kp=100.0))
    table = msgspec.structs.replace(problem.table, data=data)
    with pytest.raises(ProblemError, match="computes torque from the joints' commands"):
        check_gains(replace(problem, table=table), files["loaded"], known_mass=1.0)


@pytest.mark.slow
def test_a_link_that_is_called_load_is_no_obstacle(tmp_path):
    file = tmp_path / "robot.urdf"
    file.write_text(urdf().replace('"link3"', '"load"'))
    logs = [
        write_log(tmp_path / f"{name}.csv", load, gains=GAINS, seed=seed)
        for seed, (name, load) in enumerate({"empty": None, "loaded": LOAD}.items())
    ]
    problem = draft_problem(
        file, logs[0], select=False, cutoff=8.0, torque_gain=STATED
    ).problem()
    found = check_gains(problem, logs[1], known_mass=LOAD.mass, link="flange")
    assert found.verdict.usable
    with pytest.raises(ModelError, match="'load', which is a link of 'arm'"):
        weigh_load(problem, logs[1], name="load")
