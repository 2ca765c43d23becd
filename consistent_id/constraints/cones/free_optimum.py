"""The optimum of a least-norm problem that no semidefinite block holds back.

Where data are rich, links are well inside the cone of consistency, and only a few
inequalities hold: a friction that is zero, a mass at its bound.  Then least squares
with a few active rows is the answer, in a fraction of what a cone programme takes.
"""

from time import perf_counter
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import BoolArray, Matrix, Vector
from consistent_id.constraints.cones.least_norm import ConeSolution, LeastNorm
from consistent_id.constraints.cones.programmes import Multipliers
from consistent_id.constraints.cones.row_spaces import equalities
from consistent_id.constraints.cones.sets import block_rows
from consistent_id.regression.triangles import triangle

_ROUNDING = 1e-12  # by which a constraint may seem to be violated
_FAINT = 1e-14
"""Weight of the squared distance to the centre, where the objective is flat: its least
value changes by as little."""
_CHANGES = 40  # of the active rows; a few are usual, and many are for cone programmes
_TOGETHER = 5  # changes of all rows at once, which may go round in circles


class FreeOptimum(NamedTuple):
    """What `free_optimum` found.

    Parameters
    ----------
    solution : ConeSolution, optional
        None if a block does not hold there, or no optimum was found.
    triangle : ndarray, optional
        Factor of ``G`` along the steps that equalities allow; None where these are more
        than its rows.
    """

    solution: ConeSolution | None
    triangle: Matrix | None


class _Step(NamedTuple):
    """A step, and multipliers of the active rows."""

    d: Vector
    prices: Vector


def free_optimum(problem: LeastNorm, centre: Vector) -> FreeOptimum:
    """Return the optimum over equalities and inequalities if it keeps all blocks.

    Certificates judge what is returned.
    """
    started = perf_counter()
    domain, known = problem.domain, equalities(problem.domain)
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
    if domain.blocks and block_rows(domain).margins(u).min() < -_ROUNDING:
        return nothing
    none = tuple(np.zeros_like(block.constant) for block in domain.blocks)
    slope = problem.G.T @ (problem.G @ u - problem.g) + domain.A_in.T @ found.prices
    multipliers = Multipliers(-known.inverse.T @ slope, found.prices, none)
    seconds = perf_counter() - started
    return FreeOptimum(ConeSolution(u, multipliers, "Free", 0.0, seconds), factor)


def _triangle(A: Matrix, b: Vector) -> tuple[Matrix, Vector]:
    """Return ``R, z`` with ``||R d - z||`` the misfit but for a constant."""
    rows, n = A.shape
    if rows < n:
        A = np.vstack([A, np.sqrt(_FAINT) * np.eye(n)])
        b = np.append(b, np.zeros(n))
    R = triangle(np.asfortranarray(np.column_stack([A, b])))
    return R[:n, :n], R[:n, n]


def _with_rows(R: Matrix, z: Vector, C: Matrix, c: Vector) -> _Step | None:
    """Return the least ``||R d - z||`` with ``C d <= c``, by its active rows.

    Rows change sides where their price is negative or they are violated: all at once,
    and after some changes the first alone, which comes to an end [Murty1974]_.
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
) -> _Step | None:
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
    return _Step(np.asarray(d), prices)
