"""Problems solved about a point, and proofs in a ball of given size."""

from dataclasses import replace

import numpy as np
import pytest

from consistent_id import SolverError
from consistent_id.constraints.cones import certificate
from consistent_id.constraints.cones.certificate import (
    FEASIBILITY_TOLERANCE,
    ball_about,
    certify,
    proven_within,
    solve_certified,
)
from consistent_id.constraints.cones.least_norm import (
    ConeSolution,
    FreeOptimum,
    LeastNorm,
)
from consistent_id.constraints.cones.local_metric import _metric, solve_about
from consistent_id.constraints.cones.programmes import Ball, Multipliers
from consistent_id.constraints.cones.sets import ConicSet, SemidefiniteBlock

ENTRIES = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]


def nearest_matrix(seed, sizes=(1.0, 1.0, 1.0)):
    """Nearest semidefinite matrix ``S X S`` to a given one, and ``X`` as it must be."""
    A = np.random.default_rng(seed).normal(size=(3, 3))
    A = A + A.T
    values, vectors = np.linalg.eigh(A)
    nearest = (vectors * np.maximum(values, 0.0)) @ vectors.T
    basis = np.zeros((6, 3, 3))
    for n, (i, j) in enumerate(ENTRIES):
        basis[n, i, j] = basis[n, j, i] = 1.0
    block = SemidefiniteBlock("X", basis, np.zeros((3, 3)), np.ones(3))
    weight = np.array([np.sqrt(1.0 + (i != j)) for i, j in ENTRIES])
    size = np.array([sizes[i] * sizes[j] for i, j in ENTRIES])
    A, nearest = (np.array([X[i, j] for i, j in ENTRIES]) for X in (A, nearest))
    domain = ConicSet.semidefinite([block], 6)
    return LeastNorm(np.diag(weight * size), weight * A, domain), nearest / size


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("sizes", [(1.0, 1.0, 1.0), (1e-2, 1.0, 10.0)])
def test_about_any_point_the_nearest_semidefinite_matrix_is_found(seed, sizes):
    problem, answer = nearest_matrix(seed, sizes)
    rng = np.random.default_rng(seed)
    ball = Ball(np.zeros(6), 10.0 * np.linalg.norm(answer))
    start = answer + 0.3 * rng.normal(size=6) / problem.G.diagonal()
    far = solve_about(problem, start, ball, scale=1.0)
    solution = solve_about(problem, far.u, ball, scale=1.0)
    # Half a square of 1e-10 beyond the least is this far away.
    assert np.linalg.norm(problem.G @ (solution.u - answer)) < np.sqrt(2e-10)
    rest = problem.G.T @ (problem.G @ solution.u - problem.g)
    (dual,) = solution.multipliers.blocks
    gradient = np.array([(1.0 + (i != j)) * dual[i, j] for i, j in ENTRIES])
    np.testing.assert_allclose(gradient, rest, atol=2e-5 * abs(problem.G).max())
    proof = certify(problem, solution, ball, reference=0.5)
    assert proof.gap < 1e-9 and proof.violation < FEASIBILITY_TOLERANCE


@pytest.mark.parametrize("times", [1.0, 1e7, 1e14])
def test_the_metric_keeps_the_digits_of_rows_far_smaller_than_others(times):
    rng = np.random.default_rng(0)
    links, misfit = rng.normal(size=(8, 6)), times * rng.normal(size=(3, 6))
    metric, (of_links, of_misfit) = _metric([links, misfit])
    np.testing.assert_allclose(links @ metric, of_links, atol=1e-13)
    rows = np.vstack([of_links, of_misfit])
    np.testing.assert_allclose(rows.T @ rows, np.eye(6), atol=1e-13)
    # Steps without misfit keep their lengths in the links' rows.
    flat = np.linalg.svd(misfit / times)[2][3:].T
    steps = np.linalg.solve(metric, flat)
    np.testing.assert_allclose(links @ flat, of_links @ steps, atol=1e-12)
    assert abs(of_misfit @ steps).max() < 1e-14 * times + 1e-12


def test_pins_bounds_and_equalities_have_the_multipliers_of_the_problem():
    problem, answer = nearest_matrix(1)
    domain = (
        problem.domain
        & ConicSet.equal(np.eye(6)[[1]], answer[[1]], ["pinned"])
        & ConicSet.equal(np.ones((1, 6)), [answer.sum()], ["sum"])
        & ConicSet.at_most(np.eye(6)[[3]], answer[[3]] - 0.1, ["bound"])
    )
    problem = replace(problem, domain=domain)
    ball = ball_about(np.zeros(6))
    solution = solve_about(problem, np.zeros(6), ball, scale=0.5)
    assert solution.u[1] == pytest.approx(answer[1], abs=1e-14)
    assert solution.multipliers.at_most[0] > 0.01
    assert abs(solution.multipliers.equal).min() > 1e-3
    assert certify(problem, solution, ball, reference=0.5).gap < 1e-9


def test_a_ball_that_holds_the_optimum_back_has_no_multiplier_and_no_gap():
    """The best of ``1 - 1e-6 u`` up to 10 is 10; further away, it is a million."""
    problem = LeastNorm(np.array([[1e-6]]), np.array([1.0]), ConicSet.everything(1))
    ball = Ball(np.zeros(1), 10.0)
    solution = solve_about(problem, np.array([3.0]), ball, scale=0.5)
    assert solution.u == pytest.approx([10.0], abs=1e-3)
    inside = certify(problem, solution, ball, reference=0.5, beyond=False)
    assert inside.radius == 10.0 and inside.gap < 1e-8
    further = certify(problem, solution, ball, reference=0.5)
    assert further.radius == pytest.approx(100.0, rel=1e-3)
    assert further.gap > 1e-4  # 1 - 1e-4 is better


