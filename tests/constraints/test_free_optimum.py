"""Optima that no semidefinite block holds back: SciPy's, closed forms, the solver's."""

from dataclasses import replace
from time import perf_counter

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from consistent_id.constraints.cones import certificate, least_norm
from consistent_id.constraints.cones.certificate import (
    Parabola,
    ball_about,
    certify,
    solve_certified,
)
from consistent_id.constraints.cones.least_norm import (
    LeastNorm,
    free_optimum,
    free_set,
    solve_least_norm,
)
from consistent_id.constraints.cones.sets import ConicSet, SemidefiniteBlock, row_spaces

N = 7
ONE = np.ones((1, 1))


def below(A, b):
    return ConicSet.at_most(A, b, [f"row {i}" for i in range(len(b))])


def equal(A, b):
    return ConicSet.equal(A, b, [f"row {i}" for i in range(len(b))])


@pytest.mark.parametrize("together", [5, 0])
@pytest.mark.parametrize("seed", range(20))
def test_optima_in_a_box_are_those_of_scipy(seed, together, monkeypatch):
    # Rows change sides one at a time at last, and from the first change on.
    monkeypatch.setattr(least_norm, "_TOGETHER", together)
    rng = np.random.default_rng(seed)
    G, g = rng.normal(size=(9, N)), rng.normal(size=9)
    low, high = -rng.uniform(0.0, 0.4, N), rng.uniform(0.0, 0.4, N)
    domain = below(np.vstack([np.eye(N), -np.eye(N)]), np.append(high, -low))
    problem = LeastNorm(G, g, domain)
    found = free_optimum(problem, np.zeros(N)).solution
    truth = lsq_linear(G, g, (low, high), method="bvls", tol=1e-15).x
    np.testing.assert_allclose(found.u, truth, rtol=0, atol=1e-9)
    assert (found.u >= low).all() and (found.u <= high).all()  # not by a rounding error
    assert (found.multipliers.at_most > 0.0).sum() == (
        (truth <= low + 1e-9) | (truth >= high - 1e-9)
    ).sum()
    judged = certify(problem, found, ball_about(np.zeros(N)))
    assert judged.gap < 1e-12 and judged.violation < 1e-12


@pytest.mark.parametrize("alone", [True, False])
def test_equalities_hold_and_multipliers_prove_the_optimum(alone):
    rng = np.random.default_rng(1)
    A = np.eye(N)[[1, 4]] * [[2.0], [-3.0]] if alone else rng.normal(size=(2, N))
    domain = equal(A, np.array([0.3, 0.6])) & below(
        rng.normal(size=(6, N)), np.zeros(6)
    )
    problem = LeastNorm(rng.normal(size=(12, N)), rng.normal(size=12), domain)
    found = free_optimum(problem, np.ones(N))
    np.testing.assert_allclose(A @ found.solution.u, [0.3, 0.6], rtol=0, atol=1e-12)
    assert found.solution.multipliers.at_most.any()
    for factor in (found.triangle, None):
        judged = certify(
            problem,
            found.solution,
            ball_about(np.ones(N)),
            below=Parabola(triangle=factor),
        )
        assert judged.gap < 1e-12 and judged.violation < 1e-12
    by_cones = solve_least_norm(problem)
    np.testing.assert_allclose(found.solution.u, by_cones.u, rtol=0, atol=1e-5)
    for name in ("equal", "at_most"):  # what constraints cost is read off them
        mine, theirs = (
            getattr(one.multipliers, name) for one in (found.solution, by_cones)
        )
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-4)


def test_where_the_objective_is_flat_the_optimum_is_the_nearest_to_the_centre():
    rng = np.random.default_rng(2)
    G, g, centre = rng.normal(size=(3, N)), rng.normal(size=3), rng.normal(size=N)
    problem = LeastNorm(G, g, below(np.eye(N)[:1], np.array([100.0])))
    found = free_optimum(problem, centre).solution
    nearest = centre + np.linalg.pinv(G) @ (g - G @ centre)
    np.testing.assert_allclose(found.u, nearest, rtol=0, atol=1e-7)
    assert certify(problem, found, ball_about(centre), reference=0.5).gap < 1e-10


@pytest.mark.parametrize(("target", "free"), [(0.5, True), (-0.5, False)])
def test_an_optimum_that_a_block_holds_back_is_left_to_the_solver(target, free):
    basis = np.eye(2)[:, :, None] * np.eye(2)[:, None, :]  # diag(u) is semidefinite
    block = SemidefiniteBlock("X", basis, np.zeros((2, 2)), np.ones(2))
    domain = ConicSet.semidefinite([block], 2)
    problem = LeastNorm(np.eye(2), np.array([target, 1.0]), domain)
    assert (free_optimum(problem, np.ones(2)).solution is not None) == free
    solution, optimality = solve_certified(problem, np.ones(2), reference=0.5)
    assert (solution.status == "Free") == free
    assert (solution.build_seconds == 0.0) == free
    assert optimality.verdict == "certified"
    np.testing.assert_allclose(solution.u, [max(target, 0.0), 1.0], rtol=0, atol=1e-4)


