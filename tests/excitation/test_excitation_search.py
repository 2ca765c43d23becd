"""Searches: they improve, keep to limits and bounds, and repeat themselves."""

from dataclasses import replace

import numpy as np
import pytest
from excited import arm, arm_limits, arm_problem
from some_fast import some_fast

from consistent_id import SolverError, TorqueModel
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.guards import TorqueGuard
from consistent_id.excitation.kernels import ParameterTorque
from consistent_id.excitation.path_search import FoundPath, searched_path
from consistent_id.excitation.searches import Lanes

OBJECTIVES = ("condition", "D", "A", "E", "task")


def problem_of(joints=2, **how):
    return arm_problem(TorqueModel(arm(joints)), **how)


def searched(problem, objective="condition", number=0, *, start=None, **how):
    """The result of a search for an objective, from a random path or a given one."""
    bound = how.pop("spread_bound", np.inf)
    problem = replace(problem, objective=objective, spread_bound=bound)
    return searched_path(problem, FoundPath(number, start), **how)


def largest(problem, variables):
    """Largest share of a limit at 4001 times, for each order of derivative."""
    basis = problem.basis
    motion = basis.motion(variables, np.linspace(0.0, basis.duration, 4001), 3)
    motion[0] -= basis.limits.middle
    limits = np.array([basis.limits.derivative(order) for order in range(4)])
    return (abs(motion).max(axis=1) / limits).max(axis=1)


@pytest.mark.parametrize("seed", range(5))
def test_random_starts_use_the_same_share_of_every_joints_limits(seed):
    problem = problem_of()
    shares = problem.limits.largest(problem.random(seed))
    assert np.allclose(shares, 0.8, rtol=1e-12)
    other = problem.random(seed + 1)
    assert not np.array_equal(problem.random(seed), other)


@pytest.mark.slow
@pytest.mark.parametrize("objective", some_fast(OBJECTIVES, 2))
def test_a_search_improves_on_its_start_and_keeps_the_limits(objective):
    form = PathForm(5.0, 3)
    task = TorqueModel(arm(2)), arm_limits(arm(2))
    motion = None
    if objective == "task":
        some = arm_problem(*task, form=form)
        motion = some.basis.trajectory(some.random(9)).recording(20.0)
    problem = arm_problem(*task, form=form, aim=Aim(task=motion))
    found = searched(problem, objective, 0)
    start = problem.score(objective, problem.random(0))
    assert found.score < start - np.log(1.3)
    assert found.score == problem.score(objective, found.variables)
    assert largest(problem, found.variables).max() <= 1.0
    # Something is in its way: a path that could be larger everywhere would be.
    assert largest(problem, found.variables).max() > 0.98


def test_scaling_changes_condition_numbers_and_no_errors():
    plain, unit = (problem_of(aim=Aim(scaling=s)) for s in ("none", "unit columns"))
    variables = plain.random(0)
    for objective in ("D", "A", "E"):
        assert plain.score(objective, variables) == unit.score(objective, variables)
    W = plain.information(variables).matrix
    columns = 1.0 / np.sqrt(np.diag(W))
    expected = 0.5 * np.log(np.linalg.cond(columns[:, None] * W * columns))
    assert np.isclose(unit.score("condition", variables), expected, rtol=1e-9)
    assert plain.score("condition", variables) > unit.score("condition", variables)


@pytest.mark.slow
def test_the_same_seed_finds_the_same_path():
    first, again, other = (searched(problem_of(), "condition", s) for s in (0, 0, 1))
    assert np.array_equal(first.variables, again.variables)
    assert not np.array_equal(first.variables, other.variables)


@pytest.mark.slow
def test_a_later_stage_improves_its_objective_and_keeps_the_bound():
    problem = problem_of(joints=3)
    beyond = []
    for seed in range(3):
        first = searched(problem, "condition", seed)
        bound = first.score + np.log(1.2)
        second = searched(problem, "D", seed, start=first.variables, spread_bound=bound)
        assert second.score < problem.score("D", first.variables) - 1e-3
        assert problem.score("condition", second.variables) <= bound + 1e-6
        free = searched(problem, "D", seed, start=second.variables)
        assert free.score < second.score
        beyond.append(problem.score("condition", free.variables) > bound)
    # Without the bound a search goes on beyond it: the bound was in the way.  Not so
    # where the second stage ended in a local optimum within the bound, and which
    # optimum it finds depends on the machine's rounding.
    assert any(beyond)


def guarded(effort, members):
    model = TorqueModel(arm(2))
    guard = TorqueGuard(ParameterTorque(model, members), np.full(2, effort), 1.0)
    return arm_problem(model, guards=(guard,))


