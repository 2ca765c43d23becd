"""The proven gap: closed forms, singular values, and exact maxima over a ball."""

import numpy as np
import pytest
from scipy.optimize import brentq

from consistent_id.constraints.cones.certificate import (
    FEASIBILITY_TOLERANCE,
    GAP_TOLERANCE,
    Optimality,
    Parabola,
    _bound_by_qr,
    _cost_of_rest,
    _rounding,
    _rows_of,
    ball_about,
    certify,
    solve_certified,
)
from consistent_id.constraints.cones.least_norm import ConeSolution, LeastNorm
from consistent_id.constraints.cones.programmes import Multipliers
from consistent_id.constraints.cones.sets import ConicSet

SHAPES = [(1, 1), (4, 4), (9, 4), (30, 7), (3, 8)]
CONDITIONS = [1.0, 1e2, 1e4]


def matrix(rng, rows, columns, condition):
    """A matrix whose singular values go from 1 to 1 / condition."""
    size = min(rows, columns)
    U, V = (np.linalg.qr(rng.normal(size=(n, size)))[0] for n in (rows, columns))
    return U @ np.diag(np.geomspace(1.0, 1.0 / condition, size)) @ V.T


def by_singular_values(C, rest, to_centre, radius):
    """Bound with the null space as flat, from the singular value decomposition."""
    _, s, Vt = np.linalg.svd(C)
    along, flat = Vt[: len(s)] @ rest, Vt[len(s) :] @ rest
    end = radius * np.linalg.norm(flat) - flat @ (Vt[len(s) :] @ to_centre)
    return float(np.sum((along / s) ** 2) / 2 + max(end, 0.0))


def most_in_ball(C, rest, to_centre, radius):
    """Largest ``-rest.d - |C d|^2 / 2`` for steps ``d`` within `radius` of the centre.

    By the multiplier of the ball, in which the distance to the centre decreases.
    """
    H, one = C.T @ C, np.eye(len(rest))

    def step(m):
        return np.linalg.lstsq(H + m * one, m * to_centre - rest, rcond=None)[0]

    def beyond(log):
        return np.linalg.norm(step(np.exp(log)) - to_centre) - radius

    d = step(np.exp(brentq(beyond, -25.0, 25.0)) if beyond(-25.0) > 0.0 else 0.0)
    return float(-rest @ d - np.sum((C @ d) ** 2) / 2)


@pytest.mark.parametrize("condition", CONDITIONS)
@pytest.mark.parametrize("shape", SHAPES)
def test_the_bound_by_qr_is_that_by_singular_values(shape, condition):
    rng = np.random.default_rng(28)
    for _ in range(5):
        C = matrix(rng, *shape, condition)
        rest, to_centre = rng.normal(size=(2, shape[1]))
        arguments = rest, to_centre, 10.0
        found = _bound_by_qr(_rows_of(C), *arguments)
        # The error of r / s grows as the condition number does, that of squares twice.
        expected = pytest.approx(by_singular_values(C, *arguments), rel=1e-10)
        assert found == expected
        # Where the first bound is good enough it is returned as it is.
        assert _cost_of_rest(_rows_of(C), *arguments, np.inf) == expected


@pytest.mark.parametrize("condition", CONDITIONS)
@pytest.mark.parametrize("shape", SHAPES)
def test_no_point_of_the_ball_gains_more_than_the_bound(shape, condition):
    rng = np.random.default_rng(29)
    for radius in (0.1, 3.0, 1e3):
        C = matrix(rng, *shape, condition)
        rest, to_centre = rng.normal(size=(2, shape[1]))
        # The step of zero is in the ball: the point itself.
        to_centre *= 0.9 * radius / np.linalg.norm(to_centre)
        bound = _cost_of_rest(_rows_of(C), rest, to_centre, radius, 0.0)
        most = most_in_ball(C, rest, to_centre, radius)
        assert 0.0 < most <= bound * (1.0 + 1e-9)
        assert bound <= by_singular_values(C, rest, to_centre, radius) * (1 + 1e-9)


def test_directions_that_turn_beyond_the_ball_count_as_flat():
    # Along the second the parabola turns at 1e12: the ball ends the gain at 10 - 1.
    C, rest, to_centre = np.diag([1.0, 1e-6]), np.ones(2), np.array([0.0, 1.0])
    assert _cost_of_rest(C, rest, to_centre, 10.0, 0.0) == pytest.approx(0.5 + 9.0)
    # In a ball of 0.3 about the point both are: 0.3 |r|.
    assert _cost_of_rest(C, rest, np.zeros(2), 0.3, 0.0) == pytest.approx(
        0.3 * np.sqrt(2.0)
    )
    # A ball that the step leaves at once gains nothing, not less.
    wide = np.array([[1.0, 0.0]])
    far = np.array([0.0, 50.0])
    assert _bound_by_qr(wide, rest, far, 10.0) == pytest.approx(0.5)
    assert _cost_of_rest(wide, rest, far, 10.0, 0.0) == 0.0


