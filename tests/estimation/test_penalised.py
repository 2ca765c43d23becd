"""Penalised fits: an independent minimiser, weak duality, invariants, convergence."""

from dataclasses import replace
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
from penalised_problems import noisy, objective
from robots import random_body
from scipy.optimize import minimize, minimize_scalar
from some_fast import some_fast

from consistent_id import (
    DriveTerms,
    InertialParameters,
    NonNegativeDrive,
    PhysicalConsistency,
    SolverError,
)
from consistent_id.constraints import Penalty
from consistent_id.constraints.cones import certified_squares
from consistent_id.constraints.cones.certificate import (
    Parabola,
    ball_about,
    certify,
    unexplained,
)
from consistent_id.constraints.cones.least_norm import solve_least_norm
from consistent_id.constraints.cones.programmes import Multipliers
from consistent_id.constraints.priors import Distance, nominal_distance
from consistent_id.estimation import penalised
from consistent_id.estimation.best_fit import (
    REFERENCE,
    FitProblem,
    scaled_fit,
)
from consistent_id.estimation.constrained_fit import constrained_fit
from consistent_id.estimation.penalised import (
    Compromise,
    penalised_fit,
    penalised_fits,
)
from consistent_id.regression.base import base_parameters
from consistent_id.robot.inertia import PSEUDO_INERTIA_BASIS, pseudo_inertia
from consistent_id.robot.log_cholesky import (
    body_from_log_cholesky,
    log_cholesky_from_body,
    log_cholesky_jacobian,
)

BODIES = (PhysicalConsistency(margin=0.0), NonNegativeDrive())


def dimensionless(model, regression, distance="entropic", constraints=BODIES):
    fit = scaled_fit(model, regression, base_parameters(model), constraints)
    return fit, nominal_distance(model, distance, fit.unit)


def J(u, fit, k):
    """The pseudo-inertia of link `k` in dimensionless parameters."""
    own = slice(10 * k, 10 * k + 10)
    return pseudo_inertia(u[own] * fit.unit[own])


def entropic_optimum_by_bfgs(model, regression, weight):
    """Minimise over log-Cholesky variables; returns parameters and objective."""
    R = regression.stacked()
    A, b = R[:, :-1], R[:, -1]
    free = np.linalg.lstsq(A, b, rcond=1e-12)[0]
    A, b = A / np.linalg.norm(A @ free - b), b / np.linalg.norm(A @ free - b)
    nominal = [link.nominal for link in model.robot.links]
    inverses = [np.linalg.inv(body.pseudo_inertia) for body in nominal]

    def cost(theta):
        theta = theta.reshape(-1, 10)
        x = body_from_log_cholesky(theta)
        rest = A @ x.ravel() - b
        value, slope = rest @ rest / 2, (A.T @ rest).reshape(-1, 10)
        for k, inverse in enumerate(inverses):
            J = pseudo_inertia(x[k])
            ratio = J @ inverse
            value += weight * (np.trace(ratio) - np.linalg.slogdet(ratio)[1] - 4.0)
            pull = inverse - np.linalg.inv(J)
            slope[k] += weight * np.tensordot(PSEUDO_INERTIA_BASIS, pull, axes=2)
        return value, np.einsum("ki,kij->kj", slope, log_cholesky_jacobian(theta))

    def flat(theta):
        value, slope = cost(theta)
        return value, slope.ravel()

    start = np.concatenate([log_cholesky_from_body(body.vector) for body in nominal])
    found = minimize(
        flat, start, jac=True, method="BFGS", options={"gtol": 1e-9, "maxiter": 5000}
    )
    return body_from_log_cholesky(found.x.reshape(-1, 10)).ravel(), found.fun


