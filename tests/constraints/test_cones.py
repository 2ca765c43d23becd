"""The solver's own form, its fallbacks, and a second formulation and solver."""

from dataclasses import replace
from time import perf_counter
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from second_solver import FORMULATIONS, solve_anew

from consistent_id import ProblemError, SolverError
from consistent_id.constraints.cones.certificate import (
    ball_about,
    certify,
    solve_certified,
)
from consistent_id.constraints.cones.least_norm import (
    LeastNorm,
    solve_least_norm,
)
from consistent_id.constraints.cones.programmes import (
    Ball,
    ConeRows,
    lower_bound,
    point_of,
    set_rows,
    solve_cones,
)
from consistent_id.constraints.cones.repeated import (
    minimisers,
    rough_squares,
    solve_costs,
)
from consistent_id.constraints.cones.sets import (
    ConicSet,
    SemidefiniteBlock,
    least_eigenvalues,
    matrices,
    positive_part,
    smat,
    stacked,
    svec,
)


@pytest.mark.slow
@settings(deadline=None)
@given(st.lists(st.integers(1, 5), max_size=6), st.integers(0, 2**31))
def test_matrices_of_unlike_orders_go_and_come_back_and_are_treated_one_by_one(
    orders, seed
):
    rng = np.random.default_rng(seed)
    given = [(A + A.T) / 2 for A in (rng.normal(size=(k, k)) for k in orders)]
    z = stacked(given)
    for A, again in zip(given, matrices(z, orders), strict=True):
        assert np.allclose(again, A, rtol=0, atol=1e-14)
    nearest = matrices(positive_part(z, orders), orders)
    least = least_eigenvalues(z, orders)
    for A, near, value in zip(given, nearest, least, strict=True):
        values, vectors = np.linalg.eigh(A)
        assert value == pytest.approx(values[0], abs=1e-12)
        expected = vectors @ np.diag(np.maximum(values, 0.0)) @ vectors.T
        assert np.allclose(near, expected, rtol=0, atol=1e-12)


