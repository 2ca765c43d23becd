"""Sets without the parameters that equalities pin, against the whole sets."""

import numpy as np
import pytest

from consistent_id import SolverError
from consistent_id.constraints.cones.certificate import ball_about, certify
from consistent_id.constraints.cones.least_norm import (
    LeastNorm,
    free_set,
    solve_least_norm,
)
from consistent_id.constraints.cones.repeated import minimisers
from consistent_id.constraints.cones.sets import ConicSet, SemidefiniteBlock, smat


def _two_matrices(seed, pins):
    """Two matrices X, Y >= 0, tr X + tr Y <= 3; some entries are equal to numbers."""
    basis = np.array([smat(e) for e in np.eye(6)])
    none = np.zeros_like(basis)
    blocks = [
        SemidefiniteBlock(name, np.vstack(parts), np.zeros((3, 3)), np.ones(3))
        for name, parts in (("X", (basis, none)), ("Y", (none, basis)))
    ]
    traces = np.tile(np.trace(basis, axis1=1, axis2=2), 2)
    rows = np.eye(12)[list(pins)] * 0.5
    values = 0.5 * np.array(list(pins.values()))
    domain = (
        ConicSet.semidefinite(blocks, 12)
        & ConicSet.at_most(traces[None], np.array([3.0]), ["traces"])
        & ConicSet.equal(rows, values, list(map(str, pins)))
    )
    G, g = np.random.default_rng(seed).normal(size=(2, 15, 12))
    return LeastNorm(G, g[:, 0], domain)


IDENTITY = dict(zip(range(6, 12), (0.5, 0.0, 0.5, 0.0, 0.0, 0.5), strict=True))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("pins", [{0: 0.4}, {0: 0.4, 4: 0.1, 5: 0.7}, IDENTITY])
def test_an_optimum_with_pinned_parameters_is_certified_for_the_whole_set(seed, pins):
    problem = _two_matrices(seed, pins)
    solution = solve_least_norm(problem)
    np.testing.assert_allclose(solution.u[list(pins)], list(pins.values()), atol=1e-15)
    optimality = certify(problem, solution, ball_about(np.zeros(12)))
    assert optimality.verdict == "certified"
    # What pins cost is the derivative of the optimum by their values.
    (first, value), step = next(iter(pins.items())), 1e-3
    ends = []
    for moved in (value - step, value + step):
        other = _two_matrices(seed, {**pins, first: moved})
        u = solve_least_norm(other).u
        ends.append(np.sum((other.G @ u - other.g) ** 2) / 2)
    slope = (ends[1] - ends[0]) / (2 * step)
    # Half the parameter is equal to half the value; the multiplier is less the slope.
    assert -0.5 * solution.multipliers.equal[0] == pytest.approx(slope, abs=1e-2)


def test_a_matrix_of_pinned_entries_is_left_out():
    found = free_set(_two_matrices(0, IDENTITY).domain)
    assert found.free.sum() == 6
    assert found.rows[2].orders == (3,)
    assert len(found.rows[0].b) == 0


def test_a_pinned_matrix_that_is_not_positive_is_a_contradiction():
    problem = _two_matrices(0, {**IDENTITY, 6: -0.5})
    with pytest.raises(SolverError, match="Infeasible"):
        solve_least_norm(problem)


@pytest.mark.parametrize(("second", "agrees"), [(0.4, True), (0.6, False)])
def test_a_parameter_pinned_twice_needs_one_value(second, agrees):
    problem = _two_matrices(1, {0: 0.4})
    again = ConicSet.equal(np.eye(12)[:1], np.array([second]), ["again"])
    twice = LeastNorm(problem.G, problem.g, problem.domain & again)
    if agrees:
        expected = solve_least_norm(problem).u
        np.testing.assert_allclose(solve_least_norm(twice).u, expected, atol=1e-8)
    else:
        with pytest.raises(SolverError, match="Infeasible"):
            solve_least_norm(twice)


def test_squares_over_a_set_with_pins_have_the_optimum_of_the_norm():
    problem = _two_matrices(2, {0: 0.4, 7: 0.2})
    P, q = problem.G.T @ problem.G, -problem.G.T @ problem.g
    (found,) = minimisers(P[None], q[None], problem.domain)
    expected = solve_least_norm(problem).u
    np.testing.assert_allclose(found, expected, atol=1e-4)
    np.testing.assert_array_equal(found[[0, 7]], [0.4, 0.2])
