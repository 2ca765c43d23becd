"""The estimate through CVXPY: the same optimum, own terms, and their proof."""

from types import SimpleNamespace

import cvxpy as cp
import numpy as np
import pytest
from experiments import experiment, pendulum
from some_fast import some_fast

from consistent_id import (
    FixedMasses,
    InfeasibleError,
    NonNegativeDrive,
    PhysicalConsistency,
    ProblemError,
    SolverError,
    build_regression,
    constrained_least_squares,
)
from consistent_id.constraints import Penalty, PointToSet
from consistent_id.constraints.cones.sets import matrices
from consistent_id.constraints.priors import nominal_distance
from consistent_id.estimation import cvxpy_problem, to_cvxpy
from consistent_id.estimation.cvxpy_problem import ConicOptimum, conic_optimum

CONSTRAINTS = (PhysicalConsistency(), NonNegativeDrive())
PRIORS = (
    PointToSet(),
    Penalty(0.1),
    Penalty(0.1, "euclidean"),
    Penalty(0.1, "entropic"),
)


def problem(seed, prior=None, noise=0.5):
    model, truth, log = experiment(seed, noise=noise)
    regression = build_regression(model, log)
    return to_cvxpy(model, regression, constraints=CONSTRAINTS, prior=prior), truth


@pytest.mark.slow
@pytest.mark.parametrize("prior", PRIORS)
@pytest.mark.parametrize("seed", some_fast(range(3)))
def test_the_problem_as_it_stands_is_that_of_the_constrained_estimate(seed, prior):
    form, _ = problem(seed, prior)
    source = form.source
    mine = constrained_least_squares(
        source.model, source.free.regression, constraints=CONSTRAINTS, prior=prior
    )
    theirs = form.solve()
    assert theirs.certificate.verdict == mine.certificate.verdict == "certified"
    u, v = (e.parameters / form.scaled.unit for e in (mine, theirs))
    values = []
    for point in (u, v):
        form.variable.value = point
        values.append(float(form.problem.objective.value))
    # Each is proven to 1e-6 of the objective, or of half a residual squared.
    assert values[1] == pytest.approx(values[0], abs=2e-6 * max(values[0], 0.5))


@pytest.mark.slow
@pytest.mark.parametrize("seed", some_fast(range(6), 2))
def test_another_solver_finds_the_same_constrained_optimum(seed):
    form, _ = problem(seed, Penalty(0.3))
    model, regression = form.source.model, form.source.free.regression
    mine = constrained_least_squares(
        model, regression, constraints=CONSTRAINTS, prior=Penalty(0.3)
    )
    form.problem.solve(solver=cp.SCS, eps_abs=1e-8, eps_rel=1e-8, max_iters=50_000)
    least = float(form.problem.value)
    form.variable.value = mine.parameters / form.scaled.unit
    assert float(form.problem.objective.value) == pytest.approx(least, rel=1e-5)


