"""Least-norm problems over convex sets.

``minimise ||G u - g||  subject to  u in a ConicSet``

in dimensionless variables.  The norm itself is the objective, a second-order cone: its
square as a quadratic objective makes interior-point solvers stop early on these
problems.  The solver's status is not used; `certify` checks the result.

- `free_set`: masses from the datasheet and known links are not unknowns.  The reduced
  set is in the free parameters alone; semidefinite blocks of pinned parameters are
  constant, and are left out if they are satisfied.
- `free_optimum`: with rich data, links are well inside the consistency cone, and only a
  few inequalities are active, such as zero friction or a mass at its bound.  Then least
  squares with a few active rows gives the optimum, in a fraction of a cone programme's
  time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from time import perf_counter
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import BoolArray, IntArray, Matrix, Vector
from consistent_id._support.tables import brief
from consistent_id.constraints.cones.programmes import (
    Ball,
    ConeRows,
    Multipliers,
    set_multipliers,
    set_rows,
    solve_cones,
)
from consistent_id.constraints.cones.sets import (
    ConicSet,
    least_eigenvalues,
    lengths,
    stacked,
)
from consistent_id.regression.linear import triangle

_FAR = 1e3  # norm of g beyond which to rescale, and to which to magnify

TOLERANCES = (1e-10, 1e-9, 1e-8)
"""Useful tolerances of the solver, the tightest first."""

FREE = "Free"
"""Status of a solution that no cone programme was needed for."""

_HOLDS = 1e-8  # by which a number may violate a normalised set
_ROUNDING = 1e-12  # violation of a constraint that counts as rounding
_FAINT = 1e-14
"""Weight of the squared distance to the centre, for flat objectives: it changes the
least value equally little.
"""
_CHANGES = 40  # most active rows; a few are usual, and many are left to cone programmes
_TOGETHER = 5  # changes of all rows at once, which may cycle


@brief
@dataclass(frozen=True, slots=True, eq=False)
class LeastNorm:
    """The problem: objective ``||G u - g||`` over a set."""

    G: Matrix
    g: Vector
    domain: ConicSet

    def compressed(self) -> "LeastNorm":
        """Return the same problem with at most one row more than parameters.

        A triangle of ``[G, g]`` has the same norm ``||G u - g||`` for all ``u``.
        """
        rows, columns = self.G.shape
        if rows <= columns + 1:
            return self
        R = triangle(np.asfortranarray(np.column_stack([self.G, self.g])))
        return replace(self, G=R[:, :columns], g=R[:, columns])


@dataclass(frozen=True, slots=True, eq=False)
class ConeSolution:
    """A point, multipliers of ``1/2 ||G u - g||^2``, and the effort."""

    u: Vector
    multipliers: Multipliers
    status: str
    build_seconds: float
    solve_seconds: float


def solve_least_norm(
    problem: LeastNorm,
    *,
    tolerance: float = TOLERANCES[0],
    within: Ball | None = None,
    origin: Vector | None = None,
    magnified: bool = False,
    refined: bool = True,
) -> ConeSolution:
    """Solve the problem once, with the given tolerance on gap and feasibility.

    Variables are ``(t, v)`` with ``u = origin + v``, the objective is
    ``t >= ||G v - (g - G origin)||``; pinned parameters are no variables.  A ball keeps
    `u` from diverging if the objective is nearly flat; its multiplier is left out.
    With an origin near the optimum, the solver's numbers are small, so its tolerances
    are tighter relative to the solution.  A magnified problem has large numbers in the
    norm instead, so the tolerances require more of its digits: its multipliers need
    them if the optimum is far below one.  For `refined` see `solve_cones`.

    Raises
    ------
    SolverError
        If the solver returns no finite point with multipliers.
    """
    G, domain = problem.G, problem.domain
    reduced = free_set(domain)
    free, start = reduced.free, reduced.start.copy()
    if origin is not None:
        start[free] = origin[free]
    g = problem.g - G @ start
    # Far from the origin, absolute tolerances would require more digits than there are.
    distance = float(np.linalg.norm(g)) / _FAR
    scale = distance if magnified and distance > 0.0 else max(1.0, distance)
    rows = norm_rows(G[:, free] / scale, g / scale, reduced, start[free])
    if within is not None:
        ball = within.moved(start).rows(others=1)
        rows.append(replace(ball, A=ball.A[:, np.append(True, free)]))
    cost = np.eye(1 + int(free.sum()))[0]
    point = solve_cones(cost, rows, tolerance=tolerance, refined=refined)
    u = start.copy()
    u[free] += point.x[1:]
    rest = G @ u - problem.g
    # Duals of the scaled norm, turned into those of half the square of the unscaled.
    multipliers = all_multipliers(
        domain, point.duals[:3], scale * float(np.linalg.norm(rest)), G.T @ rest
    )
    return ConeSolution(
        domain.snapped(u),
        multipliers,
        point.status,
        point.build_seconds,
        point.solve_seconds,
    )


def norm_rows(G: Matrix, g: Vector, reduced: "FreeSet", y: Vector) -> list[ConeRows]:
    """Return the rows for variables ``(t, v)``: ``y + v`` free, ``t >= ||G v - g||``.

    Parameters
    ----------
    G : ndarray, shape (rows, free)
    g : ndarray, shape (rows,)
    reduced : FreeSet
    y : ndarray, shape (free,)
    """
    rows, columns = G.shape
    norm = np.zeros((1 + rows, 1 + columns))
    norm[0, 0] = -1.0
    norm[1:, 1:] = -G
    misfit = ConeRows("second order", norm, np.append(0.0, -g))
    return [*reduced.about(y, others=1), misfit]


def solve_half_square(
    problem: LeastNorm, *, times: float, tolerance: float = TOLERANCES[0]
) -> ConeSolution:
    """Solve the problem once with half the square as the objective, magnified.

    Variables are ``(r, u)`` with ``r = G u - g``, the objective is
    ``times / 2 ||r||^2``.  Where the norm is nearly flat, as with torque that no robot
    has, its multipliers are more accurate than those of the norm.

    Parameters
    ----------
    times : float
        Factor of the objective: absolute tolerances then require more of its digits.

    Raises
    ------
    SolverError
        If the solver returns no finite point with multipliers.
    """
    G, domain = problem.G, problem.domain
    reduced, count = free_set(domain), len(problem.g)
    free, u = reduced.free, reduced.start.copy()
    rows = reduced.about(u[free], others=count)
    residual = np.hstack([np.eye(count), -G[:, free]])
    rows.append(ConeRows("zero", residual, G @ u - problem.g))
    size = residual.shape[1]
    curvature = np.where(np.arange(size) < count, times, 0.0)
    point = solve_cones(np.zeros(size), rows, tolerance=tolerance, curvature=curvature)
    u[free] += point.x[count:]
    slope = G.T @ (G @ u - problem.g)
    return ConeSolution(
        domain.snapped(u),
        all_multipliers(domain, point.duals[:3], 1.0 / times, slope),
        point.status,
        point.build_seconds,
        point.solve_seconds,
    )


@dataclass(frozen=True, slots=True, eq=False)
class FreeSet:
    """The restriction of a set to the parameters that it does not pin.

    Parameters
    ----------
    free : ndarray of bool, shape (parameters,)
    start : ndarray, shape (parameters,)
        Values of pinned parameters; zero for free ones.
    rows : tuple of ConeRows
        Rows for the free parameters: equalities, inequalities, semidefinite blocks.
    pins : ndarray of int, shape (pinned,)
        Equalities that pin parameters, in the order of the parameters.
    equal : ndarray of int
        The other equalities.
    entries : ndarray of bool
        Entries of the set's stacked blocks that remain.
    """

    free: BoolArray
    start: Vector
    rows: tuple[ConeRows, ConeRows, ConeRows]
    pins: IntArray
    equal: IntArray
    entries: BoolArray

    def about(self, y: Vector, others: int = 0) -> list[ConeRows]:
        """Return the rows for variables ``(others, steps of free parameters from y)``.

        Parameters
        ----------
        y : ndarray, shape (free,)
        others : int
        """
        return [
            replace(
                cone,
                A=np.hstack([np.zeros((len(cone.b), others)), cone.A]),
                b=cone.b - cone.A @ y,
            )
            for cone in self.rows
        ]


@lru_cache(maxsize=16)
def free_set(domain: ConicSet) -> FreeSet:
    """Return the restriction of a normalised set to parameters that are not pinned."""
    alone = np.flatnonzero(np.count_nonzero(domain.A_eq, axis=1) == 1)
    columns = np.argmax(domain.A_eq[alone] != 0.0, axis=1)
    pinned, first = np.unique(columns, return_index=True)
    pins = alone[first]
    start = np.zeros(domain.A_eq.shape[1])
    start[pinned] = domain.b_eq[pins] / domain.A_eq[pins, pinned]
    free = np.ones(len(start), dtype=bool)
    free[pinned] = False
    equal, at_most, blocks = (
        replace(cone, A=cone.A[:, free], b=cone.b - cone.A @ start)
        for cone in set_rows(domain)
    )
    # A second row that pins a parameter is either the same or a contradiction.
    left = equal.A.any(axis=1) | (abs(equal.b) > _HOLDS)
    left[pins] = False
    number = np.repeat(np.arange(len(blocks.orders)), lengths(blocks.orders))
    asks = least_eigenvalues(blocks.b, blocks.orders) < -_HOLDS
    asks[number[blocks.A.any(axis=1)]] = True
    entries = asks[number]
    orders = tuple(k for k, kept in zip(blocks.orders, asks, strict=True) if kept)
    rows = (
        replace(equal, A=equal.A[left], b=equal.b[left]),
        at_most,
        ConeRows("semidefinite", blocks.A[entries], blocks.b[entries], orders),
    )
    return FreeSet(free, start, rows, pins, np.flatnonzero(left), entries)


def all_multipliers(
    domain: ConicSet, duals: Sequence[Vector], size: float, slope: Vector
) -> Multipliers:
    """Return multipliers of all of a set's constraints.

    Those of pins equal the objective's gradient less that of the others.

    Parameters
    ----------
    domain : ConicSet
    duals : sequence of ndarray
        Dual vectors of the rows of `free_set`.
    size : float
        By which these are multiplied.
    slope : ndarray, shape (parameters,)
        The gradient.
    """
    found = free_set(domain)
    equal, z = np.zeros(len(domain.b_eq)), np.zeros(len(found.entries))
    equal[found.equal], z[found.entries] = duals[0], duals[2]
    others = set_multipliers(domain, (equal, duals[1], z)).times(size)
    pinned = ~found.free
    left = slope + domain.A_eq.T @ others.equal + domain.A_in.T @ others.at_most
    left -= domain.block_rows.A.T @ stacked(others.blocks)
    of_pins = -left[pinned] / domain.A_eq[found.pins, pinned]
    equal = others.equal.copy()
    equal[found.pins] = of_pins
    return replace(others, equal=equal)


class FreeOptimum(NamedTuple):
    """The result of `free_optimum`.

    Parameters
    ----------
    solution : ConeSolution, optional
        None if a block is violated there, or no optimum was found.
    triangle : ndarray, optional
        Factor of ``G`` along the steps that equalities allow; None where these are more
        than its rows.
    """

    solution: ConeSolution | None
    triangle: Matrix | None


class _ActiveStep(NamedTuple):
    """A step, and multipliers of the active rows."""

    d: Vector
    prices: Vector


def free_optimum(problem: LeastNorm, centre: Vector) -> FreeOptimum:
    """Return the optimum over equalities and inequalities if it satisfies all blocks.

    Certificates check the result.
    """
    started = perf_counter()
    domain, known = problem.domain, problem.domain.equalities
    start = centre + known.inverse @ (domain.b_eq - domain.A_eq @ centre)
    A, C = known.along(problem.G), known.along(domain.A_in)
    R, z = _triangle(A, problem.g - problem.G @ start)
    factor = R if len(A) >= A.shape[1] else None
    nothing = FreeOptimum(None, factor)
    if not np.diag(R).all():
        return nothing
    with np.errstate(over="ignore", invalid="ignore"):
        found = _with_rows(R, z, C, domain.b_in - domain.A_in @ start)
    if found is None or not np.isfinite(found.d).all():
        return nothing
    u = domain.snapped(start + known.steps @ found.d)
    if domain.blocks and domain.block_rows.margins(u).min() < -_ROUNDING:
        return nothing
    none = tuple(np.zeros_like(block.constant) for block in domain.blocks)
    slope = problem.G.T @ (problem.G @ u - problem.g) + domain.A_in.T @ found.prices
    multipliers = Multipliers(-known.inverse.T @ slope, found.prices, none)
    seconds = perf_counter() - started
    return FreeOptimum(ConeSolution(u, multipliers, FREE, 0.0, seconds), factor)


def _triangle(A: Matrix, b: Vector) -> tuple[Matrix, Vector]:
    """Return ``R, z`` with ``||R d - z||`` the misfit up to a constant."""
    rows, n = A.shape
    if rows < n:
        A = np.vstack([A, np.sqrt(_FAINT) * np.eye(n)])
        b = np.append(b, np.zeros(n))
    R = triangle(np.asfortranarray(np.column_stack([A, b])))
    return R[:n, :n], R[:n, n]


def _with_rows(R: Matrix, z: Vector, C: Matrix, c: Vector) -> _ActiveStep | None:
    """Return the least ``||R d - z||`` with ``C d <= c``, by its active rows.

    Rows change sides if their price is negative or they are violated: all at once, and
    after some changes only the first one, which terminates [Murty1974]_.
    """
    active = np.zeros(len(c), dtype=bool)
    for change in range(_CHANGES):
        step = _held(R, z, C, c, active)
        if step is None:
            return None
        beyond = C @ step.d > c + _ROUNDING
        wrong = np.where(active, step.prices < 0.0, beyond)
        if not wrong.any():
            return step
        if change >= _TOGETHER:
            wrong[np.argmax(wrong) + 1 :] = False
        active ^= wrong
    return None


def _held(
    R: Matrix, z: Vector, C: Matrix, c: Vector, active: BoolArray
) -> _ActiveStep | None:
    """Return the least ``||R d - z||`` with the active rows as equalities."""
    from scipy.linalg import solve_triangular

    prices = np.zeros(len(c))
    B = solve_triangular(R, C[active].T, trans=1, check_finite=False)
    if active.any():
        T = triangle(np.array(B, order="F"))
        if T.shape[0] < T.shape[1] or not np.diag(T).all():
            return None  # rows that depend on each other
        beyond = solve_triangular(T, B.T @ z - c[active], trans=1, check_finite=False)
        prices[active] = solve_triangular(T, beyond, check_finite=False)
    d = solve_triangular(R, z - B @ prices[active], check_finite=False)
    return _ActiveStep(np.asarray(d), prices)