@pytest.mark.slow
@pytest.mark.parametrize("weight", [1e-2, 1.0, 100.0])
@pytest.mark.parametrize("seed", range(2))
def test_the_entropic_optimum_is_that_of_a_smooth_search_over_bodies(seed, weight):
    model, regression = noisy(seed, joints=2, drive=DriveTerms())
    fit, distance = dimensionless(model, regression, constraints=BODIES[:1])
    found = penalised_fit(fit, distance, weight)
    x, value = entropic_optimum_by_bfgs(model, regression, weight)
    assert found.optimality.verdict == "certified"
    # Both leave out or keep what no parameters explain: half the residual squared.
    mine = objective(fit, distance, weight, found.solution.u)
    assert mine == pytest.approx(value - fit.residual**2 / 2, rel=1e-6, abs=1e-9)
    assert found.solution.u == pytest.approx(x / fit.unit, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("heavy", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_the_share_of_a_long_newton_step_is_the_one_that_lowers_the_objective_most(
    seed, heavy
):
    model, regression = noisy(seed, joints=2)
    fit, distance = dimensionless(model, regression)
    rng = np.random.default_rng(seed)
    u, weight = distance.nominal.copy(), 1e6 if heavy else 1e-3
    if heavy:  # by far: Newton's step leads beyond the optimum
        u[:20] *= 3.0
    else:
        others = np.concatenate([random_body(rng).vector for _ in range(2)])
        u[:20] = others / fit.unit[:20]
    rows, problem = Compromise(fit, distance, weight).near(u)
    step = solve_least_norm(problem, origin=u).u - u
    length = np.linalg.norm(rows.G @ step)
    compromise = Compromise(fit, distance, weight)
    taken = compromise.step_share(distance.along(u, step), u, step, length)
    least = 1.0 / (1.0 + length)
    # A quarter of each eigenvalue of a body is left, at the least.
    shares = [
        np.linalg.eigvals(np.linalg.solve(J(u, fit, k), J(step, fit, k))).real.min()
        for k in range(2)
    ]
    most = max(min(1.0, -0.75 / min(shares)), least) if min(shares) < 0.0 else 1.0
    tried = np.linspace(least, most, 500)
    values = [objective(fit, distance, weight, u + t * step) for t in tried]
    assert (taken < 0.999 * most) == heavy
    assert length > 0.25 and least <= taken <= most * (1.0 + 1e-9)
    best = objective(fit, distance, weight, u + taken * step)
    assert best <= min(values) * (1.0 + 1e-12)


@pytest.mark.parametrize("seed", [2, 3, 7])
def test_the_share_is_exact_where_misfit_and_distance_are_alike(seed):
    model, regression = noisy(seed, joints=2)
    fit, distance = dimensionless(model, regression)
    u, weight = distance.nominal.copy(), 100.0
    u[:20] *= 3.0
    rows, problem = Compromise(fit, distance, weight).near(u)
    step = solve_least_norm(problem, origin=u).u - u
    length = float(np.linalg.norm(rows.G @ step))
    compromise = Compromise(fit, distance, weight)
    taken = compromise.step_share(distance.along(u, step), u, step, length)
    best = minimize_scalar(
        lambda t: objective(fit, distance, weight, u + t * step),
        bounds=(0.3, 0.75),
        method="bounded",
        options={"xatol": 1e-8},
    )
    assert best.x < 0.74
    assert taken == pytest.approx(best.x, abs=5e-5)
    # Whatever the unit of the objective.
    small = replace(fit, M=1e-4 * fit.M, z=1e-4 * fit.z)
    scaled = Compromise(small, distance, 1e-8 * weight)
    again = scaled.step_share(distance.along(u, step), u, step, length)
    assert again == pytest.approx(taken, rel=1e-8)


def test_a_step_by_which_a_body_becomes_thin_is_at_least_the_safe_one():
    """A sixth of it takes all of one eigenvalue; an eighth would leave a quarter."""
    model, regression = noisy(1, joints=2)
    fit, distance = dimensionless(model, regression)
    u, step = distance.nominal, np.zeros(len(distance.nominal))
    values, V = np.linalg.eigh(J(u, fit, 0))
    lost = -6.0 * values[0] * np.outer(V[:, 0], V[:, 0])
    own = InertialParameters.from_pseudo_inertia(lost).vector
    step[:10] = own / fit.unit[:10]
    compromise = Compromise(fit, distance, 1.0)
    taken = compromise.step_share(distance.along(u, step), u, step, 6.0)
    assert taken == pytest.approx(1.0 / 7.0, rel=1e-12)


def test_without_constraints_a_quadratic_distance_has_the_normal_equations_answer():
    model, regression = noisy(3, joints=3)
    fit, distance = dimensionless(model, regression, "pullback", constraints=())
    G, g = distance.local(distance.nominal)
    expected = np.linalg.solve(
        fit.M.T @ fit.M + 0.5 * G.T @ G, fit.M.T @ fit.z + 0.5 * G.T @ g
    )
    found = penalised_fit(fit, distance, 0.5)
    assert found.optimality.verdict == "certified"
    assert found.solution.u == pytest.approx(expected, abs=1e-5)


def like_one_another(seed=2):
    """A fit on the boundary of its constraints, and fits to similar data."""
    model, regression = noisy(seed, 2, noise=0.3)
    fit, distance = dimensionless(model, regression, "pullback")
    like = penalised_fit(fit, distance, 1e-3)
    rng = np.random.default_rng(seed)
    moves = 0.3 * rng.normal(size=(5, len(fit.z)))
    return [replace(fit, z=fit.z + move) for move in moves], distance, like


def together(fits, distance, like):
    cases = [(fit, like.weight) for fit in fits]
    return penalised_fits(cases, distance, start=like.solution.u)


def test_fits_solved_together_are_those_solved_alone():
    fits, distance, like = like_one_another()
    assert like.solution.status != "Free"
    found = together(fits, distance, like)
    for fit, one in zip(fits, found, strict=True):
        alone = penalised_fit(fit, distance, like.weight)
        assert one.optimality.verdict == "certified"
        assert one.weight == like.weight
        costs = [
            objective(fit, distance, like.weight, f.solution.u) for f in (one, alone)
        ]
        assert costs[0] == pytest.approx(costs[1], rel=1e-6)
        np.testing.assert_allclose(one.solution.u, alone.solution.u, atol=2e-3)
        assert one.squared_distance == distance.squared(one.solution.u)
        assert one.excess == fit.excess(one.solution.u)


def test_fits_that_need_no_cones_are_free():
    fits, distance, like = like_one_another()
    near = [replace(fit, z=fit.M @ distance.nominal) for fit in fits]
    for one in together(near, distance, like):
        assert one.solution.status == "Free"
        assert one.optimality.verdict == "certified"


def test_a_fit_that_is_not_certified_together_is_solved_again_alone(monkeypatch):
    fits, distance, like = like_one_another(3)
    solve = certified_squares.solve_squares

    def moved(problems, origin):
        found = solve(problems, origin)
        return [replace(found[0], u=found[0].u + 1e-3), *found[1:]]

    monkeypatch.setattr(certified_squares, "solve_squares", moved)
    found = together(fits, distance, like)
    alone = [penalised_fit(fit, distance, like.weight) for fit in fits]
    same = [
        np.array_equal(f.solution.u, a.solution.u)
        for f, a in zip(found, alone, strict=True)
    ]
    assert same == [True, *([False] * (len(fits) - 1))]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pullback", "entropic"])
def test_fits_that_cannot_be_solved_together_are_solved_alone_or_are_none(
    monkeypatch, kind
):
    fits, distance, like = like_one_another()
    if kind == "entropic":
        model, regression = noisy(2, 2, noise=0.3)
        _, distance = dimensionless(model, regression, kind)

    def refused(*_):
        raise SolverError("together")

    monkeypatch.setattr(certified_squares, "solve_squares", refused)
    alone = [
        penalised_fit(fit, distance, like.weight, start=like.solution.u) for fit in fits
    ]
    solve, calls = penalised.Compromise.optimum, iter(range(len(fits)))

    def sometimes(self, start=None, **options):
        if next(calls) == 3:
            raise SolverError("alone")
        return solve(self, start, **options)

    monkeypatch.setattr(penalised.Compromise, "optimum", sometimes)
    found = together(fits, distance, like)
    assert found.pop(3) is None
    del alone[3]
    for one, other in zip(found, alone, strict=True):
        np.testing.assert_array_equal(one.solution.u, other.solution.u)


@pytest.mark.slow
@pytest.mark.parametrize("distance", get_args(Distance))
def test_a_firmer_belief_brings_the_robot_nearer_and_costs_fit(distance):
    model, regression = noisy(4, joints=3)
    fit, to_nominal = dimensionless(model, regression, distance)
    path = [penalised_fit(fit, to_nominal, w) for w in 10.0 ** np.arange(2, -7, -2)]
    # Up to what a relative gap of 1e-6 leaves open.
    assert (np.diff([f.squared_distance for f in path]) >= -1e-4).all()
    assert (np.diff([f.excess for f in path]) <= 1e-4).all()


def test_the_gap_of_the_distance_is_the_objectives_over_half_the_weight():
    model, regression = noisy(1, joints=2)
    found = penalised_fit(*dimensionless(model, regression), 4.0)
    # Half of (misfit + 4 distance): with the misfit the same, 0.3 of it is 0.15.
    loose = replace(found, optimality=replace(found.optimality, objective=3.0, gap=0.1))
    assert loose.distance_gap == pytest.approx(0.15)
    small = replace(found, optimality=replace(found.optimality, objective=0.0, gap=0.1))
    assert small.distance_gap == pytest.approx(0.05 * REFERENCE)


@pytest.mark.parametrize("seed", some_fast(range(10), 4))
def test_the_gap_bounds_what_any_point_is_worse_than_the_best(seed):
    rng = np.random.default_rng(seed)
    model, regression = noisy(seed, joints=2)
    fit, distance = dimensionless(model, regression)
    weight = 10.0 ** rng.uniform(-3, 1)
    best = penalised_fit(fit, distance, weight)
    least = objective(fit, distance, weight, best.solution.u)
    others = [random_body(rng).vector for _ in range(2)]
    other = np.append(np.concatenate(others), rng.uniform(0, 2, 6)) / fit.unit
    duals = best.solution.multipliers
    blocks = tuple(Z + 1e-3 * rng.uniform() * np.eye(4) for Z in duals.blocks)
    coarse = Multipliers(duals.equal, duals.at_most * rng.uniform(0.5, 2), blocks)
    for share in (1e-6, 1e-3, 0.1, 1.0):
        u = (1 - share) * best.solution.u + share * other
        excess = objective(fit, distance, weight, u) - least
        for multipliers in (duals, coarse):
            wrong = replace(best.solution, u=u, multipliers=multipliers)
            judged = Compromise(fit, distance, weight).certified(wrong)
            assert judged.objective == pytest.approx(
                objective(fit, distance, weight, u), rel=1e-9
            )
            gap = judged.gap * max(judged.objective, REFERENCE)
            assert gap >= excess * (1 - 1e-6) - 1e-9
            if excess > 1e-5 * max(judged.objective, REFERENCE):
                assert judged.verdict == "uncertified"


def test_a_point_that_is_no_body_is_not_certified_and_no_proof_is_asked_for():
    model, regression = noisy(5, joints=2)
    fit, distance = dimensionless(model, regression)
    solution = penalised_fit(fit, distance, 1.0).solution
    outside = replace(solution, u=-solution.u)
    assert Compromise(fit, distance, 1.0).certified(outside).verdict == "uncertified"
    for known in (solution, outside):
        assert Compromise(fit, distance, 1.0).proven(known)[0] is known


@pytest.mark.slow
@pytest.mark.parametrize("length", [0.8, 1.2])
def test_of_a_rest_as_long_as_half_the_weight_the_distances_curvature_is_no_proof(
    length,
):
    model, regression = noisy(8, joints=3)
    fit, distance = dimensionless(model, regression)
    weight = 1e-3
    solution = penalised_fit(fit, distance, weight).solution
    u = solution.u
    rows, problem = Compromise(fit, distance, weight).near(u)
    E = fit.domain.equalities.steps
    root = np.linalg.pinv(rows.G @ E, rcond=1e-14).T  # of the Hessian's inverse

    def shares_of_half_the_weight(duals):
        rest, _ = unexplained(problem, u, duals)
        return np.linalg.norm(root @ (E.T @ rest)) / (weight / 2)

    tenth = shares_of_half_the_weight(solution.multipliers.times(0.9))
    duals = solution.multipliers.times(1.0 - 0.1 * length / tenth)
    assert shares_of_half_the_weight(duals) == pytest.approx(length, rel=0.05)
    steep = length > 1.0
    half = np.vstack([fit.M, np.sqrt(weight / 2) * rows.G])
    found = replace(solution, multipliers=duals)
    expected = certify(
        problem,
        found,
        ball_about(distance.nominal),
        reference=REFERENCE,
        below=Parabola(
            objective=objective(fit, distance, weight, u),
            curvature=fit.M if steep else half,
        ),
    )
    assert Compromise(fit, distance, weight).certified(found) == expected


@pytest.mark.slow
def test_multipliers_too_coarse_for_a_proof_are_asked_for_again():
    model, regression = noisy(8, joints=3)
    fit, distance = dimensionless(model, regression)
    solution = penalised_fit(fit, distance, 1e-3).solution
    coarse = replace(solution, multipliers=solution.multipliers.times(0.9))
    assert Compromise(fit, distance, 1e-3).certified(coarse).verdict == "uncertified"
    again, optimality = Compromise(fit, distance, 1e-3).proven(coarse)
    assert optimality.verdict == "certified"
    assert again.u == pytest.approx(solution.u, abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joints", "seed", "weight"), [(7, 0, 1.0), (7, 2, 1e-6), (9, 1, 1e-2)]
)
def test_newton_converges_on_long_robots_and_every_link_is_strictly_a_body(
    joints, seed, weight
):
    model, regression = noisy(seed, joints)
    fit, distance = dimensionless(model, regression)
    found = penalised_fit(fit, distance, weight)
    assert found.optimality.verdict == "certified"
    links = (found.solution.u * fit.unit)[: 10 * joints].reshape(-1, 10)
    for body in map(InertialParameters, links):
        values = np.linalg.eigvalsh(body.pseudo_inertia)
        assert values[0] > 1e-9 * values[-1]


@pytest.mark.parametrize("weight", [1e-3, 1.0])
def test_what_a_compromise_gives_away_is_stated_as_misfit_above_the_best(weight):
    model, regression = noisy(6, joints=2)
    problem = FitProblem.of(model, regression, BODIES, base_parameters(model))
    found = constrained_fit(problem, Penalty(weight))
    R = regression.stacked()

    def misfit(u):
        return np.linalg.norm(R @ np.append(u * found.best.scaled.unit, -1.0))

    u, best = found.final.solution.u, found.best.solution.u
    given = misfit(u) / misfit(best) - 1.0
    assert 1e-3 < given == pytest.approx(found.slack, rel=1e-4)


@pytest.mark.slow
def test_where_newton_starts_does_not_matter():
    model, regression = noisy(6, joints=3)
    fit, distance = dimensionless(model, regression)
    rng = np.random.default_rng(6)
    bodies = np.concatenate([random_body(rng).vector for _ in range(3)])
    start = np.append(bodies, np.ones(9)) / fit.unit
    here = penalised_fit(fit, distance, 0.1)
    there = penalised_fit(fit, distance, 0.1, start=start)
    assert there.solution.u == pytest.approx(here.solution.u, abs=1e-5)


@pytest.mark.parametrize(
    ("lengths", "steps"),
    [
        # Idle steps are longer than half the shortest so far, which is below 1e-4.
        ([1e-3, 5e-5, 4e-5, 1e-5, 9e-6, 8e-6, 1e-8], 6),
        ([1e-3, 1.1e-4, 1e-4, 9e-5, 4e-5, 3e-5, 2.5e-5, 1e-8], 7),
        ([1e-2, 1e-4, 2e-7, 0.9e-7, 1e-8], 4),
    ],
)
def test_newton_ends_with_a_tiny_step_or_two_idle_ones(monkeypatch, lengths, steps):
    asked = []

    def longer(_, origin):
        asked.append(lengths[len(asked)])
        return SimpleNamespace(u=origin + asked[-1])

    monkeypatch.setattr(penalised, "solve_least_norm", longer)
    problem = SimpleNamespace(near=lambda _: (SimpleNamespace(G=np.eye(1)), None))
    distance = SimpleNamespace(squared=lambda _: 1.0, nominal=np.zeros(1))
    found = Compromise._newton(problem, distance, np.zeros(1))
    assert len(asked) == steps
    assert found.u == pytest.approx(sum(asked))
