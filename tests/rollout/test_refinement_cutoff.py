"""The cut-off of the torque fit from which an estimate is refined."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("mujoco")

from commanded_leg import write_leg

from consistent_id import load_problem
from consistent_id.errors import RecordingError
from consistent_id.problems.study import Study
from consistent_id.rollout import problem_rollout, refine
from consistent_id.rollout import refinement_choice as chosen
from consistent_id.rollout.chosen_settings import SettingsChoice
from consistent_id.rollout.problem_rollout import rollout_of
from consistent_id.rollout.refine import full_step, refinement_start
from consistent_id.rollout.refined_parts import PartStart, best_ridge
from consistent_id.rollout.rollout_slopes import Replays
from consistent_id.rollout.settings import Settings, torque_fit


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    folder = tmp_path_factory.mktemp("leg")
    write_leg(folder)
    return load_problem(folder)


@dataclass(frozen=True)
class Fit:
    """A fit of a cut-off; the step to its refined estimate gives its parameters."""

    cutoff: float
    parameters: float = np.nan


@pytest.mark.parametrize(
    ("more", "best", "tried"),
    [
        # Errors of blocks beyond those with 30 Hz: the same, less, more.
        ({20.0: [0.0] * 4, 15.0: [-1, 0.5, 0, 0.3], 10.0: [1] * 4}, 15.0, 4),
        ({20.0: [3.0, -1.0, -1.0, 0.5], 15.0: [9, -3, -3, 1]}, 15.0, 3),
        ({20.0: [2.0, 2.0, 2.0, 1.9], 15.0: [-1] * 4}, 30.0, 2),
        ({20.0: None, 15.0: [-1] * 4}, 30.0, 1),
    ],
    ids=["less", "within its error", "more", "diverges"],
)
def test_a_refinement_begins_at_the_lowest_cutoff_that_predicts_as_well(
    monkeypatch, more, best, tried
):
    seen = {30.0: [0.0] * 4, 10.0: None, **more}

    def squares(made, moved, logs):
        assert moved.parameters == moved.cutoff == made.cutoff
        if seen[made.cutoff] is None:
            raise RecordingError("diverges")
        return 10.0 + np.array(seen[made.cutoff])[:, None]

    def stated(problem, settings):
        return SimpleNamespace(**vars(problem) | {"cutoff": settings.cutoff})

    known = {
        "with_settings": stated,
        "within": lambda logs, spans: logs,
        "compared_fit": lambda made, logs: (Fit(made.cutoff), None),
        "full_step": lambda start, fit, rows, **steps: fit.cutoff,
        "block_squares": squares,
    }
    for name, function in known.items():
        monkeypatch.setattr(chosen, name, function)
    log = SimpleNamespace(rate=200.0)
    problem = SimpleNamespace(logs=lambda role: [log], training=[log])
    choice = chosen.RidgeChoice(0.3, {None: 2.0, 0.3: 1.0})
    starts = [PartStart((), (), None)]
    settings = Settings(cutoff=30.0)
    found = chosen._lowered(problem, settings, choice, 0.3, starts)
    assert found.cutoff == best and found.ridge == 0.3
    assert len(found.cutoffs) == tried
    assert found.cutoffs[30.0] == pytest.approx(np.sqrt(40.0))


EVEN = np.full((4, 1), 10.0)  # squared errors of the blocks of a part
SPREAD = np.array([[9.0], [-3.0], [-3.0], [1.0]])


@pytest.mark.parametrize(
    ("of_parts", "best"),
    [
        ({0.1: (EVEN - 2, EVEN - 1), 1.0: (EVEN - 1, EVEN - 1)}, 0.1),
        ({0.1: (EVEN - 5, EVEN + 1), 1.0: (EVEN - 1, EVEN - 1)}, 1.0),
        ({0.1: (EVEN - 5, EVEN + 1), 1.0: (EVEN + 1, EVEN - 5)}, None),
        ({0.1: (EVEN - 5, EVEN + SPREAD)}, 0.1),
        ({0.1: (EVEN - 1, EVEN * np.inf)}, None),
        ({0.1: (EVEN, EVEN), 1.0: (EVEN + 1, EVEN + 1)}, None),
    ],
    ids=["both", "another", "none", "within its error", "diverges", "as good"],
)
def test_a_refinement_that_loses_on_a_part_is_not_taken(of_parts, best):
    assert best_ridge({None: (EVEN, EVEN), **of_parts}) == best


def test_a_refinement_of_a_fit_that_diverges_is_taken():
    parts = {None: (EVEN, EVEN * np.inf), 0.1: (EVEN, EVEN)}
    assert best_ridge(parts) == 0.1


@pytest.mark.slow
def test_a_whole_step_from_the_start_itself_is_its_first_step(problem):
    estimate, regression = torque_fit(problem)
    logs, gains = problem.logs("training"), problem.gains
    replays = Replays.of(estimate, logs, gains)
    begin = refinement_start(replays, regression, problem.constraints, 0.0)
    goal = refine._goal(begin, begin.linear, begin.x, 0.3)
    whole = full_step(begin, estimate, regression, ridge=0.3)
    np.testing.assert_array_equal(whole, goal)
    # From another fit it ends nearly where it would with derivatives of its own.
    other = replace(estimate, parameters=1.02 * np.array(estimate.parameters))
    own = refinement_start(
        Replays.of(other, logs, gains), regression, problem.constraints, 0.0
    )
    exact = refine._goal(own, own.linear, own.x, 0.3)
    near = full_step(begin, other, regression, ridge=0.3)
    moved = np.linalg.norm((exact - own.x) / begin.changes)
    assert np.linalg.norm((near - exact) / begin.changes) < 0.1 * moved


@pytest.mark.slow
@pytest.mark.parametrize("form", [None, "isaaclab"])
def test_the_cutoff_of_a_refinement_is_that_of_the_study(problem, monkeypatch, form):
    settings, given = Settings(cutoff=15.0), []
    tried = {15.0: 2e-3, 10.0: 1.9e-3, 7.5: 2.5e-3}

    def ridge(problem, settings):
        given.append(settings)
        errors = {None: 2.5e-3, 0.3: 2e-3}
        lowered = (tried, 10.0) if settings else ({}, None)
        return chosen.RidgeChoice(0.3, errors, None, *lowered)

    choice = SettingsChoice(settings, 2.5e-3, ((settings, 2.5e-3),))
    monkeypatch.setattr(
        problem_rollout, "chosen_settings", lambda problem, refine: choice
    )
    monkeypatch.setattr(problem_rollout, "chosen_ridge", ridge)
    done = rollout_of(Study(problem), choose=True, refine=True, form=form)
    expected = 10.0 if form is None else 15.0
    assert given == [settings if form is None else None]
    assert done.settings.settings.cutoff == expected
    preparation = done.study.problem.table.data.preparation
    assert preparation.motion_cutoff == preparation.torque_cutoff == expected
    told = "\n".join(table.text() for table in done.tables())
    assert ("cut-off of 10 Hz, the lowest" in told) == (form is None)
    assert ("2.00 from 15 Hz, 1.90 from 10 Hz" in told) == (form is None)
