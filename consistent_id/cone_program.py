"""Least-norm problems over convex sets: modelled in CVXPY, solved by Clarabel.

``minimise ||G u - g||  subject to  u in a ConicSet``

in dimensionless variables.  The norm itself is the objective, a second-order cone: its
square as a quadratic objective makes interior-point solvers stop early on these
problems.  What the solver says of its own success is not used; `certify` judges.
"""

import warnings
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from consistent_id._arrays import Array, Matrix, Vector
from consistent_id.conic import ConicSet
from consistent_id.errors import SolverError

_FAR = 1e3  # norm of g, in units of a misfit that matters, beyond which to rescale

TOLERANCES = (1e-10, 1e-9, 1e-8)
"""Tolerances worth asking of the solver, from the tightest on."""


@dataclass(frozen=True, slots=True, eq=False)
class LeastNorm:
    """The problem: objective ``||G u - g||`` over a set."""

    G: Matrix
    g: Vector
    domain: ConicSet


@dataclass(frozen=True, slots=True, eq=False)
class Multipliers:
    """Dual values of ``1/2 ||G u - g||^2`` over the problem's constraints.

    Signs: at the optimum
    ``G^T (G u - g) + A_eq^T equal + A_in^T at_most - sum F*(blocks) = 0``.
    """

    equal: Vector
    at_most: Vector
    blocks: tuple[Matrix, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ConeSolution:
    """A point, its multipliers, and what it took."""

    u: Vector
    multipliers: Multipliers
    status: str
    build_seconds: float
    solve_seconds: float


def solve_least_norm(
    problem: LeastNorm, *, tolerance: float = TOLERANCES[0]
) -> ConeSolution:
    """Solve the problem once, with the given tolerance on gap and feasibility.

    Raises
    ------
    SolverError
        If the solver returns no finite point with multipliers.
    """
    import cvxpy as cp

    started = perf_counter()
    u = cp.Variable(problem.G.shape[1])
    # Far from the origin, absolute tolerances would ask for digits that are not there.
    scale = max(1.0, float(np.linalg.norm(problem.g)) / _FAR)
    objective = cp.norm(problem.G / scale @ u - problem.g / scale)
    model = _Model(u, problem.domain)
    program = cp.Problem(cp.Minimize(objective), model.constraints)
    names = ("tol_gap_abs", "tol_gap_rel", "tol_feas")
    options = dict.fromkeys(names, tolerance) | {"max_iter": 200}
    run_clarabel(program, **options)
    if u.value is None or not np.isfinite(u.value).all() or not model.has_duals():
        raise SolverError(f"Clarabel ended {program.status!r} without a point")
    # Duals of the scaled norm, turned into those of half the square of the unscaled.
    size = float(np.linalg.norm(problem.G @ u.value - problem.g))
    total = perf_counter() - started
    solve = float(program.solver_stats.solve_time or 0.0)
    multipliers = model.multipliers(size * scale)
    return ConeSolution(
        np.asarray(u.value), multipliers, str(program.status), total - solve, solve
    )


def run_clarabel(program: Any, **options: float) -> None:
    """Run Clarabel on a CVXPY problem.

    Raises
    ------
    SolverError
        If it fails outright; a doubtful answer is for certificates to judge.
    """
    import cvxpy as cp

    try:
        with warnings.catch_warnings():
            # "Solution may be inaccurate": certificates say so, with figures.
            warnings.simplefilter("ignore", UserWarning)
            program.solve(solver=cp.CLARABEL, **options)
    except (cp.error.SolverError, ValueError) as cause:
        raise SolverError(f"Clarabel failed: {cause}") from None


class _Model:
    """The CVXPY constraints of a problem, kept apart to read their duals."""

    def __init__(self, u: Any, domain: ConicSet) -> None:
        import cvxpy as cp

        self._equal = domain.A_eq @ u == domain.b_eq if len(domain.b_eq) else None
        self._at_most = domain.A_in @ u <= domain.b_in if len(domain.b_in) else None
        self._blocks = []
        for block in domain.blocks:
            k = len(block.scale)
            flat = block.coefficients.reshape(-1, k * k).T
            F = cp.reshape(flat @ u + block.constant.ravel(), (k, k), order="C")
            self._blocks.append(F >> 0)

    @property
    def constraints(self) -> list[Any]:
        single = (self._equal, self._at_most)
        return [c for c in single if c is not None] + self._blocks

    def has_duals(self) -> bool:
        return all(c.dual_value is not None for c in self.constraints)

    def multipliers(self, size: float) -> Multipliers:
        """Return the duals times `size`."""

        def of(constraint: Any) -> Array:
            if constraint is None:
                return np.zeros(0)
            return size * np.atleast_1d(np.asarray(constraint.dual_value))

        blocks = tuple(_positive_part(size * b.dual_value) for b in self._blocks)
        at_most = np.maximum(of(self._at_most), 0.0)
        return Multipliers(of(self._equal), at_most, blocks)


def _positive_part(Z: Matrix) -> Matrix:
    """Nearest positive semidefinite matrix; duals may stray by rounding."""
    values, vectors = np.linalg.eigh((Z + Z.T) / 2)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
