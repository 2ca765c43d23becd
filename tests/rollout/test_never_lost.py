"""What a rollout does where its choices fail: it goes on, and says why."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("mujoco")

from commanded_leg import write_leg

from consistent_id import load_problem
from consistent_id.errors import RecordingError
from consistent_id.problems.study import Study
from consistent_id.rollout import choice, problem_rollout, refine
from consistent_id.rollout.problem_rollout import rollout_of
from consistent_id.rollout.settings import torque_fit


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    folder = tmp_path_factory.mktemp("leg")
    write_leg(folder)
    return load_problem(folder)


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
def test_a_part_whose_fit_diverges_is_not_refined_and_the_run_goes_on(
    problem, monkeypatch
):
    monkeypatch.setattr(choice, "torque_fit", unstable)
    done = rollout_of(Study(problem), refine=True)
    assert done.refinement is None and done.ridge.ridge is None
    assert set(done.ridge.errors.values()) == {np.inf}
    (told,) = [title for title in titles(done) if "Refinement" in title]
    assert "not possible" in told and "diverges" in told


@pytest.mark.slow
def test_a_refined_estimate_that_diverges_later_falls_back(problem, monkeypatch):
    bad = refine.Refined(unstable(problem)[0], 1e-3, 1e-3)
    taken = choice.RidgeChoice(1.0, {None: 2e-3, 1.0: 1e-3})
    monkeypatch.setattr(problem_rollout, "chosen_ridge", lambda problem: taken)
    monkeypatch.setattr(problem_rollout, "_refined", lambda *rest: bad)
    study = Study(problem)
    done = rollout_of(study, refine=True)
    assert done.estimate.method == study.recommendation.method
    (note,) = done.notes
    assert "not refined" in note and "diverges" in note
    assert note in titles(done) and done.to_dict()["notes"] == [note]
