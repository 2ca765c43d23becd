"""Certificates and proofs: closed forms, wrong points, bodies and none."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment, pendulum
from robots import random_body

from consistent_id import InertialParameters, SolverError
from consistent_id.comparison import base_feasibility
from consistent_id.constraints import FixedParameters
from consistent_id.constraints.cones import certificate
from consistent_id.constraints.cones.certificate import (
    Parabola,
    ball_about,
    certify,
    solve_certified,
)
from consistent_id.constraints.cones.interior import find_interior
from consistent_id.constraints.cones.least_norm import (
    ConeSolution,
    FreeOptimum,
    LeastNorm,
    solve_half_square,
    solve_least_norm,
)
from consistent_id.constraints.cones.programmes import Multipliers
from consistent_id.constraints.cones.repeated import solve_squares
from consistent_id.constraints.cones.sets import ConicSet, SemidefiniteBlock
from consistent_id.regression import base_parameters


def _triangular(seed, size=3):
    """Nearest positive semidefinite matrix as a cone problem, with its known answer."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(size, size))
    A = A + A.T
    pairs = [(i, j) for i in range(size) for j in range(i, size)]
    basis = np.zeros((len(pairs), size, size))
    for n, (i, j) in enumerate(pairs):
        basis[n, i, j] = basis[n, j, i] = 1.0
    weight = np.array([1.0 if i == j else np.sqrt(2.0) for i, j in pairs])
    block = SemidefiniteBlock("X", basis, np.zeros((size, size)), np.ones(size))
    domain = ConicSet.semidefinite([block], len(pairs))
    target = np.array([A[i, j] for i, j in pairs])
    values, vectors = np.linalg.eigh(A)
    nearest = (vectors * np.maximum(values, 0.0)) @ vectors.T
    answer = np.array([nearest[i, j] for i, j in pairs])
    return LeastNorm(np.diag(weight), weight * target, domain), answer


def test_no_way_of_solving_is_tried_twice():
    """Tolerances as they are, and one that is finer of a problem that is magnified."""
    problem, _ = _triangular(0)
    options = {"reference": 0.5, "reach": 0.0, "gap": 1e-6}
    ways = list(certificate._ways(problem, np.zeros(6), [], **options))
    told = [tuple(sorted(way.keywords.items(), key=str)) for way in ways]
    assert len({str(one) for one in told}) == len(told)
    plain = [way.keywords for way in ways if "within" not in way.keywords]
    magnified = [k["tolerance"] for k in plain if k.get("magnified")]
    assert magnified == [certificate._FINE[0]]
    others = [k["tolerance"] for k in plain if not k.get("magnified")]
    assert others == list(certificate.TOLERANCES)


@pytest.mark.parametrize("failing", [0, 1, 3])
def test_both_magnified_squares_are_tried_whichever_ways_fail_before(failing):
    """The first of them is tried third, if there is a point by then."""
    problem, _ = _triangular(0)
    options = {"reference": 0.5, "reach": 0.0, "gap": 1e-6}
    solution, optimality = solve_certified(problem, np.zeros(6), reference=0.5)
    found, times = [], []
    for way in certificate._ways(problem, np.zeros(6), found, **options):
        times.append(getattr(way, "keywords", {}).get("times"))
        if len(times) > failing and not found:
            found.append((solution, optimality))
    squares = [n for n in times if n is not None]
    assert squares == list(certificate._MAGNIFIED)
    assert (times[2] == squares[0]) == (failing < 2)


@pytest.mark.parametrize("seed", range(10))
def test_the_nearest_semidefinite_matrix_is_the_one_with_its_negative_part_cut(seed):
    problem, answer = _triangular(seed)
    solution, optimality = solve_certified(problem, np.zeros(6), reference=0.5)
    assert optimality.verdict == "certified"
    # The objective is strongly convex, so its gap bounds the distance to the answer;
    # 1e-7 is what violation may add.
    excess = optimality.gap * max(optimality.objective, 0.5)
    distance = np.linalg.norm(problem.G @ (solution.u - answer))
    assert distance <= np.sqrt(2.0 * excess) + 1e-7


