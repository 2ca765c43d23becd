"""Gains that the bodies imply, and messages that propose all that a log needs."""

import re
import shlex
from dataclasses import replace

import numpy as np
import pytest
from schemas import parsed

import consistent_id as ci
from consistent_id.cli import main
from consistent_id.errors import RecordingError
from consistent_id.problems.log_check import check_problem
from consistent_id.problems.nominal_gains import NominalGains, nominal_gains
from consistent_id.problems.robot_logs import robot_logs
from consistent_id.problems.statement import statement_of

URDF = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="3"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.05"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.15 0 0"/><mass value="2"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.03"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="90" velocity="5"/></joint>
<joint name="elbow" type="revolute"><origin xyz="0.4 0 0"/><parent link="upper"/>
<child link="fore"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="90" velocity="5"/></joint></robot>"""
GAINS = np.array([11.0, -7.0])


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "arm.urdf").write_text(URDF)
    return ci.load_robot(tmp_path / "arm.urdf")


def motion():
    t = np.arange(0.0, 20.0, 0.01)
    q = np.column_stack([np.sin(0.9 * t) + 0.3 * np.sin(2.3 * t), np.cos(1.4 * t)])
    dq = np.column_stack(
        [0.9 * np.cos(0.9 * t) + 0.69 * np.cos(2.3 * t), -1.4 * np.sin(1.4 * t)]
    )
    ddq = np.column_stack(
        [-0.81 * np.sin(0.9 * t) - 1.587 * np.sin(2.3 * t), -1.96 * np.cos(1.4 * t)]
    )
    return t, q, dq, ddq


def currents(arm, rotor=0.5, bodies=None):
    """Return currents of Newton and Euler's torque, friction and rotors."""
    t, q, dq, ddq = motion()
    still = ci.Recording(arm.joint_names, t, q, velocity=dq, acceleration=ddq)
    if bodies is None:
        bodies = np.concatenate([link.nominal.vector for link in arm.links])
    torque = ci.simulate_torque(ci.TorqueModel(arm), bodies, still).torque
    return (torque + rotor * ddq + 2.0 * dq + 3.0 * np.tanh(dq / 0.05)) / GAINS


def test_gains_are_those_of_the_bodies_whatever_rotors_and_friction_are(arm):
    t, q, _, _ = motion()
    found = nominal_gains(
        arm, ci.Recording(arm.joint_names, t, q, torque=currents(arm))
    )
    assert found.known == (True, True)
    # Filters and differences of 100 Hz change the torque by a few parts in a thousand.
    np.testing.assert_allclose(found.values, GAINS, rtol=0.01)
    assert "standard errors shoulder" in found.sentence


def test_the_ratio_of_gains_does_not_depend_on_wrong_centres_of_mass(arm):
    upper, fore = (link.nominal for link in arm.links)
    moved = [
        ci.InertialParameters.from_central(b.mass, b.com * k, b.central_inertia).vector
        for b, k in ((upper, 1.2), (fore, 0.8))
    ]
    t, q, _, _ = motion()
    torque = currents(arm, bodies=np.concatenate(moved))
    found = nominal_gains(arm, ci.Recording(arm.joint_names, t, q, torque=torque))
    ratio = found.values[0] / found.values[1]
    # The nominal bodies make the elbow's gravity torque 1.25 times the true one.  The
    # shoulder carries the same link, so the two together show the link's centre.
    assert ratio == pytest.approx(GAINS[0] / GAINS[1], rel=0.1)
    assert found.values[1] == pytest.approx(GAINS[1], rel=0.1)
    off = abs(found.values - GAINS)
    assert (off <= 2.0 * found.errors).all()


@pytest.mark.slow
def test_logs_together_have_smaller_errors_and_one_table(tmp_path, arm, capsys):
    t, q, _, _ = motion()
    log = ci.Recording(arm.joint_names, t, q, torque=currents(arm))
    one, two = nominal_gains(arm, log), nominal_gains(arm, log, log)
    np.testing.assert_allclose(two.values, GAINS, rtol=0.01)
    assert (two.errors <= one.errors).all()
    names = [f"{word}{k}" for word in ("q", "current") for k in (1, 2)]
    np.savetxt(
        tmp_path / "log.csv",
        np.column_stack([t, q, currents(arm)]),
        delimiter=",",
        header=",".join(["t", *names]),
        comments="",
    )
    words = ["gains", str(tmp_path / "arm.urdf"), str(tmp_path / "log.csv"), "--json"]
    assert main(words) == 0
    found = parsed(capsys.readouterr().out, "model-gains-1")
    for joint, gain in zip(arm.joint_names, GAINS, strict=True):
        known = found["gains"][joint]
        assert abs(known["gain"] - gain) <= known["half_interval"]
    assert main(words[:2]) == 2
    assert main([*words, "--known-mass", "2"]) == 2