def test_a_row_that_is_zero_takes_singular_values():
    assert _bound_by_qr(np.diag([1.0, 0.0]), np.ones(2), np.zeros(2), 10.0) == np.inf
    found = _cost_of_rest(np.diag([1.0, 0.0]), np.ones(2), np.zeros(2), 10.0, 1e9)
    assert found == pytest.approx(0.5 + 10.0)


@pytest.mark.parametrize("excess", [1e-10, 1e-3])
@pytest.mark.parametrize("equal", [0, 2])
@pytest.mark.parametrize("condition", CONDITIONS)
def test_the_gap_of_least_squares_is_what_the_point_is_worse_by(
    condition, equal, excess
):
    # Of a quadratic function the bound is sharp: nothing is lost in it.
    rng, n = np.random.default_rng(30), 6
    for _ in range(4):
        G, g = matrix(rng, 12, n, condition), rng.normal(size=12)
        A, b = rng.normal(size=(equal, n)), rng.normal(size=equal)
        domain = ConicSet.equal(A, b, [f"row {i}" for i in range(equal)])
        Q = np.linalg.svd(A)[2][equal:].T if equal else np.eye(n)
        start = np.linalg.pinv(A) @ b if equal else np.zeros(n)
        best = start + Q @ np.linalg.lstsq(G @ Q, g - G @ start, rcond=None)[0]
        least = np.sum((G @ best - g) ** 2) / 2
        # A step that costs as much in every direction.
        _, s, Vt = np.linalg.svd(G @ Q, full_matrices=False)
        away = Q @ (Vt.T @ (rng.normal(size=len(s)) / s))
        away *= np.sqrt(2 * excess * least) / np.linalg.norm(G @ away)
        none = Multipliers(np.zeros(equal), np.zeros(0), ())
        point = ConeSolution(best + away, none, "made up", 0.0, 0.0)
        proof = certify(LeastNorm(G, g, domain), point, ball_about(best))
        assert proof.objective == pytest.approx(least * (1.0 + excess), rel=1e-9)
        # Rounding leaves 1e-16 of the gradient, whose part here is 1e-5 or more.
        rounding = 1e-10 * condition
        share = excess / (1.0 + excess)
        # That of the misfit is added.
        problem = LeastNorm(G, g, domain)
        added = _rounding(problem, point.u) / proof.objective
        assert 0.0 < added < 1e-13 * condition
        assert proof.gap - added == pytest.approx(share, rel=1e-6 + rounding)


