"""One smooth programme: an objective with its gradient, under rows, by IPOPT.

Objective and nonlinear rows are Python functions of the flattened variables that
return values and first derivatives; curvature is approximated on the way.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.errors import SolverError
from consistent_id.excitation.limit_rows import LimitRows

_TOLERANCE = 1e-4  # of the optimality conditions, in the objective's unit: a logarithm


@dataclass(frozen=True, slots=True, eq=False)
class Programme:
    """Minimise an objective under linear and nonlinear rows.

    Parameters
    ----------
    objective : callable
        ``variables -> (value, gradient)``, flattened.
    rows : callable, optional
        ``variables -> (values, Jacobian)``, shapes (count,) and (count, variables);
        each value is to be 0 or less.
    count : int
        Of those rows.
    """

    objective: Callable[[Vector], tuple[float, Array]]
    limits: LimitRows
    rows: Callable[[Vector], tuple[Vector, Matrix]] | None = None
    count: int = 0


def minimise(
    programme: Programme,
    start: Vector,
    *,
    iterations: int,
    watch: Callable[[Vector], bool],
    reach: float = np.inf,
) -> Vector:
    """Run IPOPT from a start; return where it ends.

    Parameters
    ----------
    start : ndarray, shape (variables,)
    watch : callable
        Sees every iterate; says whether to stop.
    reach : float
        By which each variable may differ from its start.

    Raises
    ------
    SolverError
        If IPOPT could not begin.
    """
    import casadi as ca

    from consistent_id.excitation.callbacks import Differentiable, Observer, QuasiNewton

    x = ca.MX.sym("x", len(start))
    objective = Differentiable("objective", len(start), 1, programme.objective)
    A = programme.limits.matrix.tocsc()
    pattern = ca.Sparsity(A.shape[0], A.shape[1], A.indptr, A.indices)
    g = [ca.mtimes(ca.DM(pattern, A.data), x)]
    upper = np.ones(A.shape[0])
    lower = -upper
    memory = None
    if programme.rows is not None:
        rows = Differentiable("rows", len(start), programme.count, programme.rows)
        memory = rows.memory
        g.append(rows(x))
        lower = np.append(lower, np.full(programme.count, -np.inf))
        upper = np.append(upper, np.zeros(programme.count))
    curvature = QuasiNewton(len(start), A.shape[0], objective.memory, memory)
    observer = Observer(len(start), len(upper), watch)
    near = {"lbx": start - reach, "ubx": start + reach}
    try:
        solver = ca.nlpsol(
            "excitation",
            "ipopt",
            {"x": x, "f": objective(x), "g": ca.vertcat(*g)},
            _options(iterations)
            | {"iteration_callback": observer, "hess_lag": curvature},
        )
        result = solver(x0=start, lbg=lower, ubg=upper, **near)
    except RuntimeError as cause:
        if "KeyboardInterrupt" in str(cause):  # as CasADi hands on one in a callback
            raise KeyboardInterrupt from None
        raise SolverError(f"IPOPT could not begin: {cause}") from None
    return np.asarray(result["x"]).ravel()


def _options(iterations: int) -> dict[str, Any]:
    return {
        "print_time": False,
        "error_on_fail": False,
        "calc_lam_p": False,
        "calc_lam_x": False,
        "ipopt": {
            "print_level": 0,
            "sb": "yes",
            "max_iter": iterations,
            "tol": _TOLERANCE,
            "mu_strategy": "adaptive",
        },
    }