@pytest.mark.slow
def test_gains_are_proposed_for_a_log_of_fewer_joints_than_the_robot(
    tmp_path, arm, capsys
):
    hand = f"""<joint name="grip" type="revolute"><parent link="{arm.links[-1].name}"/>
      <child link="hand"/> <axis xyz="1 0 0"/>
      <limit lower="-1" upper="1" velocity="1" effort="9"/></joint>
      <link name="hand"><inertial><mass value="1e-6"/>
      <inertia ixx="1e-9" ixy="0" ixz="0" iyy="1e-9" iyz="0" izz="1e-9"/>
      </inertial></link></robot>"""
    urdf, log = tmp_path / "arm.urdf", tmp_path / "log.csv"
    urdf.write_text(urdf.read_text().replace("</robot>", hand))
    t, q, _, _ = motion()
    names = [f"{word}_{n}" for word in ("q", "current") for n in arm.joint_names]
    columns = np.column_stack([t, q, currents(arm)])
    head = ",".join(["t", *names])
    np.savetxt(log, columns, delimiter=",", header=head, comments="")
    assert main(["check", str(urdf), str(log)]) == 2
    assert f"check {urdf} {log} --torque-gain" in capsys.readouterr().err


def test_reversed_columns_are_said(arm):
    t, q, _, _ = motion()
    backwards = currents(arm) * np.sign(GAINS) * -1.0
    found = nominal_gains(arm, ci.Recording(arm.joint_names, t, q, torque=backwards))
    assert "all are negative, so the columns are reversed" in found.sentence


def test_noise_has_no_known_gain(arm):
    t, q, _, _ = motion()
    noise = np.random.default_rng(0).normal(size=q.shape)
    assert nominal_gains(arm, ci.Recording(arm.joint_names, t, q, torque=noise)) is None


def test_a_resting_arm_that_is_touched_implies_no_gains(arm):
    t, q, _, _ = motion()
    torque = 30.0 + 2.0 * q  # bends the arm a little where it is pushed
    resting = ci.Recording(arm.joint_names, t, 0.7 + 1e-3 * q, torque=torque)
    assert nominal_gains(arm, resting) is None


def unnamed(folder, arm, *, twice=False):
    t, q, dq, _ = motion()
    table = np.column_stack([t, q, dq, GAINS * currents(arm)])
    if twice:
        table = np.repeat(table, 2, axis=0)
    np.savetxt(folder / "log.csv", table, delimiter=",")
    return folder / "log.csv"


@pytest.mark.slow
def test_a_message_proposes_all_that_a_log_needs_and_that_is_enough(tmp_path, arm):
    log = unnamed(tmp_path, arm, twice=True)
    with pytest.raises(RecordingError, match="no header") as refusal:
        robot_logs(tmp_path / "arm.urdf", log)
    assert "--duplicates first" in refusal.value.options
    assert "time goes from" in str(refusal.value)


@pytest.mark.slow
def test_the_command_to_try_is_the_one_given_with_the_options(tmp_path, arm, capsys):
    log, robot = unnamed(tmp_path, arm), tmp_path / "arm.urdf"
    assert main(["init", str(robot), str(log)]) == 2
    said = capsys.readouterr().err
    words = shlex.split(re.search("^try: consistent-id (.*)$", said, re.M)[1])
    assert words[:3] == ["init", str(robot), str(log)]
    assert words[words.index("--torque") + 1] == "column{6..7}"
    stated = statement_of({"time": "column1", "position": "column{2..3}"})
    stated = replace(stated, torque="column{6..7}")
    assert robot_logs(robot, log, stated).read(log).joints == arm.joint_names


@pytest.mark.slow
def test_the_files_of_one_recording_are_replaced_by_their_folder(tmp_path, arm, capsys):
    t, q, _, _ = motion()
    folder, names = tmp_path / "run", ("position", "effort")
    folder.mkdir()
    for name, values in zip(names, (q, GAINS * currents(arm)), strict=True):
        header = ",".join(["t", *(f"{joint}_{name}" for joint in arm.joint_names)])
        table = np.column_stack([t, values])
        file = folder / f"{name}.csv"
        np.savetxt(file, table, delimiter=",", header=header, comments="")
    robot = str(tmp_path / "arm.urdf")
    files = [str(folder / f"{name}.csv") for name in names]
    assert main(["init", robot, *files]) == 2
    assert f"try: consistent-id init {robot} {folder}\n" in capsys.readouterr().err
    read = robot_logs(tmp_path / "arm.urdf", folder).read(folder)
    assert abs(read.torque - GAINS * currents(arm)).max() < 1e-9