def test_active_rows_that_say_the_same_twice_do_no_harm():
    domain = below(
        np.array([[1.0, 0.0], [1.0, 0.0], [2.0, 0.0]]), np.array([0, 0, 0.0])
    )
    problem = LeastNorm(np.eye(2), np.array([1.0, 1.0]), domain)
    solution, optimality = solve_certified(problem, np.zeros(2), reference=0.5)
    np.testing.assert_allclose(solution.u, [0.0, 1.0], rtol=0, atol=1e-6)
    assert optimality.verdict == "certified"


@pytest.mark.parametrize("seed", range(5))
def test_rows_of_one_parameter_each_have_their_pseudo_inverse_and_null_space(seed):
    rng = np.random.default_rng(seed)
    A = np.zeros((3, N))
    A[range(3), rng.permutation(N)[:3]] = rng.normal(size=3)
    found = row_spaces(A)
    np.testing.assert_allclose(found.inverse, np.linalg.pinv(A), rtol=0, atol=1e-13)
    assert found.steps.shape == (N, N - 3) and not (A @ found.steps).any()
    np.testing.assert_array_equal(found.kept, np.flatnonzero(~A.any(axis=0)))
    np.testing.assert_array_equal(found.steps.T @ found.steps, np.eye(N - 3))
    rows = rng.normal(size=(2, N))
    np.testing.assert_array_equal(found.along(rows), rows @ found.steps)


def test_two_rows_of_the_same_parameter_are_no_rows_of_one_each():
    found = row_spaces(np.array([[1.0, 0.0], [2.0, 0.0]]))
    np.testing.assert_allclose(
        found.inverse, np.linalg.pinv([[1.0, 0.0], [2.0, 0.0]]), atol=1e-15
    )
    assert found.steps.shape == (2, 1)


def test_a_large_problem_is_first_tried_without_refinement(monkeypatch):
    size, rng, refined = 210, np.random.default_rng(0), []

    def noted(*args, **options):
        refined.append(options.get("refined", True))
        return solve_least_norm(*args, **options)

    monkeypatch.setattr(certificate, "solve_least_norm", noted)
    blocks = [  # each entry is to be positive
        SemidefiniteBlock(f"u{i}", np.eye(size)[i].reshape(-1, 1, 1), 0 * ONE, ONE[0])
        for i in range(size)
    ]
    target = rng.normal(size=size)
    domain = ConicSet.semidefinite(blocks, size)
    problem = LeastNorm(np.eye(size), target, domain)
    solution, optimality = solve_certified(problem, np.ones(size), reference=0.5)
    assert refined[0] is False and optimality.verdict == "certified"
    error = solution.u - np.maximum(target, 0.0)
    # The optimum's own gap bounds the distance; 1e-7 is what violation may add.
    excess = optimality.gap * max(optimality.objective, 0.5)
    assert np.linalg.norm(error) <= np.sqrt(2.0 * excess) + 1e-7 * np.sqrt(size)


@pytest.mark.parametrize(("rows", "whole"), [(2, False), (3, True), (4, True)])
def test_a_triangle_is_returned_where_rows_are_enough_and_time_is_measured(rows, whole):
    started = perf_counter()
    rng = np.random.default_rng(rows)
    problem = LeastNorm(
        rng.normal(size=(rows, 3)), np.ones(rows), ConicSet.everything(3)
    )
    found = free_optimum(problem, np.zeros(3))
    assert (found.triangle is not None) == whole
    if whole:
        R = found.triangle
        np.testing.assert_allclose(R.T @ R, problem.G.T @ problem.G)
        assert 0.0 < found.solution.solve_seconds <= perf_counter() - started


@pytest.mark.parametrize(
    ("least", "kept"), [(0.0, False), (1e-3, False), (-1e-3, True)]
)
def test_a_block_of_pinned_parameters_alone_is_kept_only_if_it_fails(least, kept):
    pin = equal(np.array([[1.0, 0.0]]), np.array([2.0]))
    coefficients = np.zeros((2, 2, 2))
    coefficients[0] = np.diag([3.0, 0.0])
    block = SemidefiniteBlock("b", coefficients, np.diag([0.0, least]), np.ones(2))
    found = free_set(replace(pin, blocks=(block,)))
    assert found.rows[2].orders == ((2,) if least < 0.0 else ())
    assert found.start.tolist() == [2.0, 0.0]