def _projection(seed, size=4):
    """Nearest matrix to a random one with X >= 0, trace X = 1 and X_00 <= 0.1."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(size, size))
    basis = np.array([smat(e) for e in np.eye(size * (size + 1) // 2)])
    block = SemidefiniteBlock("X", basis, np.zeros((size, size)), np.ones(size))
    trace = np.trace(basis, axis1=1, axis2=2)
    width = len(basis)
    domain = (
        ConicSet.semidefinite([block], width)
        & ConicSet.equal(trace[None], np.ones(1), ["trace"])
        & ConicSet.at_most(basis[:, 0, 0][None], np.array([0.1]), ["X_00"])
    )
    return LeastNorm(np.eye(width), svec(A + A.T), domain)


@given(st.integers(1, 6), st.integers(0, 2**31))
def test_stacking_keeps_inner_products_and_can_be_undone(size, seed):
    A, B = np.random.default_rng(seed).normal(size=(2, size, size))
    A, B = A + A.T, B + B.T
    assert svec(A) @ svec(B) == pytest.approx(np.sum(A * B))
    assert np.allclose(smat(svec(A)), A, atol=1e-14)


def test_a_linear_programme_has_its_known_answer_and_multipliers():
    # Least -x - 2y over x + y <= 1, x >= 0, y >= 0: y = 1, multiplier 2 of the sum.
    A = np.array([[1.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    rows = [ConeRows("nonnegative", A, np.array([1.0, 0.0, 0.0]))]
    point = solve_cones(np.array([-1.0, -2.0]), rows, tolerance=1e-10)
    assert point.x == pytest.approx([0.0, 1.0], abs=1e-8)
    assert point.duals[0] == pytest.approx([2.0, 1.0, 0.0], abs=1e-8)


def test_what_has_no_solution_gives_no_point():
    A = np.array([[1.0], [-1.0]])
    rows = [ConeRows("nonnegative", A, np.array([0.0, -1.0]))]
    with pytest.raises(SolverError, match="Infeasible"):
        solve_cones(np.zeros(1), rows)


def test_numbers_that_are_none_are_a_solver_error():
    rows = [ConeRows("nonnegative", np.array([[np.nan]]), np.zeros(1))]
    with pytest.raises(SolverError):
        solve_cones(np.ones(1), rows)
    assert solve_costs([np.ones(1)], rows, tolerance=1e-8) == [None]


def test_several_costs_are_each_solved_as_if_alone_also_after_one_without_a_point():
    A = np.array([[1.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    disc = np.vstack([np.zeros(2), -np.eye(2)])
    rows = [
        ConeRows("nonnegative", A, np.array([1.0, 0.0, 0.0])),
        ConeRows("second order", disc, np.array([0.9, 0.0, 0.0])),
    ]
    costs = [np.array(cost) for cost in ((-1.0, -2.0), (1.0, -2.0), (-2.0, 1.0))]
    for k, point in enumerate(solve_costs(costs, rows, tolerance=1e-8)):
        alone = solve_cones(costs[k], rows, tolerance=1e-8)
        np.testing.assert_allclose(point.x, alone.x, rtol=0, atol=1e-9)
        for own, others in zip(point.duals, alone.duals, strict=True):
            np.testing.assert_allclose(own, others, rtol=0, atol=1e-9)
        assert point.build_seconds > 0.0 < point.solve_seconds
    half_plane = [ConeRows("nonnegative", A[1:2], np.zeros(1))]  # x >= 0
    endless, least = np.array([-1.0, 0.0]), np.array([1.0, 0.0])
    lost, found = solve_costs([endless, least], half_plane, tolerance=1e-8)
    assert lost is None
    assert found.x[0] == pytest.approx(0.0, abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("seed", range(4))
def test_another_formulation_and_another_solver_agree(seed, formulation):
    problem = _projection(seed)
    mine = solve_least_norm(problem)
    theirs = solve_anew(problem, formulation)
    # A strongly convex objective: both are within the root of their gaps.
    scale = max(certify(problem, mine, ball_about(np.zeros(10))).objective, 0.5)
    within = [
        np.sqrt(
            2.0
            * scale
            * certify(problem, s, ball_about(np.zeros(10)), reference=0.5).gap
        )
        for s in (mine, theirs)
    ]
    assert np.linalg.norm(theirs.u - mine.u) <= sum(within) + 1e-7
    for solution in (mine, theirs):
        rest = problem.G.T @ (problem.G @ solution.u - problem.g)
        multipliers = solution.multipliers
        rest = rest + problem.domain.A_eq.T @ multipliers.equal
        rest = rest + problem.domain.A_in.T @ multipliers.at_most
        (block,) = problem.domain.blocks
        rest -= np.tensordot(block.coefficients, multipliers.blocks[0], axes=2)
        assert np.linalg.norm(rest) < 1e-4
    assert certify(problem, theirs, ball_about(np.zeros(10)), reference=0.5).gap < 1e-6


def test_programmes_over_one_set_are_each_solved_as_if_alone():
    rng = np.random.default_rng(5)
    domain = _projection(0).domain
    G, g = rng.normal(size=(6, 15, 10)), rng.normal(size=(6, 15))
    P, q = G.transpose(0, 2, 1) @ G, -np.einsum("krc,kr->kc", G, g)
    found = minimisers(P, q, domain)
    for k, u in enumerate(found):
        alone = solve_least_norm(LeastNorm(G[k], g[k], domain)).u
        costs = [0.5 * v @ P[k] @ v + q[k] @ v for v in (u, alone)]
        gap = 1e-8 * max(1.0, abs(costs[1]))  # asked of the solver
        assert costs[0] == pytest.approx(costs[1], rel=0, abs=3.0 * gap)
        within = np.sqrt(2.0 * 4.0 * gap / np.linalg.eigvalsh(P[k])[0])
        assert np.linalg.norm(u - alone) < within
        assert domain.violation(u) < 1e-7


@pytest.mark.parametrize("entry", [np.nan, np.inf])
def test_quadratic_programmes_are_of_finite_numbers(entry):
    domain, P = _projection(0).domain, np.eye(10)[None].copy()
    P[0, 1, 2] = P[0, 2, 1] = entry
    with pytest.raises(SolverError, match="finite"):
        minimisers(P, np.ones((1, 10)), domain)


@pytest.mark.parametrize("unit", (0.1, 1.0, 10.0))
def test_rough_squares_are_within_a_hundredth(unit):
    problem, rng = _projection(3), np.random.default_rng(0)
    origin = solve_least_norm(problem).u
    changes = np.array([0.0, 0.1, 1.0, 10.0, 0.1])[:, None]
    targets = problem.g + changes * rng.normal(size=(5, len(problem.g)))
    found = rough_squares(problem.G, targets, problem.domain, origin, unit=unit)
    for square, g in zip(found, targets, strict=True):
        u = solve_least_norm(replace(problem, g=g), origin=origin).u
        least = np.sum((problem.G @ u - g) ** 2)
        assert abs(square - least) <= 0.01 * max(unit, least)


def test_rough_squares_are_as_exact_from_far_away():
    problem, rng = _projection(3), np.random.default_rng(0)
    u = solve_least_norm(problem).u
    targets = problem.G @ u + 0.1 * rng.normal(size=(3, len(problem.g)))
    far = u + 10.0 * rng.normal(size=len(u))
    found = rough_squares(problem.G, targets, problem.domain, far, unit=0.1)
    for square, g in zip(found, targets, strict=True):
        nearest = solve_least_norm(replace(problem, g=g), origin=u).u
        least = np.sum((problem.G @ nearest - g) ** 2)
        assert abs(square - least) <= 0.01 * max(0.1, least)


def test_squares_that_are_enough_only_bound_the_least_ones():
    problem, rng = _projection(3), np.random.default_rng(0)
    origin = solve_least_norm(problem).u
    targets = problem.g + rng.normal(size=(12, len(problem.g)))
    least = np.array(
        [
            np.sum((problem.G @ solve_least_norm(replace(problem, g=g)).u - g) ** 2)
            for g in targets
        ]
    )
    enough = float(np.median(least))
    found = rough_squares(
        problem.G, targets, problem.domain, origin, unit=1.0, enough=enough
    )
    error = 0.01 * np.maximum(1.0, least)
    assert (found >= least - error).all()
    assert (found[least > enough] <= (least + error)[least > enough]).all()
    assert (found[least <= enough - error] <= enough).all()
    assert (found > least + error).any()  # so it takes less time


def test_where_no_square_is_found_there_is_none():
    A = np.array([[1.0], [-1.0]])
    empty = ConicSet.at_most(A, np.array([0.0, -1.0]), ["low", "high"])
    found = rough_squares(np.eye(1), np.ones((3, 1)), empty, np.zeros(1), unit=1.0)
    assert np.isnan(found).all()


def test_a_set_without_a_point_has_no_minimiser():
    A = np.array([[1.0], [-1.0]])
    empty = ConicSet.at_most(A, np.array([0.0, -1.0]), ["low", "high"])
    with pytest.raises(SolverError, match="Infeasible"):
        minimisers(np.ones((1, 1, 1)), np.zeros((1, 1)), empty)


def test_the_next_way_is_taken_when_one_fails(monkeypatch):
    ways = []

    def fails_at_first(*arguments, **options):
        ways.append(options)
        if len(ways) < 5:
            raise SolverError("out of order")
        return solve_least_norm(*arguments, **options)

    monkeypatch.setattr(
        "consistent_id.constraints.cones.certificate.solve_least_norm", fails_at_first
    )
    problem = _projection(7)
    solution, optimality = solve_certified(problem, np.zeros(10), reference=0.5)
    assert optimality.verdict == "certified"
    assert len(ways) == 5
    # Within the roots of both gaps, which are 1e-10 or less.
    assert solution.u == pytest.approx(solve_least_norm(problem).u, abs=3e-5)


def test_when_nothing_works_each_failure_is_told_once(monkeypatch):
    def fails(*_args, **_options):
        raise SolverError("out of order")

    monkeypatch.setattr(
        "consistent_id.constraints.cones.certificate.solve_least_norm", fails
    )
    with pytest.raises(SolverError, match=r"^out of order$"):
        solve_certified(_projection(7), np.zeros(10))


@pytest.mark.parametrize("seed", range(6))
def test_the_origin_and_a_wide_ball_do_not_change_the_answer(seed):
    problem = _projection(seed)
    plain = solve_least_norm(problem)
    moved = solve_least_norm(
        problem, origin=np.full(10, 3.0), within=Ball(np.ones(10), 100.0)
    )
    # A gap of 1e-10 leaves a strongly convex problem's point open by its root, and the
    # multipliers by that and by the gradient that they leave unexplained.
    proofs = [
        certify(problem, s, ball_about(np.zeros(10)), reference=0.5)
        for s in (plain, moved)
    ]
    within = sum(np.sqrt(2.0 * max(p.objective, 0.5) * p.gap) for p in proofs)
    unexplained = sum(p.stationarity for p in proofs)
    assert within + unexplained < 1e-3
    assert np.linalg.norm(moved.u - plain.u) <= within + 1e-7
    for name in ("equal", "at_most"):
        mine, theirs = (getattr(s.multipliers, name) for s in (moved, plain))
        assert mine == pytest.approx(theirs, abs=within + unexplained)


def test_a_narrow_ball_is_kept_to():
    # Nearest to 5 within 2 of the origin, where nothing else holds it.
    problem = LeastNorm(np.eye(1), np.array([5.0]), ConicSet.everything(1))
    inside = solve_least_norm(problem, within=Ball(np.zeros(1), 2.0))
    assert inside.u == pytest.approx([2.0], abs=1e-6)


def test_rows_on_one_parameter_hold_to_the_last_digit():
    A = np.array([[0.0, 2.0], [1.0, 1.0]])
    low = ConicSet.at_most(-np.eye(2)[:1], np.zeros(1), ["x >= 0"])
    domain = ConicSet.equal(A, np.array([3.0, 4.0]), ["2 y = 3", "sum"]) & low
    assert domain.snapped(np.array([-1e-12, 1.5 + 1e-12])).tolist() == [0.0, 1.5]
    assert domain.snapped(np.array([0.3, 1.5])).tolist() == [0.3, 1.5]


@pytest.mark.slow
@settings(deadline=None)  # the first solve imports the solver
@given(st.integers(0, 2**31), st.sampled_from([0.0, 1e-6, 0.1, 10.0]))
def test_a_lower_bound_is_below_every_feasible_point_whatever_the_multipliers(
    seed, disturbance
):
    rng = np.random.default_rng(seed)
    domain = _projection(seed % 5).domain
    ball = Ball(0.3 * rng.normal(size=10), 5.0)
    rows = [*set_rows(domain), ball.rows()]
    cost = rng.normal(size=10)
    point = solve_cones(cost, rows)
    duals = [z + disturbance * rng.normal(size=len(z)) for z in point.duals]
    bound = lower_bound(cost, rows, duals, ball)
    if disturbance == 0.0:
        assert bound == pytest.approx(cost @ point.x, abs=1e-5)
    for _ in range(20):
        # Of trace one and X_00 at most 0.1, as the set demands.
        root = rng.normal(size=(4, 4)) * [0.01, 1, 1, 1]
        X = root.T @ root / np.sum(root**2)
        assert domain.violation(svec(X)) < 1e-12
        assert np.linalg.norm(svec(X) - ball.centre) < ball.radius
        assert bound <= cost @ svec(X) + 1e-12


def test_equalities_take_up_what_other_multipliers_leave():
    # On x + y = 1 alone, x + y is 1; the ball has no say in it.
    rows = [ConeRows("zero", np.array([[1.0, 1.0]]), np.ones(1))]
    bound = lower_bound(np.ones(2), rows, [np.array([7.0])], Ball(np.zeros(2), 1e6))
    assert bound == pytest.approx(1.0, abs=1e-8)


def test_any_multipliers_give_a_lower_bound_of_a_cone_programme():
    """``min c.x`` over a ball is ``c.m - r ||c||``; few multipliers are in the cone."""
    rng = np.random.default_rng(0)
    for _ in range(100):
        centre, cost = rng.normal(size=(2, 3))
        inner = Ball(centre, 0.5)
        far = Ball(centre, 0.6)
        bound = lower_bound(cost, [inner.rows()], [rng.normal(size=4)], far)
        assert bound <= cost @ centre - 0.5 * np.linalg.norm(cost) + 1e-12
    exact = np.append(0.5 * np.linalg.norm(cost), 0.5 * cost)
    bound = lower_bound(cost, [inner.rows()], [exact], far)
    assert bound == pytest.approx(cost @ centre - 0.5 * np.linalg.norm(cost), abs=1e-12)


def test_stacks_of_stacks_of_matrices_are_stacked_matrix_by_matrix():
    A = np.random.default_rng(0).normal(size=(2, 5, 3, 3))
    A = A + np.swapaxes(A, -1, -2)
    found = svec(A)
    assert found.shape == (2, 5, 6)
    assert found[1, 4].tolist() == svec(A[1, 4]).tolist()
    np.testing.assert_allclose(smat(found), A, atol=1e-14)


def test_margins_of_blocks_are_eigenvalues_in_units_of_their_scales():
    """``diag(x, 9 - x)`` with scales 2 and 3: x / 4 and (9 - x) / 9."""
    coefficients = np.array([np.diag([1.0, -1.0])])
    block = SemidefiniteBlock("b", coefficients, np.diag([0.0, 9.0]), [2.0, 3.0])
    domain = ConicSet.semidefinite([block], 1)
    for x, least in ((1.0, 0.25), (8.0, 1.0 / 9.0), (-4.0, -1.0)):
        point = np.array([x])
        assert domain.block_rows.margins(point) == pytest.approx([least])
        assert np.linalg.eigvalsh(block.scaled(point))[0] == pytest.approx(least)
        assert domain.violation(point) == pytest.approx(max(-least, 0.0))


@pytest.mark.parametrize(
    ("status", "x", "z"),
    [
        ("Solved", [np.nan], [1.0]),
        ("Solved", [1.0], [np.inf]),
        ("PrimalInfeasible", [1.0], [1.0]),
        ("AlmostDualInfeasible", [1.0], [1.0]),
    ],
)
def test_a_solution_without_a_point_is_refused(status, x, z):
    with pytest.raises(SolverError, match=f"ended '{status}' without a point"):
        point_of(SimpleNamespace(status=status, x=x, z=z))
    fine = SimpleNamespace(status="AlmostSolved", x=[2.0], z=[1.0])
    assert point_of(fine).tolist() == [2.0]


def test_a_solver_that_diverged_has_no_point():
    """The square of its misfit would overflow."""
    found = SimpleNamespace(status="InsufficientProgress", x=[1.0, -3e140], z=[1.0])
    with pytest.raises(SolverError, match=r"numbers of 3\.0e\+140.*it diverged"):
        point_of(found)


@pytest.mark.parametrize(("A", "b"), [(np.nan, 1.0), (1.0, np.inf)])
@pytest.mark.parametrize("equal", [True, False])
def test_a_row_that_is_not_of_finite_numbers_is_refused_by_its_name(A, b, equal):
    bad = np.array([[1.0, 2.0], [A, 0.0]]), np.array([3.0, b]), ("fine", "bad")
    none = np.zeros((0, 2)), np.zeros(0), ()
    with pytest.raises(ProblemError, match="'bad' is not of finite numbers"):
        ConicSet(*(bad if equal else none), *(none if equal else bad))


def test_a_set_in_larger_units_is_violated_by_as_much_less():
    """By points for which a row, an equality or a block is the worst."""
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(2, 3)), rng.normal(size=2)
    F = rng.normal(size=(4, 2, 2))
    F += np.swapaxes(F, 1, 2)
    block = SemidefiniteBlock("F", F[:3], F[3], np.ones(2))
    domain = ConicSet.equal(A[:1], b[:1], ["e"]) & ConicSet.at_most(A[1:], b[1:], ["i"])
    domain &= ConicSet.semidefinite([block], 3)
    for x in rng.normal(size=(20, 3)):
        expected = domain.violation(x) / 40.0
        assert domain.shrunk(40.0).violation(x / 40.0) == pytest.approx(expected)
        assert domain.moved(x).violation(np.zeros(3)) == pytest.approx(40.0 * expected)


def test_the_box_of_a_set_is_kept_as_it_is():
    rows = np.diag([2.0, -4.0, -1.0]), np.array([1.0, 8.0, 0.0])
    box = ConicSet.at_most(*rows, ["a", "b", "c"]).box
    low, high = "[-inf, -2.0, 0.0]", "[0.5, inf, inf]"  # and no minus zero
    assert [str(end.tolist()) for end in box] == [low, high]
    assert not any(end.flags.writeable for end in box)


def test_a_point_of_a_second_order_cone_is_as_long_as_its_first_number():
    """3 and 4 are 5 long: 2 too much for 3, none for 5."""
    rows = ConeRows("second order", -np.eye(3), np.zeros(3))
    found = [rows.violation(np.array([t, 3.0, -4.0])) for t in (3.0, 5.0, 6.0)]
    assert found == [2.0, 0.0, 0.0]


def test_a_row_of_zeros_stays_one_where_rows_are_made_of_unit_size():
    A = np.array([[0.0, 0.0], [3.0, 4.0]])
    units = ConicSet.at_most(A, np.array([2.0, 10.0]), ["a", "b"]).normalised(
        np.ones(2)
    )
    np.testing.assert_allclose(units.A_in, [[0.0, 0.0], [0.6, 0.8]])
    np.testing.assert_allclose(units.b_in, [2.0, 2.0])


def test_the_time_of_a_programme_is_that_of_its_parts():
    started = perf_counter()
    point = solve_cones(np.ones(2), [Ball(np.zeros(2), 1.0).rows()])
    whole = perf_counter() - started
    assert point.x == pytest.approx([-np.sqrt(0.5)] * 2, abs=1e-6)
    assert 0.0 < point.build_seconds < whole
    assert 0.0 < point.solve_seconds < whole
    assert point.build_seconds + point.solve_seconds < whole


@pytest.mark.parametrize("order", [1, 2, 9, 40])
def test_a_stacked_matrix_has_the_order_that_its_length_says(order):
    F = np.random.default_rng(order).normal(size=(3, order, order))
    F = F + np.swapaxes(F, -1, -2)
    np.testing.assert_allclose(smat(svec(F)), F)
