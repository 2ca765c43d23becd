"""Several robots play motions: the same wherever, and an interrupt keeps the first."""

import numpy as np
import pytest
from excited import arm, arm_limits

from consistent_id import TorqueModel
from consistent_id._support.executors import Executor
from consistent_id._support.run import Run, running
from consistent_id.excitation.accuracy import predicted_accuracy
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.search_problem import search_problem
from consistent_id.laboratory.rehearsal import dry_runs
from consistent_id.laboratory.rehearsal.dry_runs import (
    PredictedMotion,
    RehearsalPlan,
    played_by_all,
)
from consistent_id.laboratory.rehearsal.planted import planted_robot
from consistent_id.regression import base_parameters

pytest.importorskip("mujoco")

EFFORT = np.array([40.0, 30.0, 20.0])
NOISE = 0.005 * EFFORT


def limits():
    return arm_limits(arm(3), effort=EFFORT)


def paths():
    model, form = TorqueModel(arm(3)), PathForm(3.0, 3)
    problem = search_problem(model, base_parameters(model), form, Aim(), limits())
    return [problem.basis.trajectory(problem.random(k)) for k in range(3)]


@pytest.fixture(scope="module")
def given():
    """A plan, two motions of one path each, and two robots."""
    robots = [
        planted_robot(arm(3), limits(), np.random.default_rng(k)) for k in range(2)
    ]
    model = robots[0].model
    base = base_parameters(model)
    *played, other = paths()
    motions = {
        name: [PredictedMotion(path, predicted_accuracy(model, base, path, aim))]
        for name, path in zip(("one", "two"), played, strict=True)
        for aim in [Aim(noise=NOISE)]
    }
    return RehearsalPlan(other, limits(), NOISE, 1.0, 100.0, 0), motions, robots


@pytest.mark.slow
@pytest.mark.parametrize("name", ["processes:2", "dask:2"])
def test_robots_play_the_same_wherever(given, name):
    if name == "dask:2":
        pytest.importorskip("distributed")
    here = played_by_all(*given)
    there = played_by_all(*given, executor=Executor.named(name))
    assert list(here) == list(there) == ["one", "two"]
    for motion, robots in here.items():
        for one, other in zip(robots, there[motion], strict=True):
            np.testing.assert_array_equal(one.errors, other.errors)
            assert one.held_out == other.held_out and one.holding == other.holding
            for quantity, share in one.reached.items():
                np.testing.assert_array_equal(share, other.reached[quantity])


@pytest.mark.parametrize("before", [0, 3])
def test_an_interrupt_leaves_what_was_played(given, monkeypatch, before):
    played = []

    def rehearse(robot, *_, **__):
        if len(played) == before:
            raise KeyboardInterrupt
        played.append(robot)
        return robot

    monkeypatch.setattr(dry_runs, "rehearse", rehearse)
    with running(Run()) as run:
        if not before:
            with pytest.raises(KeyboardInterrupt):
                played_by_all(*given)
            return
        found = played_by_all(*given)
    _, _, (first, second) = given
    assert found == {"one": (first, second), "two": (first,)}
    assert run.stopped == "interrupted"
