"""Stribeck velocities between those that a selection tries."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_select import kinds, selected

from consistent_id.problems.selection import fading as module
from consistent_id.problems.selection.choice import STRIBECK, STRIBECK_PASSED
from consistent_id.problems.selection.fading import (
    lowest,
    with_closer_velocities,
    with_velocities,
)
from consistent_id.problems.selection.fits import HeldOut
from consistent_id.problems.selection.forward_search import State


@given(
    st.floats(-0.9, 0.9),
    st.floats(0.1, 10.0),
    st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=9, unique=True),
)
def test_the_lowest_place_of_a_parabola_is_exact(centre, bend, places):
    x = np.sort(places)
    y = bend * (x - centre) ** 2 + 3.0
    k = int(np.argmin(y))
    if k in (0, len(x) - 1):
        assert lowest(x, y) == x[k]
    elif min(np.diff(x)[[k - 1, k]]) > 1e-3:
        assert lowest(x, y) == pytest.approx(centre, abs=1e-6)


def test_a_place_is_never_outside_its_neighbours():
    x = np.array([0.0, 1.0, 2.0, 3.0])
    assert 1.0 <= lowest(x, np.array([9.0, 8.0, 7.0, 7.0])) <= 3.0
    assert lowest(x, np.array([1.0, 1.0, 1.0, 1.0])) == 0.0
    assert lowest(np.array([0.0, 1.0, 1.0]), np.array([2.0, 1.0, 1.0])) == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("velocity", [0.07, 0.28])
def test_a_velocity_between_those_tried_is_found(tmp_path, velocity):
    chosen = selected(tmp_path, stribeck_velocity=velocity)
    drive = chosen.choice.drive
    ratios = [v / drive[0].velocity_scale for v in STRIBECK]
    for joint in drive:
        assert joint.stribeck_velocity == pytest.approx(velocity, rel=0.1)
        assert joint.stribeck_velocity not in ratios
    last = chosen.steps[-1].move
    assert last.kind == "stribeck_value"
    assert last.label.endswith(f"of shoulder, {drive[1].stribeck_velocity:g} of elbow")
    assert "stribeck_velocity" in kinds(chosen)
    table = chosen.table_of_problem
    own = {
        name: j.over(table.drive).stribeck_velocity for name, j in table.joints.items()
    }
    stated = [own.get(n, table.drive.stribeck_velocity) for n in ("shoulder", "elbow")]
    assert stated == [d.stribeck_velocity for d in drive]


@pytest.fixture
def fading(begun):
    """A state whose joints have Stribeck terms, with an evaluator that knows them."""
    top = begun.evaluator.samples(begun.plain.choice.motion_cutoff).top_speeds
    choice = with_velocities(begun.plain.choice, [0, 1], (0.4 * top).tolist())
    evaluator = begun.evaluator.with_fading(tuple((0.4 * top).tolist()))
    return evaluator, State(evaluator.evaluated(choice)), top


def test_no_velocity_is_tried_that_a_joint_hardly_passes(fading, monkeypatch):
    evaluator, state, top = fading
    tried = []
    own = module._own_squares
    monkeypatch.setattr(
        module, "_own_squares", lambda *given: tried.append(given[-1]) or own(*given)
    )
    with_closer_velocities(evaluator, state)
    assert tried and all((each <= top / STRIBECK_PASSED).all() for each in tried)
    assert tried[0].max(axis=0) == pytest.approx(top / STRIBECK_PASSED)


def test_velocities_that_predict_worse_are_not_taken(fading, monkeypatch):
    evaluator, state, _ = fading
    now = state.current
    worse = HeldOut(1.01 * now.errors.squares)
    for errors in (worse, now.errors):
        after = replace(now, errors=errors)
        monkeypatch.setattr(module, "_closer", lambda *_, after=after: (None, after))
        assert with_closer_velocities(evaluator, state) == (evaluator, state)
