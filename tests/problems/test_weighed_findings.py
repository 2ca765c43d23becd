"""Warnings about a log are weighed by what they change in the estimate."""

from dataclasses import replace

import numpy as np
import pytest
from logged import DRIVE, FRICTION, write_arm

from consistent_id import (
    Recording,
    TorqueModel,
    draft_problem,
    load_problem,
    simulate_torque,
)
from consistent_id.cli import main
from consistent_id.problems.log_check import named_logs
from consistent_id.problems.study import Study
from consistent_id.problems.weighed_findings import weighed_findings
from consistent_id.recordings.recording import LogFinding
from consistent_id.robot import load_urdf

HEADER = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow"
ELBOW, ANGLE = 4, 2  # columns of the elbow's torque and position
TRAINED, HELD_OUT = 700, 2200  # rows of the part to learn from, and of the other


def study(folder, spoil, noise=1.0):
    """The study of a noisy log, spoilt."""
    urdf, log = write_arm(folder)
    table = np.loadtxt(log, delimiter=",", skiprows=1)
    rng = np.random.default_rng(0)
    table[:, 3:] += rng.normal(size=table[:, 3:].shape) * [0.6 * noise, 0.3 * noise]
    spoil(table)
    np.savetxt(log, table, "%.9g", ",", header=HEADER, comments="")
    file = folder / "problem.toml"
    given = ["init", str(urdf), str(log), "--cutoff", "10", "--no-select"]
    assert main([*given, "--output", str(file)]) == 0
    return Study(load_problem(file))


@pytest.fixture(scope="module")
def late(tmp_path_factory):
    """The study of a log with one outlier in its validation part."""
    return study(tmp_path_factory.mktemp("late"), outlier(25.0, HELD_OUT))


def outlier(size, *rows):
    def spoil(table):
        table[list(rows), ELBOW] += size

    return spoil


def steps(column, size):
    def spoil(table):
        table[:, column] = np.round(table[:, column] / size) * size

    return spoil


def severities(found, kind):
    return {f.severity for f in found if f.kind == kind}


def from_pose_to_pose(folder, held):
    """The study of a log at rest for 1.6 of every 4 s, with friction of its own there.

    Each rest holds the joints by a torque within `held` [N m].
    """
    urdf, log = write_arm(folder)
    model, rng = TorqueModel(load_urdf(urdf), DRIVE), np.random.default_rng(0)
    time = np.arange(6000) / 100.0
    move, since = np.divmod(time, 4.0)
    share = np.clip(since / 2.4, 0.0, 1.0)
    turns = move + share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    q = np.column_stack([np.sin(2.9 * turns), 0.8 * np.sin(4.7 * turns + 1.0)])
    dq = np.gradient(q, time, axis=0)
    exact = Recording(("shoulder", "elbow"), time, q, dq, np.gradient(dq, time, axis=0))
    truth = np.append(model.robot.nominal, FRICTION)
    noisy = simulate_torque(model, truth, exact, noise=[0.6, 0.3], rng=rng)
    stuck = held * rng.uniform(-1.0, 1.0, (15, 2))[move.astype(int)]
    torque = noisy.torque + stuck * (share == 1.0)[:, None]
    table = np.column_stack([time, q, torque])
    np.savetxt(log, table, "%.9g", ",", header=HEADER, comments="")
    drafted = draft_problem(urdf, log, select=False, cutoff=10.0)
    return Study(drafted.problem())


@pytest.mark.slow
def test_rests_count_if_friction_there_changes_the_estimate(tmp_path):
    for name, held, severity in (("free", 0.0, "note"), ("stuck", 2.5, "warning")):
        (tmp_path / name).mkdir()
        found = from_pose_to_pose(tmp_path / name, held)
        assert severities(found.diagnosis.findings, "standstill") == {"warning"}
        learnt, held_out = [f for f in found.findings if f.kind == "standstill"]
        assert (learnt.severity, held_out.severity) == (severity, "note")
        assert "in motion, errors are at most 1.3 times larger" in held_out.statement


@pytest.mark.slow
def test_rests_of_a_log_that_is_not_certain_stay_a_warning(tmp_path, monkeypatch):
    """Such as that of two logs of one name, at the same times."""
    unknown = "consistent_id.problems.weighed_findings._logged_as"
    monkeypatch.setattr(unknown, lambda problem, log: None)
    found = from_pose_to_pose(tmp_path, 0.0)
    learnt, _ = [f for f in found.findings if f.kind == "standstill"]
    assert learnt.severity == "warning"


