"""The least-norm problem again, modelled in CVXPY: an oracle for the package's own."""

import warnings
from typing import Any, Literal, get_args

import cvxpy as cp
import numpy as np

from consistent_id.constraints.cones.least_norm import ConeSolution, LeastNorm
from consistent_id.constraints.cones.programmes import Multipliers
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.errors import SolverError

Formulation = Literal["quadratic in Clarabel", "norm in SCS"]
FORMULATIONS: tuple[Formulation, ...] = get_args(Formulation)
"""From the more to the less exact."""

_CLARABEL = {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-10}
_SCS = {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iters": 20_000}


def solve_anew(problem: LeastNorm, formulation: Formulation) -> ConeSolution:
    """Solve a least-norm problem through CVXPY.

    ``"quadratic in Clarabel"`` minimises ``1/2 ||r||^2`` with ``r = G u - g`` as
    variables of their own, so that ``G^T G`` is never formed; ``"norm in SCS"`` is the
    second-order cone in a first-order solver.

    Raises
    ------
    SolverError
        If the solver returns no finite point with multipliers.
    """
    domain = problem.domain
    u, r = cp.Variable(problem.G.shape[1]), cp.Variable(len(problem.g))
    residual = r == problem.G @ u - problem.g
    norm = formulation == "norm in SCS"
    objective = cp.norm(r) if norm else 0.5 * cp.sum_squares(r)
    constraints = _constraints(u, domain)
    program = cp.Problem(cp.Minimize(objective), [residual, *constraints])
    solver, options = (cp.SCS, _SCS) if norm else (cp.CLARABEL, _CLARABEL)
    try:
        with warnings.catch_warnings():
            # "Solution may be inaccurate": certificates say so, with figures.
            warnings.simplefilter("ignore", UserWarning)
            program.solve(solver=solver, **options)
    except (cp.error.SolverError, ValueError) as cause:
        raise SolverError(f"{formulation} failed: {cause}") from None
    duals = [c.dual_value for c in constraints]
    if (
        u.value is None
        or not np.isfinite(u.value).all()
        or any(d is None for d in duals)
    ):
        raise SolverError(f"{formulation} ended {program.status!r} without a point")
    size = float(np.linalg.norm(problem.G @ u.value - problem.g)) if norm else 1.0
    times = program.solver_stats
    return ConeSolution(
        np.asarray(u.value),
        _multipliers(domain, duals).times(size),
        str(program.status),
        float(program.compilation_time or 0.0),
        float(times.solve_time or 0.0),
    )


def _constraints(u: Any, domain: ConicSet) -> list[Any]:
    rows: list[Any] = []
    if len(domain.b_eq):
        rows.append(domain.A_eq @ u == domain.b_eq)
    if len(domain.b_in):
        rows.append(domain.A_in @ u <= domain.b_in)
    return rows + [_semidefinite(u, block) for block in domain.blocks]


def _semidefinite(u: Any, block: Any) -> Any:
    k = len(block.scale)
    flat = block.coefficients.reshape(-1, k * k).T
    return cp.reshape(flat @ u + block.constant.ravel(), (k, k), order="C") >> 0


def _multipliers(domain: ConicSet, duals: list[np.ndarray]) -> Multipliers:
    remaining = [np.atleast_1d(np.asarray(dual)) for dual in duals]
    equal = remaining.pop(0) if len(domain.b_eq) else np.zeros(0)
    at_most = remaining.pop(0) if len(domain.b_in) else np.zeros(0)
    blocks = tuple((Z + Z.T) / 2 for Z in remaining)
    return Multipliers(equal, np.maximum(at_most, 0.0), blocks)
