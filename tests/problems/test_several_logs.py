"""Several logs of one robot: who learns, who judges, and what is delivered."""

import json
from functools import cache

import numpy as np
import pytest
from logged import DRIVE, FRICTION, moved, write_arm

from consistent_id import (
    Estimate,
    ProblemError,
    RecordingError,
    TorqueModel,
    build_regression,
    constrained_least_squares,
    draft_problem,
    identify_log,
    load_problem,
    load_robot,
)
from consistent_id.cli import main
from consistent_id.estimation.method import Method
from consistent_id.problems.problem_estimates import unmeasured_notes

HEADER = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow"


def write_log(path, recording, *, scale=1.0):
    table = [recording.time, recording.position, scale * recording.torque]
    np.savetxt(path, np.column_stack(table), "%.9g", ",", header=HEADER, comments="")
    return path


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arms")
    urdf, first = write_arm(folder)
    model = TorqueModel(load_robot(urdf), DRIVE)
    second = write_log(folder / "second.csv", moved(model, 16.0, tempo=1.13))
    third = write_log(folder / "third.csv", moved(model, 12.0, tempo=0.89))
    return urdf, first, second, third


def test_logs_that_are_named_judge_and_all_others_are_learnt_from(arm):
    urdf, first, second, third = arm
    draft = draft_problem(
        urdf, [first, second], validation=[third], select=False, cutoff=10.0
    )
    roles = [(entry.log, entry.role) for entry in draft.recordings]
    assert roles == [(first, "training"), (second, "training"), (third, "validation")]
    problem = draft.problem()
    seconds = [log.duration for log in (*problem.training, *problem.validation)]
    # Each moves but for a second at either end.
    assert seconds == pytest.approx([22.0, 14.0, 10.0], abs=0.5)


def test_without_logs_to_judge_by_each_keeps_its_last_part_for_that(arm):
    urdf, first, second, _ = arm
    draft = draft_problem(urdf, [first, second], select=False, cutoff=10.0)
    assert [e.role for e in draft.recordings] == ["training"] * 2 + ["validation"] * 2
    for learnt, held in zip(draft.recordings[:2], draft.recordings[2:], strict=True):
        assert learnt.log == held.log
        assert held.rows[0] == learnt.rows[1] + 1
        length = held.rows[1] - learnt.rows[0]
        assert (learnt.rows[1] - learnt.rows[0]) / length == pytest.approx(
            0.7, abs=0.01
        )


@pytest.mark.slow
def test_what_judges_changes_nothing_that_is_chosen(arm, tmp_path):
    urdf, first, _, third = arm
    model = TorqueModel(load_robot(urdf), DRIVE)
    other = write_log(tmp_path / "third.csv", moved(model, 12.0), scale=-50.0)
    one, two = (draft_problem(urdf, first, validation=[log]) for log in (third, other))
    for name in (
        "cutoff",
        "cutoff_reason",
        "resample",
        "max_gap",
        "masses",
        "training",
    ):
        assert getattr(one, name) == getattr(two, name)


@pytest.mark.parametrize("twice", ["training", "validation"])
def test_a_log_has_one_role(arm, twice):
    urdf, first, second, _ = arm
    logs = [first, first] if twice == "training" else [first, second]
    held_out = [second] if twice == "validation" else []
    with pytest.raises(ProblemError, match="given twice"):
        draft_problem(urdf, logs, validation=held_out)


def test_a_log_without_the_firsts_columns_is_refused_by_name(arm, tmp_path):
    urdf, first, _, _ = arm
    other = tmp_path / "other.csv"
    other.write_text(first.read_text().replace("tau_elbow", "torque_elbow"))
    with pytest.raises(RecordingError, match=r"other\.csv: no column 'tau_elbow'"):
        draft_problem(urdf, [first, other])


@cache
def studied(urdf, first, third):
    return identify_log(urdf, first, validation=third)


@pytest.mark.slow
def test_what_is_delivered_is_fitted_to_all_data_and_judged_before(arm):
    urdf, first, _, third = arm
    study = studied(urdf, first, third)
    delivered, judged = study.delivered, study.recommended.with_verdict
    assert delivered.method == judged.method
    assert delivered.verdict == judged.verdict
    assert delivered.notes[0].startswith("fitted again")
    # By the public functions alone, on all recordings.
    problem = study.problem
    every = build_regression(problem.model, (*study.training, *study.validation))
    assert sum(every.counts) > sum(study.regression.counts)
    if judged.method == "constrained":
        prior = study.priors[Method.CONSTRAINED]
        again = constrained_least_squares(
            problem.model, every, constraints=problem.constraints, prior=prior
        )
        np.testing.assert_allclose(delivered.parameters, again.parameters, rtol=1e-6)
    # The truth is better known from more data, and was close before.
    simulated = TorqueModel(load_robot(urdf), DRIVE)
    own = [*simulated.robot.nominal.ravel(), *FRICTION]
    known = dict(zip(simulated.layout.names, own, strict=True))
    names = problem.model.layout.names  # and what selection may have added
    truth = delivered.base.projection @ [known.get(name, 0.0) for name in names]
    size = np.linalg.norm(truth)
    assert np.linalg.norm(delivered.base_values - truth) < 0.05 * size
    assert delivered.certificate.verdict == "certified"


