"""Rows of slow joints, and bodies: settings that rollouts choose, and their delays."""

from dataclasses import fields, replace

import numpy as np
import pytest

pytest.importorskip("mujoco")

from commanded_leg import write_leg

from consistent_id import load_problem
from consistent_id.constraints import FixedBodies
from consistent_id.rollout import chosen_settings as choice_module
from consistent_id.rollout.candidates import Candidates
from consistent_id.rollout.chosen_settings import (
    _with_bodies,
    _without_rests,
    chosen_settings,
)
from consistent_id.rollout.delay_interval import (
    ALIKE,
    SPEEDS,
    other_frictions,
    without_rests,
)
from consistent_id.rollout.delay_search import MOST
from consistent_id.rollout.part_errors import BLOCKS_OF_PART
from consistent_id.rollout.problem_rollout import rollout_of
from consistent_id.rollout.settings import Settings, with_settings


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    folder = tmp_path_factory.mktemp("leg")
    write_leg(folder, delay=0.003)
    return load_problem(folder)


class Stated(Candidates):
    """Candidates whose error is stated."""

    def __init__(self, problem, error):
        super().__init__(problem)
        self._stated = error

    def by_joint(self, settings):
        error = self._stated(settings)
        self.tried[settings] = error
        return np.full((2 * BLOCKS_OF_PART, 1), error**2 / (2 * BLOCKS_OF_PART))


def off(settings, delay, cutoff):
    """Return a factor of an error that is least at a delay and a cut-off."""
    late = np.hypot(1.0, (settings.delay - delay) / 0.002)
    return late * (1.0 + abs(np.log(settings.cutoff / cutoff)))


@pytest.mark.slow
def test_delay_and_cutoff_are_found_again_without_rows_of_slow_joints(problem):
    def error(s):
        rests = s.least_joint_speed is None
        return 2.0 * off(s, 0.004, 5.0) if rests else off(s, 0.001, 15.0)

    candidates = Stated(problem, error)
    start = Settings(cutoff=10.0, delay=0.004)
    found = _without_rests(start, problem, candidates, MOST)
    assert found.least_joint_speed in SPEEDS
    assert found.cutoff == 15.0
    assert found.delay == pytest.approx(0.001, abs=2e-4)


@pytest.mark.slow
def test_rows_of_slow_joints_stay_where_little_is_left_without_them(problem):
    candidates = Stated(problem, lambda s: 1.0 + (s.least_joint_speed is not None))
    start = Settings()
    assert _without_rests(start, problem, candidates, MOST) == start
    assert len(candidates.tried) <= 4  # it is seen soon


def test_rows_that_the_problem_leaves_out_stay_left_out(problem):
    stated = with_settings(problem, Settings(least_joint_speed=0.3))
    candidates = Stated(stated, lambda s: 1.0 - 0.5 * (s.least_joint_speed is not None))
    assert _without_rests(Settings(), stated, candidates, MOST) == Settings()
    assert not candidates.tried
    assert without_rests(stated, Settings())
    assert not without_rests(problem, Settings())
    assert without_rests(problem, Settings(least_joint_speed=0.05))


@pytest.mark.slow
def test_settings_that_were_not_tried_without_rows_say_nothing_of_a_delay(
    problem, monkeypatch
):
    counted = []
    monkeypatch.setattr(choice_module, "_without_rests", lambda start, *_: start)
    monkeypatch.setattr(
        choice_module,
        "delay_interval",
        lambda found, others, most: counted.extend(others),
    )
    chosen_settings(problem)
    assert len(counted) == 4  # the other kinds of friction


@pytest.mark.slow
def test_the_record_has_each_setting(problem):
    from consistent_id.problems.study import Study

    done = rollout_of(Study(problem), choose=True)
    names = {"simulated": "simulated_terms_only"}
    said = 'bodies = "identified" (--bodies identified) keeps these'
    assert said not in " ".join(done.tables()[0].notes)
    own = replace(done.settings.settings, bodies="model")
    told = replace(done, settings=replace(done.settings, settings=own))
    assert said in " ".join(told.tables()[0].notes)
    recorded = done.to_dict()["settings"]
    chosen = done.settings.settings
    hidden = ("stribeck_velocity", "load_friction")  # never chosen
    for field in fields(Settings):
        if field.name not in hidden:
            assert names.get(field.name, field.name) in recorded
    assert recorded["least_joint_speed"] == chosen.least_joint_speed
    assert recorded["bodies"] == chosen.bodies