@pytest.mark.slow
def test_one_outlier_among_noise_is_a_note(tmp_path):
    one = study(tmp_path, outlier(25.0, TRAINED))
    assert severities(one.diagnosis.findings, "outliers") == {"warning"}
    assert severities(one.findings, "outliers") == {"note"}
    (note,) = [f for f in one.findings if f.kind == "outliers"]
    assert "without these samples the estimate changes by 0." in note.statement
    # So little motion of two joints may hide a wrong clock; nothing else is doubted.
    assert [r.kind for r in one.verdict.grounds] == ["hidden factor"]
    # They were weighed for one estimate: the others keep the warning.
    best = one.recommendation.method
    for report in one.comparison.reports:
        kept = {"note" if report.estimate.method == best else "warning"}
        assert severities(report.findings, "outliers") == kept
    own = replace(one.estimate(best), fitted_to=())
    other = replace(own, parameters=own.parameters * 1.001)
    for estimate, doubted in ((own, False), (other, True)):
        grounds = [r.kind for r in one.verdict_on(estimate).grounds]
        assert ("outliers" in grounds) == doubted


@pytest.mark.slow
def test_outliers_that_change_the_estimate_stay_a_warning(tmp_path):
    three = study(tmp_path, outlier(400.0, TRAINED, 900, 1200))
    assert severities(three.findings, "outliers") == {"warning"}
    assert "outliers" in [r.kind for r in three.verdict.grounds]


@pytest.mark.slow
def test_coarse_torque_of_a_joint_whose_friction_no_other_shows_stays(tmp_path):
    coarse = study(tmp_path, steps(ELBOW, 1.0))
    assert severities(coarse.diagnosis.findings, "torque resolution") == {"warning"}
    assert severities(coarse.findings, "torque resolution") == {"warning"}
    assert coarse.verdict.word == "use with care"


@pytest.mark.slow
def test_coarse_positions_are_weighed_by_other_rounding_errors(tmp_path):
    noisy, quiet = (
        study(folder, steps(ANGLE, 0.006), noise)
        for folder, noise in ((tmp_path / "noisy", 1.0), (tmp_path / "quiet", 0.0))
        if not folder.mkdir()
    )
    for found in (noisy, quiet):
        (training,), (validation,) = named_logs(found.problem)
        # Nothing is fitted to the validation part: its coarse positions are a note.
        assert {
            (f.severity, f.recording)
            for f in found.diagnosis.findings
            if f.kind == "encoder resolution"
        } == {("warning", training.name), ("note", validation.name)}
    assert severities(noisy.findings, "encoder resolution") == {"note"}
    assert "warning" in severities(quiet.findings, "encoder resolution")


@pytest.mark.slow
def test_an_outlier_in_the_validation_part_is_a_note_where_the_fit_can_take_it(late):
    assert severities(late.diagnosis.findings, "outliers") == {"warning"}
    (note,) = [f for f in late.findings if f.kind == "outliers"]
    assert note.severity == "note"
    assert "with this recording" in note.statement


@pytest.mark.slow
def test_a_fault_is_never_weighed(tmp_path):
    def reverse(table):
        table[:, ELBOW] *= -1.0

    spoilt = study(tmp_path, reverse)
    assert spoilt.diagnosis.faults
    faults = [f for f in spoilt.findings if f.severity == "fault"]
    assert faults == list(spoilt.diagnosis.faults)
    assert spoilt.verdict.word == "do not use"


@pytest.mark.slow
def test_a_lag_of_the_held_out_part_is_not_weighed_by_what_the_part_changes(late):
    (held_out,) = named_logs(late.problem)[1]
    (spike,) = [f for f in late.diagnosis.findings if f.kind == "outliers"]
    assert spike.recording == held_out.name
    lag = LogFinding("lag", "warning", "all joints", "late", "", 1.0, held_out.name)
    weighed = weighed_findings(
        late.problem,
        [lag, spike],
        lambda: late.estimate(late.recommendation.method),
        late.training,
        late.validation,
    )
    assert [(f.kind, f.severity) for f in weighed] == [
        ("lag", "warning"),
        ("outliers", "note"),
    ]


@pytest.mark.slow
def test_outliers_of_logs_with_one_name_and_one_time_are_not_weighed(tmp_path):
    """Which rows to leave out is not known: the warning stays."""
    files = []
    for name, spikes in (("first", (TRAINED, 900, 1200)), ("second", ())):
        folder = tmp_path / name
        folder.mkdir()
        urdf, log = write_arm(folder)
        table = np.loadtxt(log, delimiter=",", skiprows=1)
        rng = np.random.default_rng(len(files))
        table[:, 3:] += rng.normal(size=table[:, 3:].shape) * [0.6, 0.3]
        table[list(spikes), ELBOW] += 25.0
        np.savetxt(log, table, "%.9g", ",", header=HEADER, comments="")
        files.append(log)
    both = Study(draft_problem(urdf, files, select=False, cutoff=10.0).problem())
    assert severities(both.diagnosis.findings, "outliers") == {"warning"}
    assert severities(both.findings, "outliers") == {"warning"}