@pytest.mark.slow
def test_a_score_is_the_error_that_the_comparison_has(arm):
    urdf, first, _, third = arm
    study = studied(urdf, first, third)
    score = study.recommended.estimate.score(study.validation[0])
    assert score.stacked == study.recommended.validation[0].stacked
    measured = study.validation[0].torque
    left = measured - study.recommended.estimate.predict(study.validation[0])
    stacked = np.linalg.norm(left) / np.linalg.norm(measured)
    assert score.stacked == pytest.approx(stacked, rel=1e-6)


@pytest.mark.slow
def test_a_raw_log_has_no_score(arm):
    urdf, first, _, _ = arm
    draft = draft_problem(urdf, first, select=False, cutoff=10.0)
    model = draft.problem().model
    regression = build_regression(model, draft.problem().training)
    estimate = constrained_least_squares(model, regression)
    with pytest.raises(ProblemError, match="differentiated"):
        estimate.score(draft.raw[first])


@pytest.mark.slow
def test_the_shell_says_what_is_delivered_and_writes_it(arm, tmp_path, capsys):
    urdf, first, _, third = map(str, arm)
    out = tmp_path / "out"
    page = tmp_path / "report.html"
    arguments = ["identify", urdf, first, "--validate", third, "--output", str(out)]
    assert main([*arguments, "--report", str(page)]) == 0
    assert "delivered estimate: " in capsys.readouterr().out
    assert "fitted again to training and validation data" in page.read_text()
    study = studied(arm[0], arm[1], arm[3])
    estimate = Estimate.load(out / "delivered.json", study.problem.model, study.base)
    np.testing.assert_allclose(
        estimate.parameters, study.delivered.parameters, rtol=1e-9
    )
    assert main([*arguments, "--dry-run", "--json"]) == 0
    assert '"delivered": {' in capsys.readouterr().out


def in_degrees(log, folder):
    """Write a log as a robot's maker would: ms, degrees, percent of rated torque."""
    table = np.loadtxt(log, delimiter=",", skiprows=1)
    table[:, 0] *= 1e3
    table[:, 1:3] = np.degrees(table[:, 1:3])
    table[:, 3:] /= [0.5, 0.2]  # of 50 and 20 N m
    names = "Time [ms],AIPos.A1,AIPos.A2,Torque A1 [%],Torque A2 [%]"
    file = folder / "maker.csv"
    np.savetxt(file, table, "%.12g", ",", header=names, comments="")
    return file


@pytest.mark.slow
def test_a_log_in_its_makers_units_is_the_same_log(arm, tmp_path):
    urdf, first, _, _ = arm
    maker = in_degrees(first, tmp_path)
    ours = draft_problem(urdf, first, select=False, cutoff=10.0)
    theirs = draft_problem(
        urdf, maker, torque_gain=[50.0, 20.0], select=False, cutoff=10.0
    )
    mine, other = ours.problem().training[0], theirs.problem().training[0]
    for channel in ("time", "position", "torque"):
        np.testing.assert_allclose(
            getattr(other, channel), getattr(mine, channel), atol=1e-7
        )
    (tmp_path / "problem.toml").write_text(theirs.text(tmp_path))
    again = load_problem(tmp_path, trust=True).training[0]
    np.testing.assert_array_equal(again.torque, other.torque)


@pytest.mark.slow
def test_check_reads_a_log_as_identify_does(arm, tmp_path, capsys):
    urdf, first, _, _ = arm
    maker = in_degrees(first, tmp_path)
    assert main(["check", str(urdf), str(maker)]) == 2
    assert "--torque-gain" in capsys.readouterr().err
    assert main(["check", str(urdf), str(maker), "--torque-gain", "50", "20"]) == 0
    assert "position is in deg, according to AIPos.A{number}" in capsys.readouterr().out


def test_a_joint_is_locked_where_the_shell_says(arm, tmp_path, capsys):
    urdf, first, _, _ = arm
    log = tmp_path / "log.csv"
    log.write_text(first.read_text().replace("q_elbow", "x").replace("tau_elbow", "y"))
    plain = ["--no-select", "--cutoff", "10"]
    arguments = ["init", str(urdf), str(log), *plain, "--dry-run"]
    arguments += ["--lock", "elbow=0.5"]
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert "locked = {elbow = 0.5}" in text
    assert "# Locked: elbow at 0.5." in text
    assert main([*arguments[:-1], "elbo"]) == 2
    assert "known: elbow" in capsys.readouterr().err


@pytest.mark.slow
def test_a_joint_without_torque_is_said_first_and_where_the_robot_goes(
    arm, tmp_path, capsys
):
    urdf, first, _, _ = arm
    log = tmp_path / "log.csv"
    log.write_text(first.read_text().replace("tau_elbow", "x"))
    said = "the torque of elbow is not measured"
    plain = ["--no-select", "--cutoff", "10", "--output", str(tmp_path / "found")]
    main(["identify", str(urdf), str(log), *plain])
    assert said in "".join(capsys.readouterr().out.splitlines()[:4])
    estimate = json.loads((tmp_path / "found" / "constrained.json").read_text())
    assert [said in note for note in estimate["notes"]].count(True) == 1
    export = ["export", str(tmp_path / "found"), "--format", "numpy", "--dry-run"]
    main([*export, "--json", "--output", str(tmp_path / "model.py")])
    notes = json.loads(capsys.readouterr().out)["notes"]
    assert [said in note for note in notes].count(True) == 1
    assert not unmeasured_notes(
        draft_problem(urdf, first, select=False).problem().model
    )
