"""Proof that an optimum of the form that CVXPY gives a convex problem is one.

``minimise f(y) = 1/2 y.P y + q.y  subject to  b - A y in K``.

As in `certificate`: with ``g = P y + q`` and multipliers in the dual cone, no feasible
``y'`` of a ball has less than ``f(y) + g.(y' - y)``, and `lower_bound` returns a lower
bound of ``g.y'``.
"""

import warnings
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.constraints.cones.certificate import ball_about
from consistent_id.constraints.cones.programmes import (
    ConeKind,
    ConeRows,
    lower_bound,
)
from consistent_id.constraints.cones.sets import lengths
from consistent_id.errors import InfeasibleError, SolverError

CLARABEL = {"tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10, "tol_feas": 1e-10}
"""Options of the solver."""


class ConicOptimum(NamedTuple):
    """``minimise 1/2 y.P y + q.y`` over rows, and a point with multipliers."""

    rows: tuple[ConeRows, ...] | None
    slope: Vector
    y: Vector
    duals: list[Vector]

    def gap(self) -> float:
        """Return the largest possible decrease of the objective in the ball."""
        within = ball_about(self.y)
        bound = lower_bound(self.slope, self.rows or (), self.duals, within)
        return max(float(self.slope @ self.y) - bound, 0.0)

    def violation(self) -> float:
        """Return the distance of the point from the cones."""
        return max((block.violation(self.y) for block in self.rows or ()), default=0.0)


def conic_optimum(problem: Any) -> ConicOptimum:
    """Solve by Clarabel, and assign the values of the problem's variables.

    The result has no rows if the problem needs unsupported cones.
    """
    import cvxpy as cp

    try:
        options = dict(CLARABEL)
        data, chain, inverse = problem.get_problem_data(
            cp.CLARABEL, solver_opts=options
        )
        found = chain.solve_via_data(problem, data, solver_opts=options)
        with warnings.catch_warnings():
            # "Solution may be inaccurate": the proof shows it, with figures.
            warnings.simplefilter("ignore", UserWarning)
            problem.unpack_results(found, chain, inverse)
    except (cp.error.SolverError, ValueError) as cause:
        raise SolverError(f"CVXPY found no point: {cause}") from None
    if "infeasible" in problem.status:
        raise InfeasibleError(
            "no parameters satisfy the package's constraints and your own together; "
            "loosen your own; CVXPY does not name them"
        )
    y, z = np.asarray(found.x), np.asarray(found.z)
    if problem.status not in ("optimal", "optimal_inaccurate"):
        raise SolverError(
            f"CVXPY ended {problem.status!r}; is the objective bounded from below?"
        )
    P = data.get("P")
    slope = data["c"] if P is None else data["c"] + P @ y
    rows = _cone_rows(data["A"].toarray(), data["b"], data["dims"])
    ends = np.cumsum([len(block.b) for block in rows or ()])[:-1]
    return ConicOptimum(rows, slope, y, np.split(z, ends))


def _cone_rows(A: Matrix, b: Vector, dims: Any) -> tuple[ConeRows, ...] | None:
    """Return CVXPY's rows, zero cone first; None if other cones are among them."""
    kinds: list[tuple[ConeKind, int, tuple[int, ...]]] = [
        ("zero", dims.zero, ()),
        ("nonnegative", dims.nonneg, ()),
        *(("second order", size, ()) for size in dims.soc),
        ("semidefinite", sum(lengths(dims.psd)), tuple(dims.psd)),
    ]
    ends = np.cumsum([size for _, size, _ in kinds])
    if ends[-1] != len(b):
        return None
    return tuple(
        ConeRows(kind, A[end - size : end], b[end - size : end], orders)
        for (kind, size, orders), end in zip(kinds, ends, strict=True)
    )
