"""Linear programmes over products of cones, handed to Clarabel in its own form.

``minimise c.x  subject to  b_i - A_i x in K_i``

with ``K_i`` the zero cone, the non-negative orthant, a second-order cone, or symmetric
positive semidefinite matrices.  The matrices are small and are built for each solve,
which costs a tenth of the solver's time.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, Literal

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.run import Terminated
from consistent_id._support.singular import lstsq
from consistent_id.constraints.cones.sets import (
    ConicSet,
    least_eigenvalues,
    matrices,
    positive_part,
    stacked,
)
from consistent_id.errors import SolverError

ConeKind = Literal["zero", "nonnegative", "second order", "semidefinite"]

_ITERATIONS = 100  # ten to thirty are usual; more are spent along flat directions
_DIVERGED = 1e50
"""Numbers, typically near one, beyond which a solver has diverged: they hold no digit
of any other number, and squares of what they lead to overflow.
"""

COARSE = 1e-6
"""Tolerance from which Clarabel's linear systems are not refined: refinement takes a
quarter of its time, and does not change the digits of such a tolerance.
"""


@dataclass(frozen=True, slots=True, eq=False)
class ConeRows:
    """Rows ``b - A x`` that lie in one cone, or in several semidefinite ones.

    The latter are stacked matrices of the given orders.
    """

    kind: ConeKind
    A: Matrix
    b: Vector
    orders: tuple[int, ...] = ()

    def violation(self, x: Vector) -> float:
        """Return the distance of the rows from their cone at a point."""
        rest = self.b - self.A @ x
        if self.kind == "semidefinite":
            rest = least_eigenvalues(rest, self.orders)
        elif self.kind == "second order":
            rest = np.array([rest[0] - np.linalg.norm(rest[1:])])
        outside = abs(rest) if self.kind == "zero" else -rest
        return float(outside.max(initial=0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Multipliers:
    """Dual values of a set's constraints.

    Signs: at the minimum of ``f`` over the set,
    ``grad f + A_eq^T equal + A_in^T at_most - sum F*(blocks) = 0``.
    """

    equal: Vector
    at_most: Vector
    blocks: tuple[Matrix, ...]

    def times(self, size: float) -> "Multipliers":
        """Return the multipliers of ``size f``."""
        blocks = tuple(size * Z for Z in self.blocks)
        return Multipliers(size * self.equal, size * self.at_most, blocks)


@dataclass(frozen=True, slots=True, eq=False)
class Ball:
    """``||x - centre|| <= radius``."""

    centre: Vector
    radius: float

    def moved(self, origin: Vector) -> "Ball":
        """Rewrite the ball for ``x - origin``."""
        return Ball(self.centre - origin, self.radius)

    def rows(self, others: int = 0) -> ConeRows:
        """Return its rows, for variables ``(others, x)``."""
        size = len(self.centre)
        A = np.zeros((1 + size, others + size))
        A[1:, others:] = -np.eye(size) / self.radius
        return ConeRows("second order", A, np.append(1.0, -self.centre / self.radius))


@dataclass(frozen=True, slots=True, eq=False)
class ConePoint:
    """Clarabel's result: a point, a dual vector for each of the rows, the status."""

    x: Vector
    duals: tuple[Vector, ...]
    status: str
    build_seconds: float
    solve_seconds: float


def solve_cones(
    cost: Vector,
    rows: Sequence[ConeRows],
    *,
    tolerance: float = 1e-8,
    refined: bool = True,
    curvature: Vector | None = None,
) -> ConePoint:
    """Solve the programme once, with the given tolerance on gap and feasibility.

    With a curvature ``p``, ``1/2 sum_i p_i x_i^2`` is added to the cost.

    Without refinement (`refined`), linear systems take two thirds of the time, but are
    too inaccurate for a fine tolerance in hard programmes.

    Raises
    ------
    SolverError
        If Clarabel fails, or returns no finite point with multipliers.  A doubtful
        point is returned, because certificates check it.
    """
    import clarabel
    from scipy.sparse import csc_matrix, diags_array

    started = perf_counter()
    size = len(cost)
    quadratic, data = csc_matrix((size, size)), cone_data(rows)
    if curvature is not None:
        quadratic = csc_matrix(diags_array(curvature))
    chosen = settings(tolerance, refined=refined and tolerance < COARSE)
    with panics_as_errors():
        solver = clarabel.DefaultSolver(quadratic, cost, *data, chosen)
        solved_from = perf_counter()
        solution = solver.solve()
    return cone_point(solution, rows, solved_from - started, solved_from)


def cone_point(
    solution: Any, rows: Sequence[ConeRows], build_seconds: float, solved_from: float
) -> ConePoint:
    """Return a solution that took as long to set up, and was solved from then on."""
    ends = np.cumsum([len(block.b) for block in rows])[:-1]
    return ConePoint(
        point_of(solution),
        tuple(np.split(np.asarray(solution.z), ends)),
        str(solution.status),
        build_seconds,
        perf_counter() - solved_from,
    )


def settings(tolerance: float, *, refined: bool) -> Any:
    """Return Clarabel's settings; whether it refines solutions of linear systems."""
    import clarabel

    chosen = clarabel.DefaultSettings()
    chosen.verbose = False
    chosen.max_iter = _ITERATIONS
    chosen.tol_gap_abs = chosen.tol_gap_rel = chosen.tol_feas = tolerance
    chosen.iterative_refinement_enable = refined
    return chosen