@pytest.mark.slow
def test_torque_limits_are_kept_and_are_in_the_way():
    nominal = arm(2).nominal[None]
    free = searched(problem_of(), "condition", 0)
    (measure,) = guarded(1.0, nominal).measures(free.variables)
    effort = 0.8 * (1.0 + measure.max())  # of what is used where nothing limits it
    problem = guarded(effort, nominal)
    # The best of three: one search may end where it began, which depends on rounding.
    every = [searched(problem, "condition", seed) for seed in range(3)]
    found = min(every, key=lambda one: one.score)
    (measure,) = problem.measures(found.variables)
    assert -0.05 < measure.max() <= 1e-6
    assert found.score < problem.score("condition", problem.random(0))
    assert found.score > free.score


@pytest.mark.slow
def test_the_worst_of_a_set_of_robots_counts():
    nominal = arm(2).nominal
    heavy = np.array([nominal, 1.5 * nominal])
    light = searched(problem_of(), "condition", 0)
    (measure,) = guarded(1.0, nominal[None]).measures(light.variables)
    effort = 1.01 * (1.0 + measure.max())
    problem = guarded(effort, heavy)
    (measure,) = problem.measures(light.variables)
    assert measure.max() > 0.4  # the heavy one could not play the light one's path
    both = searched(problem, "condition", 0)
    (measure,) = problem.measures(both.variables)
    assert measure.max() <= 1e-6


@pytest.mark.slow
def test_what_cannot_be_kept_is_named():
    problem = guarded(0.5, arm(2).nominal[None])
    found = searched(problem, "condition", 0)
    assert found.variables is None
    assert found.obstacle == "torque of joint 'joint2'"


def test_time_that_is_over_leaves_what_a_moment_found():
    problem = problem_of()
    (found,) = Lanes(1, interrupted=bool).run(problem, [FoundPath(0)], 0.0)
    assert np.isfinite(found.score) and not found.complete
    found = searched(problem, ended=lambda: True)
    assert np.isfinite(found.score) and not found.complete
    assert largest(problem, found.variables).max() <= 1.0


def test_searches_that_the_limit_ends_are_done_and_said_to_be_ended(capsys):
    starts = [FoundPath(number) for number in range(2)]
    lanes = Lanes(1, interrupted=bool, progress=True)
    lanes.run(problem_of(), starts, 1e-6)
    first, last = capsys.readouterr().err.splitlines()
    assert first.startswith("0/2 starts [")
    assert last.startswith("1/2 starts done (best D: ")
    assert ", 1 ended by the limit or an interrupt) [" in last


@pytest.mark.slow
def test_every_improvement_is_reported():
    reports = []
    found = searched(problem_of(), report=lambda best: reports.append(best.score))
    assert reports == sorted(reports, reverse=True)
    assert reports[-1] == found.score


@pytest.mark.slow
def test_searches_come_back_best_first():
    starts = [FoundPath(number) for number in range(3)]
    found = Lanes(1, interrupted=bool).run(problem_of(), starts, np.inf)
    scores = [one.score for one in found]
    assert scores == sorted(scores) and len(scores) == 3
    assert all(one.complete for one in found)


def test_a_start_that_violates_nothing_is_reported_before_the_solver_runs(monkeypatch):
    reports = []
    problem = problem_of()

    def broken(*_, **__):
        raise SolverError("broken")

    monkeypatch.setattr("consistent_id.excitation.path_search.minimise", broken)
    start = problem.random(0)
    with pytest.raises(SolverError):
        searched(problem, start=start, report=lambda best: reports.append(best.score))
    assert reports == [problem.score("condition", start)]


def test_problems_of_two_seeds_share_no_random_path():
    one, other = (replace(problem_of(), seed=seed) for seed in (0, 1))
    for k in range(3):
        for j in range(3):
            assert not np.allclose(one.random(k), other.random(j))


def test_curvature_along_a_step_is_that_of_the_gradients_change():
    from consistent_id.excitation.callbacks import updated_curvature

    rng = np.random.default_rng(0)
    A = rng.normal(size=(4, 4))
    H = A @ A.T + np.eye(4)  # of a quadratic function
    B = None
    for step in rng.normal(size=(6, 4)):
        B = updated_curvature(B, step, H @ step)
        assert np.linalg.eigvalsh(B).min() > 0.0
        assert np.allclose(B @ step, H @ step, rtol=1e-9)  # the secant condition


def test_a_step_of_the_size_of_rounding_leaves_the_curvature_as_it_is():
    from consistent_id.excitation.callbacks import updated_curvature

    flat = np.diag([0.0, 1.0])
    found = updated_curvature(flat, np.array([1e-17, 0.0]), np.zeros(2))
    assert np.array_equal(found, flat)