def test_residuals_and_links_are_what_they_are_called():
    form, truth = problem(1)
    model, regression = form.source.model, form.source.free.regression
    form.variable.value = truth / form.scaled.unit
    for j, joint in enumerate(regression.joints):
        rms = regression.residual_rms(truth)[j]
        size = np.linalg.norm(form.residuals[joint].value)
        assert size == pytest.approx(rms * np.sqrt(regression.counts[j]))
    for k, (name, J) in enumerate(form.pseudo_inertias.items()):
        assert J.value == pytest.approx(model.robot.links[k].nominal.pseudo_inertia)
        assert form.links[name].value == pytest.approx(
            truth[model.layout.link_slice(k)]
        )
    assert form.of("j2.viscous").value == pytest.approx(
        truth[model.layout.index("j2.viscous")]
    )
    total = sum(float(r.value @ r.value) for r in form.residuals.values())
    unexplained = form.scaled.residual**2
    assert 2 * form.misfit.value + unexplained == pytest.approx(
        total / form.unit_misfit**2
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", some_fast(range(3)))
def test_own_terms_and_constraints_are_solved_and_proven(seed):
    form, truth = problem(seed)
    layout = form.source.model.layout
    limit = 0.9 * truth[layout.index("j0.viscous")]
    total = sum(link[0] for link in form.links.values())
    mass = 1.1 * sum(truth[layout.link_slice(k)][0] for k in range(4))
    l1 = 0.1 * cp.norm1(form.variable - form.distance.nominal)
    estimate = form.solve(
        terms=[l1], constraints=[form.of("j0.viscous") <= limit, total == mass]
    )
    assert estimate.certificate.verdict == "certified"
    assert "CVXPY" in estimate.certificate.reason
    figures = estimate.certificate.figures
    assert figures["violation of own constraints, in their units"] < 1e-6
    assert estimate["j0.viscous"] <= limit + 1e-9
    found = sum(estimate.parameters[layout.link_slice(k)][0] for k in range(4))
    assert found == pytest.approx(mass)
    # No feasible point nearby is better: towards random others that satisfy all.
    value = float((form.problem.objective.expr + l1).value)
    rng, u = np.random.default_rng(seed), form.variable.value.copy()
    for _ in range(8):
        direction = rng.normal(size=len(u))
        other = cp.Problem(
            cp.Minimize(direction @ form.variable),
            [
                *form.problem.constraints,
                form.of("j0.viscous") <= limit,
                total == mass,
                cp.norm(form.variable - u) <= 0.1,
            ],
        )
        other.solve(solver=cp.CLARABEL)
        step = form.variable.value - u
        form.variable.value = u + 0.5 * step
        assert float((form.problem.objective.expr + l1).value) >= value - 1e-5


@pytest.mark.slow
def test_an_own_objective_is_minimised():
    form, _ = problem(0)
    norms = sum(cp.norm1(r) for r in form.residuals.values())
    estimate = form.solve(objective=norms)
    assert estimate.certificate.verdict == "certified"
    least = float(norms.value)
    ordinary = form.solve()
    assert ordinary.certificate.verdict == "certified"
    assert least < float(norms.value)


def test_a_wrong_optimum_is_not_certified(monkeypatch):
    form, _ = problem(0)
    short = {"max_iter": 4}
    monkeypatch.setattr("consistent_id.estimation.cvxpy_problem.CLARABEL", short)
    try:
        estimate = form.solve(terms=[0.1 * cp.norm1(form.variable)])
    except SolverError:
        return
    assert estimate.certificate.verdict == "uncertified"


@pytest.mark.parametrize(
    ("gap", "violation", "verdict"),
    [
        (0.9e-6, 0.9e-7, "certified"),
        (1.1e-6, 0.0, "uncertified"),
        (0.0, 1.1e-7, "uncertified"),
    ],
)
def test_an_own_optimum_is_certified_by_its_gap_and_by_its_rows(
    monkeypatch, gap, violation, verdict
):
    model, _, log = pendulum()
    form = to_cvxpy(model, build_regression(model, log), constraints=CONSTRAINTS)
    own = 10.0 + 0.1 * cp.norm1(form.variable)
    form.solve(terms=[own])
    size = float((form.misfit + form.prior + own).value)
    monkeypatch.setattr(ConicOptimum, "gap", lambda _: gap * size)
    monkeypatch.setattr(ConicOptimum, "violation", lambda _: violation)
    estimate = form.solve(terms=[own])
    assert estimate.certificate.verdict == verdict
    figures = estimate.certificate.figures
    assert figures["relative gap"] == pytest.approx(gap, abs=2e-8)
    assert figures["violation by CVXPY's rows"] == violation


@pytest.mark.slow
def test_cones_without_a_proof_are_said_to_have_none():
    form, _ = problem(0)
    estimate = form.solve(terms=[-0.1 * cp.log(form.of("j0.viscous"))])
    assert estimate.certificate.verdict == "uncertified"
    assert "no proof" in estimate.certificate.reason


def test_a_programme_without_cones_violates_none():
    x = cp.Variable(2)
    found = conic_optimum(cp.Problem(cp.Minimize(cp.sum_squares(x - [1.0, 2.0]))))
    assert x.value == pytest.approx([1.0, 2.0])
    assert found.violation() == pytest.approx(0.0, abs=1e-9)
    assert found.gap() == pytest.approx(0.0, abs=1e-7)


def test_a_datasheet_is_kept_to_the_last_digit():
    model, _, log = pendulum()
    form = to_cvxpy(
        model,
        build_regression(model, log),
        constraints=[PhysicalConsistency(), FixedMasses()],
    )
    assert form.solve()["link1.m"] == 2.0


@pytest.mark.slow
def test_what_cannot_be_is_refused():
    form, _ = problem(0)
    with pytest.raises(InfeasibleError, match="your own"):
        form.solve(constraints=[form.of("j0.viscous") <= -1.0])
    with pytest.raises(ProblemError, match="not convex"):
        form.solve(terms=[-cp.sum_squares(form.variable)])
    with pytest.raises(SolverError):
        form.solve(objective=-form.of("j0.viscous"))


@pytest.mark.parametrize("name", ["pullback", "euclidean", "entropic"])
def test_the_term_of_the_prior_is_half_of_the_squared_distance(name):
    model, truth, log = experiment(1, joints=2, noise=0.5, samples=100)
    regression = build_regression(model, log)
    form = to_cvxpy(
        model, regression, constraints=CONSTRAINTS, prior=Penalty(1.0, name)
    )
    unit = form.scaled.unit
    distance = nominal_distance(model, name, unit)
    for x in (truth, 1.3 * truth):
        form.variable.value = x / unit
        half = distance.squared(x / unit) / 2.0
        assert float(form.prior.value) == pytest.approx(half, abs=1e-9)


def test_duals_of_matrices_are_made_symmetric(monkeypatch):
    Z = np.array([[1.0, 4.0], [2.0, 5.0]])
    duals = [np.array([7.0]), np.array([8.0, 9.0]), Z]
    monkeypatch.setattr(cvxpy_problem, "set_multipliers", lambda domain, found: found)
    domain = SimpleNamespace(b_eq=np.zeros(1), b_in=np.zeros(2))
    rows = [SimpleNamespace(dual_value=dual) for dual in duals]
    equal, at_most, z = cvxpy_problem._multipliers(domain, rows)
    assert (equal.tolist(), at_most.tolist()) == ([7.0], [8.0, 9.0])
    np.testing.assert_allclose(matrices(z, [2])[0], [[1.0, 3.0], [3.0, 5.0]])
