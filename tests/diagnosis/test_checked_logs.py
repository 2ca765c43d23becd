"""Logs and problems checked as a whole, from Python and from the shell."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from faulty_logs import DRIVE, logs
from logged import write_arm
from schemas import parsed

import consistent_id as ci
from consistent_id import TorqueModel
from consistent_id.diagnosis import LogFinding, all_logs
from consistent_id.diagnosis.one_log import OpenLog
from consistent_id.problems.log_check import check_problem

ARM_URDF = """<robot name="arm">
<link name="base"/>
<link name="upper"><inertial><origin xyz="0.2 0.05 0"/><mass value="5"/>
<inertia ixx="0.05" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.15 0 0.05"/><mass value="3"/>
<inertia ixx="0.03" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="3" effort="200"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
<origin xyz="0.4 0 0"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" velocity="3" effort="200"/></joint>
</robot>"""


PROBLEM = """name = "periods"
description = "One motion, twice."
source = "simulated"
licence = "none"
[model]
urdf = "arm.urdf"
[drive]
viscous = true
coulomb = "tanh"
velocity_scale = 0.02
offset = true
[constraints]
masses = "datasheet"
[data]
folder = "."
torque_joints = ["shoulder"]
[data.columns]
torque = "tau_{joint}"
[data.preparation]
motion_cutoff = 8.0
torque_cutoff = 8.0
[[data.recordings]]
file = "log.csv"
role = "training"
rows = [1, 2000]
[[data.recordings]]
file = "log.csv"
role = "validation"
rows = [2001, 4000]
"""


def _arm_in(folder):
    """Write the arm of two joints, and return a clean log of it."""
    from consistent_id.robot import load_urdf

    (folder / "arm.urdf").write_text(ARM_URDF)
    model = TorqueModel(load_urdf(folder / "arm.urdf"), DRIVE)
    return logs().clean(model, np.random.default_rng(3)).log


@pytest.mark.slow
def test_a_problem_whose_validation_repeats_its_training_is_found(tmp_path):
    from consistent_id import load_problem
    from consistent_id.diagnosis.findings import diagnosis_table
    from consistent_id.problems.log_check import check_problem

    log = _arm_in(tmp_path)
    # The elbow's torque was not recorded: there is no column for it.
    table = np.column_stack([log.time, log.position, log.torque[:, 0]])
    names = "time,q_shoulder,q_elbow,tau_shoulder"
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=names, comments="")
    (tmp_path / "problem.toml").write_text(PROBLEM)
    found = check_problem(load_problem(tmp_path))
    assert found.suspicious == ()
    (note,) = found.of("repeated motion")
    assert "log.csv (10 to 20 s)" in note.recording
    assert "repeats log.csv (0 to 9.995 s)" in diagnosis_table(found).text()


@pytest.mark.slow
@pytest.mark.parametrize(("sign", "code"), [(1.0, 0), (-1.0, 1)])
def test_the_shell_checks_a_log_without_a_problem_file(tmp_path, capsys, sign, code):
    from consistent_id.cli import main

    log = _arm_in(tmp_path)
    torque = log.torque * [1.0, sign]
    table = np.column_stack([log.time, log.position, torque])
    names = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow"
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=names, comments="")
    arguments = ["check", str(tmp_path / "arm.urdf"), str(tmp_path / "log.csv")]
    assert main(arguments) == code
    out = capsys.readouterr().out
    assert ("torque sign" in out and "elbow" in out) == (code == 1)
    assert main([*arguments, "--json"]) == code
    parsed(capsys.readouterr().out)


@pytest.mark.slow
def test_the_shell_checks_a_log_without_the_torque_of_some_joints(tmp_path, capsys):
    from consistent_id.cli import main

    log = _arm_in(tmp_path)
    missing = np.full(len(log), np.nan)
    table = np.column_stack([log.time, log.position, log.torque[:, 0], missing])
    names = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow"
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=names, comments="")
    arguments = ["check", str(tmp_path / "arm.urdf"), str(tmp_path / "log.csv")]
    assert main(arguments) == 2
    assert main([*arguments, "--torque-joints", "shoulder"]) == 0
    assert "Nothing suspicious was found in log.csv" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("filtered", "undone", "found"),
    [
        (True, 0.11, [("drive filter", "fault")]),
        (False, 0.11, [("lag", "warning")]),
        (False, 0.0, []),
    ],
)
def test_a_delay_that_is_undone_hides_no_filter(tmp_path, filtered, undone, found):
    from consistent_id import load_problem
    from consistent_id.diagnosis.torque_causes import low_pass
    from consistent_id.problems.log_check import check_problem

    log = _arm_in(tmp_path)
    rate, torque = log.rate, log.torque
    if filtered:  # at 1 Hz
        torque = low_pass(torque.T, rate / (2.0 * np.pi)).T
    elif undone:
        torque = np.roll(torque, round(undone * rate), axis=0)
    table = np.column_stack([log.time, log.position, torque])[50:]
    names = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow"
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=names, comments="")
    text = PROBLEM.replace('torque_joints = ["shoulder"]\n', "")
    text = text.replace("rows = [2001, 4000]", "rows = [2001, 3950]")
    delays = f"[data.preparation]\ndelays = {{torque = {undone}}}"
    text = text.replace("[data.preparation]", delays)
    (tmp_path / "problem.toml").write_text(text)
    suspicious = check_problem(load_problem(tmp_path)).suspicious
    assert {(f.kind, f.severity) for f in suspicious} == set(found)


@pytest.mark.slow
def test_a_torque_that_never_turns_and_is_reversed_is_no_magnitude(tmp_path):
    """The advice is a gain that mends it, not to log a sign that is there."""
    urdf, log = write_arm(tmp_path)
    head, *rows = log.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    turned = [[*c[:3], str(-float(c[3])), c[4]] for c in cells]
    log.write_text("\n".join([head, *map(",".join, turned)]))
    problem = ci.draft_problem(urdf, log, select=False, cutoff=10.0).problem()
    found = check_problem(problem).findings
    faults = [f for f in found if f.kind == "torque sign"]
    assert {fault.where for fault in faults} == {"shoulder"}
    assert all("negative gain (--torque-gain" in fault.advice for fault in faults)
    mended = ci.draft_problem(
        urdf, log, select=False, cutoff=10.0, torque_gain=[-1.0, 1.0]
    )
    assert not [
        f for f in check_problem(mended.problem()).findings if f.kind == "torque sign"
    ]


def _said(kind, severity="fault"):
    return LogFinding(kind, severity, "all joints", "said", "", 1.0)


@pytest.mark.parametrize(
    ("odd", "whole", "kinds"),
    [
        # Other masses stand in for a clock that nominal bodies show.
        (["masses or gain"], [_said("clock")], ["clock"]),
        (["masses or gain"], [_said("clock", "warning")], ["masses or gain"]),
        (["masses or gain"], [_said("masses or gain")], ["masses or gain"]),
        (["masses or gain"], [_said("hidden factor", "note")], ["masses or gain"]),
        # Other faults of a log are their own cause.
        (["load"], [_said("clock")], ["load"]),
        ([], [_said("clock"), _said("hidden factor", "note")], ["clock", "hidden"]),
    ],
)
def test_other_masses_do_not_stand_in_for_what_all_logs_show(
    monkeypatch, odd, whole, kinds
):
    model = SimpleNamespace(torque_joints=("shoulder", "elbow"))
    fitted = SimpleNamespace(
        factors=SimpleNamespace(model=model), recording=SimpleNamespace(name="a.csv")
    )
    monkeypatch.setattr(all_logs, "joint_shifts", lambda _: [])
    monkeypatch.setattr(all_logs, "scale_instead", lambda *values: values[-1])
    monkeypatch.setattr(all_logs, "_of_whole_robot", lambda _: whole)
    open_ = OpenLog(fitted, (), tuple(_said(kind) for kind in odd))
    found = all_logs._of_all([open_])
    assert [f.kind.partition(" factor")[0] for f in found] == kinds
    # A torque that is held, and so late, may be the cause of what all logs show.
    if not odd:
        coarse = _said("torque resolution", "warning")
        held = replace(coarse, size="0.1")
        for signal, severity in ((coarse, "fault"), (held, "warning")):
            noisy = OpenLog(fitted, (signal,), ())
            first, *_ = all_logs._of_all([noisy])
            assert (first.kind, first.severity) == ("clock", severity)