@contextmanager
def panics_as_errors() -> Iterator[None]:
    """Turn Clarabel's exceptions into a `SolverError`."""
    try:
        yield
    # Clarabel is written in Rust: its panics are not of class Exception.
    except BaseException as cause:
        if isinstance(cause, KeyboardInterrupt | SystemExit | Terminated):
            raise
        raise SolverError(f"Clarabel failed: {cause}") from None


def point_of(solution: Any) -> Vector:
    """Return the point of Clarabel's solution.

    Raises
    ------
    SolverError
        If there is none, or if it diverged.
    """
    x, z = np.asarray(solution.x), np.asarray(solution.z)
    status = str(solution.status)
    # For an infeasible programme, x and z are a ray, not a point.
    ray = status.endswith("Infeasible")
    if ray or not (np.isfinite(x).all() and np.isfinite(z).all()):
        raise SolverError(f"Clarabel ended {status!r} without a point")
    size = float(abs(x).max(initial=0.0))
    if size > _DIVERGED:
        raise SolverError(
            f"Clarabel ended {status!r} at numbers of {size:.1e}, expected at most "
            f"{_DIVERGED:.0e}: it diverged; check the sizes of torque and model"
        )
    return x


def cone_data(rows: Sequence[ConeRows]) -> tuple[Any, Vector, list[Any]]:
    """Return ``A``, ``b`` and the cones of rows, in Clarabel's form.

    Raises
    ------
    SolverError
        If an entry is not finite: Clarabel calls such a programme solved.
    """
    import clarabel

    A = _compressed(np.vstack([block.A for block in rows]))
    b = np.concatenate([block.b for block in rows])
    if not (np.isfinite(A.data).all() and np.isfinite(b).all()):
        raise SolverError("the programme has entries that are not finite numbers")
    return A, b, [cone for block in rows for cone in _cones(clarabel, block)]


def _cones(clarabel: Any, rows: ConeRows) -> list[Any]:
    if rows.kind == "semidefinite":
        return [clarabel.PSDTriangleConeT(k) for k in rows.orders]
    cones = {
        "zero": clarabel.ZeroConeT,
        "nonnegative": clarabel.NonnegativeConeT,
        "second order": clarabel.SecondOrderConeT,
    }
    return [cones[rows.kind](len(rows.b))] if len(rows.b) else []


def _compressed(A: Matrix) -> Any:
    """Return a dense matrix as Clarabel's sparse one, by columns."""
    from scipy.sparse import csc_matrix

    columns, rows = np.nonzero(A.T)
    ends = np.searchsorted(columns, np.arange(A.shape[1] + 1))
    return csc_matrix((A[rows, columns], rows, ends), shape=A.shape)


def set_rows(
    domain: ConicSet, *, margin: bool = False, others: int = 0
) -> list[ConeRows]:
    """Return the rows of ``u in domain``, for variables ``(others, u)``.

    With `margin`, the first of the others is the slack of inequalities and blocks:
    ``b_in - A_in u >= t`` and ``F(u) >= t 1``.
    """
    blocks = domain.block_rows
    rows = [
        ConeRows("zero", domain.A_eq, domain.b_eq),
        ConeRows("nonnegative", domain.A_in, domain.b_in),
        ConeRows("semidefinite", -blocks.A, blocks.b, blocks.orders),
    ]
    of_t = [
        np.zeros(len(domain.b_eq)),
        np.ones(len(domain.b_in)),
        stacked([np.eye(k) for k in blocks.orders]),
    ]
    for place, (cone, column) in enumerate(zip(rows, of_t, strict=True)):
        before = np.zeros((len(cone.b), others))
        if margin:
            before[:, 0] = column
        rows[place] = replace(cone, A=np.hstack([before, cone.A]))
    return rows


def set_multipliers(domain: ConicSet, duals: Sequence[Vector]) -> Multipliers:
    """Return the duals of `set_rows`, made feasible: rounding may leave the cones."""
    equal, at_most, z = duals
    orders = domain.block_rows.orders
    blocks = matrices(positive_part(z, orders), orders)
    return Multipliers(equal, np.maximum(at_most, 0.0), blocks)


def lower_bound(
    cost: Vector, rows: Sequence[ConeRows], duals: Sequence[Vector], within: Ball
) -> float:
    """Return a lower bound on ``cost.x``, valid for any result of the solver.

    For multipliers ``z_i`` in the dual cones and any feasible ``x``,
    ``cost.x >= r.x - sum b_i.z_i`` with ``r = cost + sum A_i^T z_i``, of which the
    first term is bounded in a ball.
    """
    rest, value = cost.copy(), 0.0
    equal = [block for block in rows if block.kind == "zero" and len(block.b)]
    for block, dual in zip(rows, duals, strict=True):
        if block.kind == "zero":
            continue
        z = _in_dual_cone(block, dual)
        rest = rest + block.A.T @ z
        value -= float(block.b @ z)
    for block in equal:  # free multipliers absorb as much as possible
        z = lstsq(block.A.T, -rest)
        rest = rest + block.A.T @ z
        value -= float(block.b @ z)
    ends = float(rest @ within.centre) - float(np.linalg.norm(rest)) * within.radius
    return value + ends


def _in_dual_cone(rows: ConeRows, z: Vector) -> Vector:
    """Return the dual vector, moved into its cone where rounding has left it."""
    if rows.kind == "nonnegative":
        return np.maximum(z, 0.0)
    if rows.kind == "semidefinite":
        return positive_part(z, rows.orders)
    return np.append(max(z[0], float(np.linalg.norm(z[1:]))), z[1:])