def test_the_rounding_of_a_misfit_is_less_than_its_bound():
    """Rows of integers, whose sums have no rounding error, divided by ten."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        G = rng.integers(-9, 10, (8, 6)).astype(float)
        u = rng.integers(-(10**6), 10**6, 6).astype(float)
        g = G @ u + rng.integers(-9, 10, 8)
        exact = np.sum((G @ u - g) ** 2) / 2
        tenth = LeastNorm(G / 10.0, g, ConicSet.everything(6))
        found = np.sum((tenth.G @ (10.0 * u) - g) ** 2) / 2
        assert abs(found - exact) <= _rounding(tenth, 10.0 * u)


@pytest.mark.parametrize(
    ("gap", "violation", "verdict"),
    [
        (0.99e-6, 0.99e-7, "certified"),
        (1.01e-6, 0.0, "uncertified"),
        (0.0, 1.01e-7, "uncertified"),
    ],
)
def test_a_certificate_needs_both_a_small_gap_and_a_small_violation(
    gap, violation, verdict
):
    assert Optimality(1.0, gap, violation, 0.0).verdict == verdict


def test_tolerances_themselves_are_within():
    assert (GAP_TOLERANCE, FEASIBILITY_TOLERANCE) == (1e-6, 1e-7)
    assert Optimality(1.0, 1e-6, 1e-7, 0.0).verdict == "certified"


def test_the_ball_of_a_proof_is_ten_times_one_plus_the_centre_or_what_is_wanted():
    centre = np.array([3.0, 4.0])
    assert ball_about(centre).radius == pytest.approx(60.0)
    assert ball_about(centre, 59.0).radius == pytest.approx(60.0)
    assert ball_about(centre, 61.0).radius == pytest.approx(61.0)


def test_a_point_far_from_the_centre_widens_its_ball_ten_times_its_distance():
    problem = LeastNorm(np.eye(1), np.array([30.0]), ConicSet.everything(1))
    none = Multipliers(np.zeros(0), np.zeros(0), ())
    radii = [
        certify(
            problem,
            ConeSolution(np.array([x]), none, "", 0.0, 0.0),
            ball_about(np.ones(1)),
        )
        for x in (1.5, 31.0)
    ]
    assert [r.radius for r in radii] == pytest.approx([20.0, 300.0])


def made_up(u, equal=(), at_most=()):
    multipliers = Multipliers(np.array(equal), np.array(at_most), ())
    return ConeSolution(np.array(u), multipliers, "made up", 0.0, 0.0)


@pytest.mark.parametrize("flat", [0.0, 1e-9])
def test_what_multipliers_leave_of_a_flat_direction_costs_as_far_as_the_ball_goes(flat):
    # Of x^2 / 2 over y <= 10, a multiplier of 0.5 for y that should be none: 0.5 of
    # slope is left in y, and 0.5 (10 - y) are paid for slack.
    top = ConicSet.at_most(np.array([[0.0, 1.0]]), np.array([10.0]), ["y <= 10"])
    problem = LeastNorm(np.diag([1.0, flat]), np.zeros(2), top)
    point, centre = made_up([3.0, 7.0], at_most=[0.5]), np.array([2.0, 4.0])
    proof = certify(problem, point, ball_about(centre), below=Parabola(objective=1e4))
    radius = 10.0 * (1.0 + np.sqrt(20.0))
    assert proof.radius == pytest.approx(radius)
    # y falls from 7 to the ball's end, 4 - radius.
    gap = 3.0**2 / 2 + 0.5 * (10.0 - 7.0) + 0.5 * (radius + 7.0 - 4.0)
    assert proof.gap * 1e4 == pytest.approx(gap)
    assert proof.stationarity == pytest.approx(np.hypot(3.0, 0.5))


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e6])
def test_a_better_bound_is_sought_where_the_first_is_not_small(scale):
    # In y the parabola costs m^2 / (2 s^2), 5 % of the scale; the ball of 10, 1 %.
    m = 1e-3 * scale
    s = m / np.sqrt(0.1 * scale)
    top = ConicSet.at_most(np.array([[0.0, 1.0]]), np.zeros(1), ["y <= 0"])
    problem = LeastNorm(np.diag([1.0, s]), np.zeros(2), top)
    point = made_up(np.zeros(2), at_most=[m])
    proof = certify(
        problem, point, ball_about(np.zeros(2)), below=Parabola(objective=scale)
    )
    assert proof.gap == pytest.approx(0.01)


def test_the_gap_is_that_of_the_nearest_point_on_the_equalities():
    # (x^2 + y^2) / 2 on x = 1: the optimum is (1, 0), its multiplier -1.
    domain = ConicSet.equal(np.array([[2.0, 0.0]]), np.array([2.0]), ["2 x = 2"])
    problem = LeastNorm(np.eye(2), np.zeros(2), domain)
    off = made_up([1.1, 0.2], equal=[0.0])
    proof = certify(problem, off, ball_about(np.zeros(2)))
    assert proof.objective == pytest.approx((1.0 + 0.04) / 2)
    # What leaving x = 1.1 changes, and what y = 0.2 costs.
    gap = (1.21 - 1.0) / 2 + 0.04 / 2
    assert proof.gap == pytest.approx(gap / proof.objective)


def test_a_gap_is_measured_against_the_objective_or_the_larger_reference():
    problem = LeastNorm(np.eye(2), np.zeros(2), ConicSet.everything(2))
    off = made_up([0.1, 0.0])  # 0.005 above the optimum of zero
    assert certify(problem, off, ball_about(np.zeros(2))).gap == pytest.approx(1.0)
    for reference, gap in ((0.001, 1.0), (0.5, 0.01)):
        found = certify(problem, off, ball_about(np.zeros(2)), reference=reference)
        assert found.gap == pytest.approx(gap)
    # An exact fit is optimal, whatever it is measured against.
    assert certify(problem, made_up(np.zeros(2)), ball_about(np.zeros(2))).gap == 0.0
    assert (
        certify(problem, made_up([np.nan, 0.0]), ball_about(np.zeros(2))).gap == np.inf
    )


def test_without_a_reference_a_small_objective_is_its_own():
    # The point nearest to (1, 1) * 1e-4 with x + y <= 0 is the origin: 1e-8.
    row = ConicSet.at_most(np.ones((1, 2)), np.zeros(1), ["x + y <= 0"])
    problem = LeastNorm(np.eye(2), np.full(2, 1e-4), row)
    for reference, least in ((None, 1e-8), (0.5, 0.5)):
        told = {} if reference is None else {"reference": reference}
        solution, proof = solve_certified(problem, np.zeros(2), **told)
        assert proof.verdict == "certified"
        excess = np.sum((problem.G @ solution.u - problem.g) ** 2) / 2 - 1e-8
        assert excess <= 1.01e-6 * least
        off = made_up([1e-5, -1e-5], at_most=[1e-4])
        found = certify(problem, off, ball_about(np.zeros(2)), **told)
        assert found.gap == pytest.approx(1e-10 / max(least, 1e-8 + 1e-10))