@pytest.mark.parametrize(("kept", "better"), [(0.9, True), (1.1, False)])
def test_bodies_are_the_file_s_where_these_predict_better(problem, kept, better):
    identified = with_bodies_identified(problem)
    candidates = Stated(identified, lambda s: 1.0 if s.bodies is None else kept)
    found = _with_bodies(Settings(), identified, candidates, MOST)
    assert found.bodies == ("model" if better else None)
    made = with_settings(identified, found)
    assert any(isinstance(c, FixedBodies) for c in made.constraints) == better


@pytest.mark.parametrize(
    "line", ['bodies = "model"', 'bodies = "identified"', 'masses = "free"']
)
def test_bodies_are_as_the_problem_states_them(problem, line):
    stated = with_bodies_identified(problem, line)
    candidates = Stated(stated, lambda s: 0.5 if s.bodies == "model" else 1.0)
    assert _with_bodies(Settings(), stated, candidates, MOST) == Settings()
    assert not candidates.tried


def with_bodies_identified(problem, line='masses = "datasheet"'):
    text = (problem.folder / "problem.toml").read_text()
    folder = problem.folder / "identified"
    folder.mkdir(exist_ok=True)
    for name in ("leg.xml", "log.csv"):
        (folder / name).write_bytes((problem.folder / name).read_bytes())
    other = text.replace('bodies = "model"', line)
    (folder / "problem.toml").write_text(other)
    return load_problem(folder)


def test_settings_state_the_speed_below_which_rows_are_left_out(problem):
    made = with_settings(problem, Settings(least_joint_speed=0.05))
    assert made.table.data.preparation.least_joint_speed == 0.05
    plain = with_settings(problem, Settings())
    assert plain.table.data.preparation.least_joint_speed is None
    again = with_settings(made, Settings())
    assert again.table.data.preparation.least_joint_speed == 0.05  # the problem's
    known = [log.torque_known for log in made.training]
    assert any(mask is not None and not mask.all() for mask in known)


@pytest.mark.slow
def test_delays_with_other_rows_left_out_count_if_they_predict_as_well(problem):
    settings = Settings(cutoff=15.0, delay=0.003, least_joint_speed=0.02)
    candidates = Candidates(problem)
    others = other_frictions(problem, settings, candidates)
    tried = [other for other in candidates.tried if other != settings]
    assert all(other.delay == settings.delay for other in tried)
    own = candidates.error(settings)
    as_well = [s for s in tried if candidates.error(s) <= ALIKE * own]
    assert 0 < len(others) == len(as_well) < len(tried)
    for squares, kind in zip(others, as_well, strict=True):
        assert (squares(0.004) == candidates.by_delay(kind)(0.004)).all()


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.0, 0.006])
def test_friction_at_rest_moves_no_delay_of_identified_bodies(tmp_path, delay):
    """MuJoCo's joints stick: a torque fit of all rows takes that for damping."""
    write_leg(tmp_path, delay=delay)
    (tmp_path / "identified").mkdir()
    identified = with_bodies_identified(load_problem(tmp_path))
    choice = chosen_settings(identified)
    assert choice.delay.delay == pytest.approx(delay, abs=5e-4)
    low, high = choice.delay_interval
    assert low <= delay <= high < low + 0.004


@pytest.mark.slow
def test_the_choice_is_said_and_written_with_the_problem(problem, tmp_path):
    from consistent_id.problems.study import Study

    done = rollout_of(Study(problem), choose=True)
    notes = " ".join(note for table in done.tables() for note in table.notes)
    speed = done.settings.settings.least_joint_speed
    assert ("are left out, and around reversals" in notes) == (speed is not None)
    assert done.problem.table.data.preparation.least_joint_speed == speed
