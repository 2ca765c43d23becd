"""Models with fewer parameters, and refined bodies: what a refinement confirms."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco")

from commanded_leg import PROBLEM, write_leg

from consistent_id import load_problem
from consistent_id.rollout import chosen_settings as choice_module
from consistent_id.rollout.candidates import Candidates
from consistent_id.rollout.chosen_settings import (
    _with_fewer_terms,
    _with_motors,
    chosen_settings,
)
from consistent_id.rollout.part_errors import BLOCKS_OF_PART, is_larger
from consistent_id.rollout.refine import _by_base, refined_once, refinement_start
from consistent_id.rollout.refined_parts import RIDGES, RefinedParts
from consistent_id.rollout.rollout_slopes import Replays
from consistent_id.rollout.settings import Settings, torque_fit

BLOCKS = 2 * BLOCKS_OF_PART
SPREAD = np.array([4.0, -3.0, 2.0, -1.0, 3.0, -2.0, 1.0, -3.0])
COUPLED = """
[[couplings]]
first = "hip"
second = "knee"
viscous = true
"""


def leg(folder, *changes, more=""):
    """Return the problem of a leg whose text is changed."""
    write_leg(folder, delay=0.003)
    text = PROBLEM + more
    for old, new in changes:
        text = text.replace(old, new)
    (folder / "problem.toml").write_text(text)
    return load_problem(folder)


IDENTIFIED = ('bodies = "model"', 'masses = "datasheet"')


class Stated(Candidates):
    """Candidates whose squared errors are stated."""

    def __init__(self, problem, squares):
        super().__init__(problem)
        self._stated = squares

    def by_joint(self, settings):
        found = np.broadcast_to(self._stated(settings), BLOCKS)[:, None]
        self.tried[settings] = float(np.sqrt(found.sum()))
        return found


@pytest.mark.slow
def test_a_refinement_of_bodies_takes_the_step_that_lowers_its_errors(tmp_path):
    """Derivatives by bodies that act alike are one: those by their base parameter."""
    problem = leg(tmp_path, IDENTIFIED)
    estimate, regression = torque_fit(problem)
    assert estimate.base.dependent and problem.model.layout.inertial_size
    replays = Replays.of(estimate, problem.logs("training"), problem.gains)
    start = refinement_start(replays, regression, problem.constraints, 0.003)
    size = len(start.free)
    rows = _by_base(np.eye(size), start)
    base, free = estimate.base, list(start.free)
    own = rows[:, list(base.independent)] @ base.projection
    np.testing.assert_allclose(rows, own, atol=1e-9)
    # Rows that torque could have had are kept.
    alike = np.ones((1, len(base))) @ base.projection
    kept = _by_base(alike[:, free], start)
    np.testing.assert_allclose(kept[:, free], alike[:, free], atol=1e-6)
    # The smaller the torque fit's weight, the larger the step. With each derivative in
    # its own column, in place of the base parameter's, the first leaves 48 %.
    left = []
    for ridge in RIDGES:
        moved = refined_once(start, ridge)
        errors = replays.errors(moved, 0.003) / start.level[:, None]
        left.append(np.sqrt((errors**2).mean()) / start.size)
    assert left == sorted(left) and left[0] < 0.42 and left[-1] < 0.97


@pytest.mark.slow
@pytest.mark.parametrize(("share", "taken"), [(1.01, True), (1.2, False)])
def test_motors_are_equal_unless_their_own_are_worth_it(
    tmp_path, monkeypatch, share, taken
):
    problem, pair = leg(tmp_path), (("hip", "knee"),)
    monkeypatch.setattr(choice_module, "mirrored_motors", lambda robot: pair)
    candidates = Stated(problem, lambda s: share**2 if s.equal_motors else 1.0)
    found = _with_motors(Settings(), problem, candidates)
    assert found.equal_motors == (pair if taken else None)


@pytest.mark.slow
def test_motors_are_equal_if_their_own_are_better_by_chance(tmp_path, monkeypatch):
    problem, pair = leg(tmp_path), (("hip", "knee"),)
    monkeypatch.setattr(choice_module, "mirrored_motors", lambda robot: pair)
    more = 0.1 + SPREAD / 8.0
    candidates = Stated(problem, lambda s: 1.0 + more if s.equal_motors else 1.0)
    assert _with_motors(Settings(), problem, candidates).equal_motors == pair


@pytest.mark.parametrize(
    ("coupled", "identified", "found"),
    [
        (1.0, 0.9, Settings(couplings=False)),  # gears bring nothing, bodies do
        (0.5, 1.0, Settings(bodies="model")),
        (1.0, 1.0, Settings(couplings=False, bodies="model")),
        (0.5, 0.5, Settings()),
    ],
)
def test_refined_estimates_judge_gears_and_bodies(
    tmp_path, monkeypatch, coupled, identified, found
):
    problem = leg(tmp_path, IDENTIFIED, more=COUPLED)

    def refined(made):
        error = coupled if made.model.couplings else 1.0
        error *= 1.0 if made.table.constraints.bodies == "model" else identified
        return RefinedParts({None: [np.full((BLOCKS_OF_PART, 1), error)] * 2}, ())

    monkeypatch.setattr(choice_module, "refined_parts", refined)
    # Torque fits are better with more parameters.
    candidates = Stated(
        problem, lambda s: 1.0 + 0.1 * (not s.couplings) + 0.1 * (s.bodies is not None)
    )
    assert _with_fewer_terms(Settings(), problem, candidates) == found


@pytest.mark.parametrize("line", ['bodies = "identified"', 'masses = "free"'])
def test_stated_bodies_are_not_judged(tmp_path, monkeypatch, line):
    problem = leg(tmp_path, ('bodies = "model"', line))
    monkeypatch.setattr(choice_module, "refined_parts", None)
    candidates = Stated(problem, lambda s: 1.0)
    assert _with_fewer_terms(Settings(), problem, candidates) == Settings()


def test_refined_parts_that_diverge_are_worse_than_others():
    parts = RefinedParts({None: [np.ones((BLOCKS_OF_PART, 1))]}, (), "a part diverges")
    assert parts.ridge is None and np.isinf(parts.least).all()
    assert is_larger(parts.least, np.ones((BLOCKS, 1)))
    assert not is_larger(np.ones((BLOCKS, 1)), parts.least)


def test_an_error_is_larger_if_chance_makes_it_so_in_fewer_than_one_of_20_times():
    before = np.full((BLOCKS, 1), 10.0)
    spread = (SPREAD - SPREAD.mean())[:, None]
    error = np.std(spread, ddof=1) / np.sqrt(BLOCKS)
    assert not is_larger(before + spread + 2.2 * error, before)
    assert is_larger(before + spread + 2.5 * error, before)


@pytest.mark.slow
def test_there_is_one_delay(tmp_path):
    found = chosen_settings(replace(leg(tmp_path), source=None))
    assert found.delay.delay == found.settings.delay > 0.0
    low, high = found.delay_interval
    assert low < found.settings.delay < high
