"""What a rollout does where its choices fail: it goes on, and says why."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("mujoco")

import mujoco
from commanded_leg import write_leg

from consistent_id import load_problem
from consistent_id.errors import RecordingError
from consistent_id.problems.study import Study
from consistent_id.rollout import (
    candidates,
    chosen_settings,
    problem_rollout,
    refine,
    refined_parts,
    refinement_choice,
)
from consistent_id.rollout.motion_parts import slow_and_fast
from consistent_id.rollout.problem_rollout import rollout_of
from consistent_id.rollout.rollout_slopes import finite_changes
from consistent_id.rollout.settings import Settings, replay_errors, torque_fit


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    folder = tmp_path_factory.mktemp("leg")
    write_leg(folder)
    return load_problem(folder)


def with_log(problem, folder, rows, count):
    """Return the problem with another log, all of it for training."""
    for name in ("leg.xml", "problem.toml"):
        text = (problem.folder / name).read_text()
        (folder / name).write_text(text.replace("[1, 1200]", f"[1, {count}]"))
    text = (folder / "problem.toml").read_text()
    (folder / "problem.toml").write_text(text[: text.rindex("[[data.recordings]]")])
    head = "time,q1,q2,qdes1,qdes2"
    np.savetxt(folder / "log.csv", rows, delimiter=",", header=head, comments="")
    return load_problem(folder)


def rested(problem, before, after):
    """Return 4 s of the log with rest before and after it, as rows of its file."""
    rows = np.loadtxt(problem.folder / "log.csv", delimiter=",", skiprows=1)[:800]
    rows = np.vstack([rows[[0] * before], rows, rows[[-1] * after]])
    rows[:, 0] = np.arange(len(rows)) / 200.0
    return rows


def titles(done):
    return [table.title for table in done.tables()]


def unstable(problem, training=None):
    """Return a torque fit whose friction drives the knee: its motion diverges."""
    estimate, regression = torque_fit(problem, training)
    x = estimate.parameters.copy()
    x[estimate.model.layout.names.index("knee.viscous")] = -30.0
    return replace(estimate, parameters=x), regression


def test_a_step_to_a_motion_that_diverges_is_halved():
    def errors(x, delay):
        if x[0] > 0.6:
            raise RecordingError("diverges")
        return np.array([[1.0 - x[0]]])

    start = SimpleNamespace(
        replays=SimpleNamespace(errors=errors), delay=0.0, level=np.ones(1)
    )
    x, size = refine._descended(start, (np.zeros(1), 1.0), np.ones(1))
    assert x == 0.5 and size == 0.5


@pytest.mark.slow
def test_a_motion_that_diverges_is_an_error_and_mujoco_writes_nothing(
    problem, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)  # where it would write its MUJOCO_LOG.TXT
    estimate, _ = unstable(problem)
    with pytest.raises(RecordingError, match="diverges"):
        replay_errors(problem, estimate, problem.logs("training"))
    assert capfd.readouterr().err == "" and not list(tmp_path.iterdir())
    assert mujoco.get_mju_user_warning() is None


@pytest.mark.slow
def test_a_users_own_handler_of_warnings_stays(problem):
    seen = []
    mujoco.set_mju_user_warning(seen.append)
    try:
        estimate, _ = unstable(problem)
        with pytest.raises(RecordingError, match="diverges"):
            replay_errors(problem, estimate, problem.logs("training"))
        assert seen and mujoco.get_mju_user_warning() is not None
    finally:
        mujoco.set_mju_user_warning(None)


@pytest.mark.slow
def test_a_robot_without_inertia_diverges(problem):
    estimate, _ = torque_fit(problem)
    x = estimate.parameters.copy()
    x[estimate.model.layout.names.index("shank.hx")] = 1e15
    lost = replace(estimate, parameters=x)
    with pytest.raises(RecordingError, match="diverges"):
        replay_errors(problem, lost, problem.logs("training"))


def test_parameters_that_torque_feels_by_rounding_alone_have_no_finite_step(problem):
    _, regression = torque_fit(problem)
    place = regression.layout.names.index("thigh.hx")
    factors = []
    for factor in regression.factors:
        changed = np.array(factor)
        changed[:, place] *= 1e-15
        factors.append(changed)
    assert np.isfinite(finite_changes(regression)[place])
    known = SimpleNamespace(
        layout=regression.layout,
        factors=factors,
        counts=regression.counts,
        torque_rms=regression.torque_rms,
    )
    assert np.isinf(finite_changes(known)[place])


@pytest.mark.slow
def test_a_part_whose_fit_diverges_is_not_refined_and_the_run_goes_on(
    problem, monkeypatch
):
    monkeypatch.setattr(refined_parts, "torque_fit", unstable)
    done = rollout_of(Study(problem), refine=True)
    assert done.refinement is None and done.ridge.ridge is None
    assert set(done.ridge.errors.values()) == {np.inf}
    (told,) = [title for title in titles(done) if "Refinement" in title]
    assert "not possible" in told and "diverges" in told


@pytest.mark.slow
def test_a_refined_estimate_that_diverges_later_falls_back(problem, monkeypatch):
    bad = refine.Refined(unstable(problem)[0], 1e-3, 1e-3)
    taken = refinement_choice.RidgeChoice(1.0, {None: 2e-3, 1.0: 1e-3})
    monkeypatch.setattr(problem_rollout, "chosen_ridge", lambda *given: taken)
    monkeypatch.setattr(problem_rollout, "_refined", lambda *rest: bad)
    study = Study(problem)
    done = rollout_of(study, refine=True)
    assert done.estimate.method == study.recommendation.method
    (note,) = done.notes
    assert "not refined" in note and "diverges" in note
    assert note in titles(done) and done.to_dict()["notes"] == [note]


@pytest.mark.slow
def test_settings_that_leave_no_rows_fall_back_to_those_that_are_stated(
    problem, monkeypatch
):
    still = chosen_settings.SettingsChoice(Settings(least_joint_speed=1e3), 1e-3, ())
    monkeypatch.setattr(problem_rollout, "chosen_settings", lambda *a, **k: still)
    done = rollout_of(Study(problem), choose=True)
    assert done.settings is None and done.problem.table == problem.table
    (note,) = done.notes
    assert note.startswith("The replayed estimate is not with the chosen settings: ")
    assert "hip" in note  # which joint has no rows


@pytest.mark.parametrize(("before", "after"), [(0, 540), (540, 0), (300, 300)])
def test_the_time_of_motion_is_split_where_a_log_is_partly_at_rest(
    problem, tmp_path, before, after
):
    rows = rested(problem, before, after)
    spans = slow_and_fast(with_log(problem, tmp_path, rows, len(rows)))
    begun, ended = rows[before, 0], rows[-1, 0] - after / 200.0
    (slow,), (fast,) = spans
    assert slow[1] - slow[0] > fast[1] - fast[0] > 1.0  # of 4 s
    for start, stop in (slow, fast):
        assert begun - 0.6 < start < stop < ended + 0.6
    assert slow[1] < fast[0]  # the chirp grows faster


@pytest.mark.parametrize("form", ["rest", "short"])
def test_settings_are_as_stated_where_motion_is_too_short(problem, tmp_path, form):
    rows = rested(problem, 0, 0)
    rows[30 if form == "short" else 0 :, 1:] = rows[0, 1:]
    known = with_log(problem, tmp_path, rows, 90 if form == "short" else 800)
    with pytest.raises(RecordingError, match="two parts"):
        slow_and_fast(known)


@pytest.mark.slow
def test_a_run_whose_settings_cannot_be_chosen_has_those_that_are_stated(
    problem, monkeypatch
):
    def none(problem):
        raise RecordingError("too short for two parts")

    monkeypatch.setattr(candidates, "slow_and_fast", none)
    monkeypatch.setattr(refined_parts, "slow_and_fast", none)
    done = rollout_of(Study(problem), choose=True, refine=True)
    assert done.settings is None and done.refinement is None
    assert done.problem.table == problem.table
    assert done.notes == ("Settings are as stated: too short for two parts",)
    assert done.ridge.reason == "too short for two parts"
    assert done.notes[0] in titles(done)