def nothing(size):
    return ConeSolution(np.zeros(size), Multipliers([], [], ()), "made up", 0.0, 0.0)


def test_a_solution_that_is_proven_within_a_ball_is_kept():
    """Also one outside, as long as no point inside is better."""
    problem = LeastNorm(np.array([[1e-3]]), np.array([1.0]), ConicSet.everything(1))
    best = replace(
        nothing(1),
        u=np.array([1e3]),
        multipliers=Multipliers(np.zeros(0), np.zeros(0), ()),
    )
    ball = Ball(np.zeros(1), 10.0)
    found, proof = proven_within(problem, best, ball, start=np.zeros(1), reference=0.5)
    assert found is best
    assert proof.verdict == "certified" and proof.radius == 10.0


@pytest.mark.parametrize("seed", range(3))
def test_a_solution_that_is_not_proven_within_a_ball_is_solved_again(seed):
    problem, answer = nearest_matrix(seed, (1e-2, 1.0, 10.0))
    radius = 0.5 * float(np.linalg.norm(answer))
    ball = Ball(np.zeros(6), radius)
    made_up = Multipliers(np.zeros(0), np.zeros(0), (np.zeros((3, 3)),))
    coarse = replace(nothing(6), multipliers=made_up)
    found, proof = proven_within(
        problem, coarse, ball, start=np.zeros(6), reference=0.5
    )
    assert proof.verdict == "certified" and proof.radius == radius
    # No point of the cone in the ball is better than what the gap allows.
    rng = np.random.default_rng(seed)
    least = proof.objective - proof.gap * max(proof.objective, 0.5)
    for _ in range(300):
        X = rng.normal(size=(3, rng.integers(1, 4)))
        v = np.array([(X @ X.T)[i, j] for i, j in ENTRIES])
        v *= radius * rng.uniform() / np.linalg.norm(v)
        v += rng.uniform() * (found.u - v)  # some of them near
        assert problem.domain.violation(v) < 1e-9
        assert np.sum((problem.G @ v - problem.g) ** 2) / 2 >= least


def test_a_worse_point_is_not_proven_within_a_ball():
    problem, answer = nearest_matrix(0)
    ball = Ball(np.zeros(6), 2.0 * float(np.linalg.norm(answer)))
    solution = solve_about(problem, answer, ball, scale=0.5)
    worse = replace(solution, u=1.01 * solution.u)
    proof = certify(problem, worse, ball, reference=0.5, beyond=False)
    squares = [np.sum((problem.G @ u - problem.g) ** 2) for u in (worse.u, answer)]
    excess = (squares[0] - squares[1]) / 2
    assert proof.gap * max(proof.objective, 0.5) >= excess > 1e-6


def refused(*args, **options):
    raise SolverError("no point")


def test_where_nothing_else_proves_an_optimum_it_is_solved_about_the_best_point(
    monkeypatch,
):
    problem, answer = nearest_matrix(0)
    none = FreeOptimum(None, None)
    monkeypatch.setattr(certificate, "free_optimum", lambda problem, centre: none)
    solve = certificate.solve_least_norm

    def inaccurate(problem, **options):
        solution = solve(problem, **options)
        return replace(solution, multipliers=solution.multipliers.times(0.999))

    monkeypatch.setattr(certificate, "solve_least_norm", inaccurate)
    monkeypatch.setattr(certificate, "solve_half_square", refused)
    solution, proof = solve_certified(problem, np.zeros(6), reference=0.5)
    assert proof.verdict == "certified"
    assert np.linalg.norm(problem.G @ (solution.u - answer)) < 1e-5
    calls = []

    def noted(*args, **options):
        calls.append(args)
        refused()

    monkeypatch.setattr(certificate, "solve_about", noted)
    _, proof = solve_certified(problem, np.zeros(6), reference=0.5)
    assert proof.verdict == "uncertified"
    assert len(calls) == 2  # with each metric; it would fail again
    within = Ball(np.zeros(6), 1e-3)
    found, proof = proven_within(
        problem, solution, within, start=10.0 + answer, reference=0.5
    )
    assert found is solution


def test_multipliers_found_at_a_far_point_prove_the_nearer_one(monkeypatch):
    """Where an objective is flat, rounding leaves no proof of a point far away."""
    problem, answer = nearest_matrix(0)
    none = FreeOptimum(None, None)
    monkeypatch.setattr(certificate, "free_optimum", lambda problem, centre: none)
    solve = certificate.solve_least_norm

    def inaccurate(problem, **options):
        solution = solve(problem, **options)
        return replace(solution, multipliers=solution.multipliers.times(0.999))

    def far_away(*args, **options):
        solution = solve_about(*args, **options)
        return replace(solution, u=2.0 * solution.u)

    monkeypatch.setattr(certificate, "solve_least_norm", inaccurate)
    monkeypatch.setattr(certificate, "solve_half_square", refused)
    monkeypatch.setattr(certificate, "solve_about", far_away)
    solution, proof = solve_certified(problem, np.zeros(6), reference=0.5)
    assert proof.verdict == "certified"
    assert np.linalg.norm(problem.G @ (solution.u - answer)) < 1e-5


def test_of_points_outside_the_one_that_is_outside_least_is_the_best():
    """A gap says nothing about a point that is not feasible."""
    figures = (
        certificate.Optimality(1.0, 1e-9, 3e-5, 0.0),
        certificate.Optimality(1.0, 1e-2, 2e-6, 0.0),
    )
    far, near = ((nothing(1), figure) for figure in figures)
    assert min((far, near), key=certificate._quality) is near
    inside = nothing(1), certificate.Optimality(1.0, 0.5, 0.9e-7, 0.0)
    assert min((far, near, inside), key=certificate._quality) is inside