@pytest.mark.slow
def test_files_are_replaced_however_their_paths_are_written(
    tmp_path, arm, capsys, monkeypatch
):
    t, q, _, _ = motion()
    folder = tmp_path / "a b" / "run"
    folder.mkdir(parents=True)
    for name, values in (("position", q), ("effort", GAINS * currents(arm))):
        header = ",".join(["t", *(f"{joint}_{name}" for joint in arm.joint_names)])
        table = np.column_stack([t, values])
        file = folder / f"{name}.csv"
        np.savetxt(file, table, delimiter=",", header=header, comments="")
    monkeypatch.chdir(tmp_path)
    files = ["./a b/run/position.csv", "a b//run/effort.csv"]
    assert main(["init", "arm.urdf", *files, "--dry-run"]) == 2
    said = capsys.readouterr().err
    assert "try: consistent-id init arm.urdf 'a b/run' --dry-run\n" in said


def repeated(folder, arm):
    """Write the same motion twice, with the log's own names; return the files."""
    t, q, _, _ = motion()
    header = "t,Wrist 1 position,B's position,Wrist 1 effort,B's effort"
    files = [folder / "one.csv", folder / "two.csv"]
    for file in files:
        table = np.column_stack([t, q, GAINS * currents(arm)])
        np.savetxt(file, table, delimiter=",", header=header, comments="")
    return [str(file) for file in files]


def test_channels_in_several_folders_are_answered_with_a_folder(tmp_path, arm, capsys):
    """No option reads files that are each a recording of one channel."""
    t, q, _, _ = motion()
    files = []
    for name, values in (("position", q), ("effort", GAINS * currents(arm))):
        header = ",".join(["t", *(f"{joint}_{name}" for joint in arm.joint_names)])
        folder = tmp_path / name
        folder.mkdir()
        files.append(str(folder / "log.csv"))
        table = np.column_stack([t, values])
        np.savetxt(files[-1], table, delimiter=",", header=header, comments="")
    assert main(["init", str(tmp_path / "arm.urdf"), *files]) == 2
    assert "give a folder in which they are alone" in capsys.readouterr().err


@pytest.mark.slow
def test_repeated_runs_with_one_clock_are_no_tables_of_one_recording(
    tmp_path, arm, capsys
):
    files = repeated(tmp_path, arm)
    robot = str(tmp_path / "arm.urdf")
    assert main(["init", robot, *files, "--dry-run"]) == 2
    words = shlex.split(re.search("^try: .*$", capsys.readouterr().err, re.M)[0])
    assert words[2:6] == ["init", robot, *files]
    shoulder, elbow = arm.joint_names
    mapped = [f"Wrist 1={shoulder}", f"B's={elbow}"]
    assert words[words.index("--names") + 1 :][:2] == mapped


@pytest.mark.slow
@pytest.mark.parametrize(
    ("column", "factor"), [("curr_{}_mA", 1e3), ("Torque J{}[%]", 100.0)]
)
def test_currents_in_other_units_have_implied_gains(tmp_path, arm, column, factor):
    t, q, _, _ = motion()
    names = ["pos_1", "pos_2", column.format(1), column.format(2)]
    np.savetxt(
        tmp_path / "log.csv",
        np.column_stack([t, q, factor * currents(arm)]),
        delimiter=",",
        header=",".join(["t", *names]),
        comments="",
    )
    with pytest.raises(RecordingError) as refused:
        robot_logs(tmp_path / "arm.urdf", tmp_path / "log.csv")
    words = shlex.split(refused.value.options)
    assert words[0] == "--torque-gain" and words[3:] == ["--gain-source", "model"]
    np.testing.assert_allclose([float(w) for w in words[1:3]], GAINS, rtol=0.02)


def test_no_command_is_proposed_that_replaces_what_is_stated(tmp_path, arm, capsys):
    file, _ = repeated(tmp_path, arm)
    shoulder, elbow = arm.joint_names
    names = ["--names", f"Wrist 1={elbow}", f"X={shoulder}"]
    assert main(["init", str(tmp_path / "arm.urdf"), file, *names]) == 2
    said = capsys.readouterr().err
    assert "--names" in said and "try:" not in said


@pytest.mark.slow
def test_gains_of_the_models_bodies_are_an_assumption_in_the_check(tmp_path, arm):
    log, robot = unnamed(tmp_path, arm), tmp_path / "arm.urdf"
    columns = {"time": "column1", "position": "column{2..3}", "torque": "column{6..7}"}
    options = {"torque_gain": GAINS, "select": False, "cutoff": 10.0}
    for source in ("drives", "model"):
        draft = ci.draft_problem(robot, log, **columns, gain_source=source, **options)
        folder = tmp_path / source
        folder.mkdir()
        (folder / "problem.toml").write_text(draft.text(folder))
        found = check_problem(ci.load_problem(folder / "problem.toml", trust=True))
        assert bool(found.of("assumed gains")) == (source == "model")


def test_gains_are_written_without_exponents():
    values = np.array([-1234.5, 0.00001234, 87.3])
    found = NominalGains(("a", "b", "c"), values, 0.01 * abs(values), (True,) * 3)
    assert found.option == "--torque-gain -1230 0.0000123 87.3 --gain-source model"