def test_a_curvature_that_is_all_but_flat_proves_what_a_flat_one_does():
    problem, answer = _triangular(0)
    exact, centre = solve_least_norm(problem), np.zeros(6)
    off = replace(exact, u=answer + 0.01)
    faint = np.eye(6)
    faint[:2, :2] = [[1e-170, 1.0], [0.0, 1e-170]]  # singular once rows are exchanged
    flat = faint.copy()
    flat[[0, 1], [0, 1]] = 0.0
    found = certify(problem, off, ball_about(centre), below=Parabola(curvature=faint))
    assert found.gap == pytest.approx(
        certify(problem, off, ball_about(centre), below=Parabola(curvature=flat)).gap
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_magnified_solution_has_the_multipliers_of_the_problem_as_it_stands(seed):
    problem, answer = _triangular(seed)
    # Of 1/2 |X - A|^2 over matrices X the multiplier is X - A: the part that is cut.
    (cut,) = solve_least_norm(problem, magnified=True).multipliers.blocks
    i, j = np.triu_indices(3)
    # A relative gap of 1e-10 leaves its root in the point, times ten for its size.
    np.testing.assert_allclose(
        cut[i, j], answer - problem.g / problem.G.diagonal(), rtol=0, atol=1e-4
    )


@pytest.mark.parametrize("seed", [0, 2])
def test_a_magnified_problem_has_more_digits_of_multipliers_of_a_small_optimum(seed):
    problem, answer = _triangular(seed)
    exact = 1e-4 * (answer - problem.g / problem.G.diagonal())
    small = replace(problem, g=problem.G @ (answer - exact))
    i, j = np.triu_indices(3)
    plain, magnified = (
        abs(solve_least_norm(small, magnified=m).multipliers.blocks[0][i, j] - exact)
        for m in (False, True)
    )
    assert magnified.max() < 0.5 * plain.max() < 0.5e-2 * abs(exact).max()
    # A target that is met has none, and no size by which to magnify.
    met = replace(problem, g=problem.G @ answer)
    found = solve_least_norm(met, magnified=True, origin=answer)
    np.testing.assert_allclose(found.u, answer, atol=1e-7)


@pytest.mark.parametrize("seed", range(5))
def test_where_a_larger_gap_is_enough_the_square_and_a_coarse_programme_are_first(
    seed, monkeypatch
):
    problem, answer = _triangular(seed)
    without_free_optimum(monkeypatch)
    ways = []

    def noted(*args, **options):
        ways.append(options["tolerance"])
        return solve_least_norm(*args, **options)

    def squared(*args):
        ways.append("square")
        return solve_squares(*args)

    monkeypatch.setattr(certificate, "solve_least_norm", noted)
    monkeypatch.setattr(certificate, "solve_squares", squared)
    solution, optimality = solve_certified(
        problem, np.zeros(6), reference=0.5, gap=1e-3
    )
    least, found = (
        float(np.sum((problem.G @ u - problem.g) ** 2)) / 2
        for u in (answer, solution.u)
    )
    assert found - least <= 1e-3 * max(least, 0.5)
    assert optimality.within(1e-3)
    assert ways == ["square"]
    ways.clear()
    monkeypatch.setattr(certificate, "solve_squares", refused)
    _, optimality = solve_certified(problem, np.zeros(6), reference=0.5, gap=1e-3)
    assert optimality.within(1e-3)
    # Coarse first; the next way, where that point is outside by more than 1e-7.
    assert ways[0] == 1e-6 and len(ways) <= 2


def refused(*args, **options):
    raise SolverError("no point")


def test_a_problem_of_many_rows_has_the_same_norms_in_few():
    problem, answer = _triangular(0)
    rng = np.random.default_rng(1)
    G, g = rng.normal(size=(40, 6)), rng.normal(size=40)
    tall = LeastNorm(G, g, problem.domain)
    small = tall.compressed()
    assert small.G.shape == (7, 6) and small.domain is tall.domain
    for u in (answer, np.zeros(6), *rng.normal(size=(5, 6))):
        norm = np.linalg.norm(G @ u - g)
        assert np.linalg.norm(small.G @ u - small.g) == pytest.approx(norm, rel=1e-13)
    assert small.compressed() is small
    assert problem.compressed() is problem
    # The same optimum, too, with multipliers that prove it for the tall problem.
    solution, _ = solve_certified(tall, np.zeros(6))
    within = ball_about(np.zeros(6))
    assert certify(tall, solution, within).verdict == "certified"


def test_a_gap_that_is_small_enough_is_not_made_smaller():
    """A direction of little curvature is better treated as flat, which takes longer."""
    problem, _ = _triangular(0)
    G = problem.G.copy()
    G[-1] *= 1e-6
    problem = replace(problem, G=G)
    near, best = (solve_least_norm(problem, tolerance=one) for one in (1e-4, 1e-10))
    within = ball_about(np.zeros(6))
    tight, loose = (
        certify(problem, near, within, enough=share).gap for share in (1e-12, 1.0)
    )
    squares = [np.sum((G @ one.u - problem.g) ** 2) for one in (near, best)]
    assert squares[0] / squares[1] - 1.0 <= tight <= 0.5 * loose


def without_free_optimum(monkeypatch):
    """Leave the problem to cone programmes, as if a block held its optimum back."""
    nothing = FreeOptimum(None, None)
    monkeypatch.setattr(certificate, "free_optimum", lambda problem, centre: nothing)


def programmes_tried(monkeypatch, share):
    """Return what is asked of a solver that knows a share of its multipliers."""
    problem, _ = _triangular(0)
    without_free_optimum(monkeypatch)
    asked = []

    def noted(problem, **options):
        solution = solve_least_norm(problem, **options)
        origin = options.get("origin")
        options["origin"] = None if origin is None else origin.tobytes()
        ball = options.pop("within", None)
        asked.append((*sorted(options.items(), key=str), ball and ball.radius))
        return replace(solution, multipliers=solution.multipliers.times(share))

    monkeypatch.setattr(certificate, "solve_least_norm", noted)
    monkeypatch.setattr(certificate, "solve_half_square", refused)
    monkeypatch.setattr(certificate, "solve_about", refused)
    _, optimality = solve_certified(problem, np.zeros(6), reference=0.5)
    assert optimality.verdict == "uncertified"
    return asked


def test_no_programme_is_solved_twice(monkeypatch):
    # Multipliers that are almost right: every way is tried for the last digits.
    asked = programmes_tried(monkeypatch, 1.0 - 1e-3)
    assert len(asked) == len(set(asked)) > 8


def test_half_the_square_proves_what_the_norm_does_not(monkeypatch):
    problem, answer = _triangular(0)
    without_free_optimum(monkeypatch)
    solve = solve_least_norm

    def inaccurate(problem, **options):
        solution = solve(problem, **options)
        return replace(solution, multipliers=solution.multipliers.times(0.999))

    monkeypatch.setattr(certificate, "solve_least_norm", inaccurate)
    solution, optimality = solve_certified(problem, np.zeros(6), reference=0.5)
    assert optimality.verdict == "certified"
    assert np.linalg.norm(problem.G @ (solution.u - answer)) < 1e-3


@pytest.mark.parametrize("times", [1e4, 1e6])
def test_half_the_square_has_the_point_and_the_multipliers_of_the_norm(times):
    problem, answer = _triangular(2)
    # An entry that is pinned, and one at its bound, are multipliers too.
    pin, at_most = np.eye(6)[[1]], np.eye(6)[[3]]
    domain = problem.domain & ConicSet.equal(pin, answer[[1]], ["pinned"])
    domain = domain & ConicSet.at_most(at_most, answer[[3]] - 0.1, ["bound"])
    problem = replace(problem, domain=domain)
    one, other = solve_least_norm(problem), solve_half_square(problem, times=times)
    # A gap of 1e-10 leaves twice its root, because the objective is strongly convex.
    assert np.linalg.norm(problem.G @ (one.u - other.u)) < 2e-5
    assert (
        certify(problem, other, ball_about(np.zeros(6)), reference=0.5).verdict
        == "certified"
    )
    for name in ("equal", "at_most"):
        ours, theirs = getattr(other.multipliers, name), getattr(one.multipliers, name)
        assert ours == pytest.approx(theirs, abs=1e-4)
    assert other.multipliers.at_most[0] > 0.01


def test_where_no_digits_help_each_ball_is_tried_once(monkeypatch):
    asked = programmes_tried(monkeypatch, 0.0)
    balls = [ball for *_, ball in asked]
    assert balls == [None, None, 10.0, 100.0]


def test_a_point_that_is_not_optimal_is_not_certified():
    problem, answer = _triangular(3)
    solution = solve_least_norm(problem)
    worse = replace(solution, u=1.01 * answer)
    gap = certify(problem, worse, ball_about(np.zeros(6))).gap
    excess = 0.5 * np.linalg.norm(problem.G @ worse.u - problem.g) ** 2
    excess -= 0.5 * np.linalg.norm(problem.G @ answer - problem.g) ** 2
    assert gap * (0.5 * np.linalg.norm(problem.G @ worse.u - problem.g) ** 2) >= excess
    assert certify(problem, worse, ball_about(np.zeros(6))).verdict == "uncertified"


def test_a_point_outside_is_not_certified():
    problem, answer = _triangular(4)
    solution = solve_least_norm(problem)
    outside = replace(solution, u=answer - 1e-3)
    assert certify(problem, outside, ball_about(np.zeros(6))).verdict == "uncertified"


@pytest.mark.parametrize("seed", range(5))
def test_base_parameters_of_a_body_are_consistent_with_a_witness(seed):
    model, truth, _ = experiment(50 + seed, samples=2)
    base = base_parameters(model)
    answer = base_feasibility(model, base, base.projection @ truth)
    assert answer.answer == "consistent"
    witness = answer.parameters
    assert np.allclose(base.projection @ witness, base.projection @ truth, atol=1e-5)
    for body in witness[:40].reshape(-1, 10):
        assert InertialParameters(body).is_consistent(tolerance=1e-7)


def test_a_value_beyond_its_bound_is_proven_impossible_by_their_distance():
    both = ConicSet.equal(np.eye(1), np.array([2.0]), ["x = 2"]) & ConicSet.at_most(
        np.eye(1), np.array([1.0]), ["x <= 1"]
    )
    # The only point is 2, whose margin to the bound is 1 - 2.
    assert find_interior(both).bound == pytest.approx(-1.0, abs=1e-6)


def test_a_pendulum_of_negative_inertia_is_proven_impossible():
    model, truth, _ = pendulum()
    base = base_parameters(model)
    values = base.projection @ truth
    values[base.names.index("link1.Izz")] = -0.1
    answer = base_feasibility(model, base, values)
    assert answer.answer == "impossible"
    assert answer.proof.bound < 0.0
    assert [v.link for v in answer.violations] == ["link1"]


def test_the_proof_of_impossibility_counts_the_same_for_every_candidate():
    model, truth, _ = pendulum()
    base = base_parameters(model)
    values = base.projection @ truth
    values[base.names.index("link1.Izz")] = -0.1
    proof = base_feasibility(model, base, values).proof
    # <Z, J> over candidates: all have these base parameters; none can make it >= 0.
    P = base.projection
    null = np.linalg.svd(P)[2][len(P) :].T
    rng = np.random.default_rng(0)
    from consistent_id.robot.inertia import pseudo_inertia
    from consistent_id.robot.scaling import link_scales

    root = link_scales(model.robot).root[0]
    for _ in range(20):
        x = base.lift(values) + null @ rng.normal(size=null.shape[1])
        J = pseudo_inertia(x[:10]) / np.outer(root, root)
        assert np.sum(proof.multipliers[0] * J) < -1e-3


def test_what_contradicts_base_parameters_is_named_beside_them_and_nothing_else():
    model, truth, _ = pendulum()
    base = base_parameters(model)
    values = base.projection @ truth
    # The mass is no base parameter and may be any; the moment h_x is one, 0.6 kg m.
    stated = FixedParameters({"link1.m": 1.0, "link1.hx": 0.9})
    answer = base_feasibility(model, base, values, constraints=[stated])
    assert answer.answer == "impossible" and not answer.violations
    assert set(answer.proof.to_blame) == {"link1.hx", "link1.hx = 0.9 kg m"}
    first, second = answer.proof.to_blame
    assert answer.summary.startswith(
        f"impossible: {first}, {second} contradict each other (proven among"
    )
    stated = FixedParameters({"link1.m": 1.0, "link1.hx": 0.6})
    agreed = base_feasibility(model, base, values, constraints=[stated])
    assert agreed.answer == "consistent"


def test_an_empty_set_is_proven_empty_and_a_full_one_is_not():
    block = SemidefiniteBlock("x", np.ones((1, 1, 1)), np.array([[-1.0]]), np.ones(1))
    low = ConicSet.at_most(np.array([[1.0]]), np.array([0.5]), ["x <= 0.5"])
    empty = ConicSet.semidefinite([block], 1) & low
    assert find_interior(empty).proves_empty
    # x >= 1 + t and x <= 0.5 - t meet at t = -0.25.
    assert find_interior(empty).margin == pytest.approx(-0.25, abs=1e-5)
    high = ConicSet.at_most(np.array([[1.0]]), np.array([2.0]), ["x <= 2"])
    assert not find_interior(ConicSet.semidefinite([block], 1) & high).proves_empty


def test_consistency_survives_a_change_of_frame():
    rng = np.random.default_rng(60)
    body = random_body(rng)
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    moved = body.transformed(Q * np.sign(np.linalg.det(Q)), rng.normal(size=3))
    assert body.is_consistent()
    assert moved.is_consistent()


@pytest.mark.slow
def test_base_parameters_of_wild_size_are_judged_too():
    model, truth, _ = experiment(70, samples=2)
    base = base_parameters(model)
    rng = np.random.default_rng(71)
    for size in (1e3, 1e6, 1e9):
        wild = size * rng.normal(size=len(base))
        assert base_feasibility(model, base, wild).answer == "impossible"
        bodily = base_feasibility(model, base, size * (base.projection @ truth))
        assert bodily.answer == "consistent"


def test_a_failing_solver_leaves_the_question_open(monkeypatch):
    model, truth, _ = experiment(72, joints=2, samples=2)

    def fails(*_args, **_options):
        raise SolverError("out of order")

    monkeypatch.setattr("consistent_id.constraints.cones.interior.solve_cones", fails)
    base = base_parameters(model)
    answer = base_feasibility(model, base, base.projection @ truth)
    assert answer.answer == "undecided"
    assert "neither" in answer.summary


@pytest.mark.parametrize("kind", ["block", "row"])
def test_slack_that_a_multiplier_pays_for_counts_into_the_gap(kind):
    # Least (u + 1)^2 / 2 over u >= 0: the optimum is 0.  At u = 0.5 the multiplier 1.5
    # explains the whole gradient, so the gap is complementarity alone: 1.5 * 0.5.
    if kind == "block":
        block = SemidefiniteBlock("u", np.ones((1, 1, 1)), np.zeros((1, 1)), np.ones(1))
        domain = ConicSet.semidefinite([block], 1)
        multipliers = Multipliers(np.zeros(0), np.zeros(0), (np.array([[1.5]]),))
    else:
        domain = ConicSet.at_most(np.array([[-1.0]]), np.zeros(1), ["u >= 0"])
        multipliers = Multipliers(np.zeros(0), np.array([1.5]), ())
    problem = LeastNorm(np.eye(1), np.array([-1.0]), domain)
    point = ConeSolution(np.array([0.5]), multipliers, "made up", 0.0, 0.0)
    optimality = certify(problem, point, ball_about(np.zeros(1)))
    assert optimality.stationarity == pytest.approx(0.0, abs=1e-15)
    assert optimality.gap * optimality.objective == pytest.approx(0.75)


def test_a_solution_that_overflows_is_not_proven_and_warns_of_nothing():
    problem, answer = _triangular(1)
    none = Multipliers(np.zeros(0), np.zeros(0), (np.zeros((3, 3)),))
    far = ConeSolution(1e200 * answer, none, "made up", 0.0, 0.0)
    found = certify(problem, far, ball_about(np.zeros(6)))
    assert found.gap == np.inf and found.verdict == "uncertified"
