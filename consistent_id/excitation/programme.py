"""The programmes that a search solves: a smooth one, and steps without violations.

The smooth one is solved by IPOPT.  Objective and nonlinear rows are Python functions of
the flattened variables that return values and first derivatives; curvature is
approximated on the way.

Steps lead from a path without violations to a better one without violations. Each is a
quadratic programme: the objective's slope and its approximate curvature, the linear
limits, linearised guards near their limits, and a reach within which the linearisation
is valid.  Barrier methods begin inside all limits and cannot start well from a path at
several limits; steps can.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.errors import SolverError
from consistent_id.excitation.basis import LimitRows
from consistent_id.excitation.work import Meter

_TOLERANCE = 1e-4  # of the optimality conditions, in the objective's unit: a logarithm

_NEAR = 0.4  # times the length of a row and the reach: room within which it is included
_NEAREST = 2  # rows per variable that are included first, at most: few become active
_ADDED = 10  # most programmes of a step; rows that the last one violates are added
_BEYOND = 1e-3  # by which a step may exceed a row that is not included
_STEADY = 1e-6  # of the curvature's mean, added to its diagonal
_SOLVED = 1.5e-4  # work of an iteration of a quadratic programme,
_PRODUCT = 3e-8  # per row and variable,
_SQUARED = 8e-11  # and per row and square of the variables, which matters above 200
_ITERATIONS = 200  # most of a programme; a dozen are usual
_LEAST = 20  # the same if little work is left


@dataclass(frozen=True, slots=True, eq=False)
class Programme:
    """Minimise an objective under linear and nonlinear rows.

    Parameters
    ----------
    objective : callable
        ``variables -> (value, gradient)``, flattened.
    rows : callable, optional
        ``variables -> (values, Jacobian)``, shapes (count,) and (count, variables);
        each value must be 0 or less.
    count : int
        Number of those rows.
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
        Gets every iterate; returns whether to stop.
    reach : float
        Largest difference of each variable from its start.

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
        if "KeyboardInterrupt" in str(cause):  # as CasADi passes on one in a callback
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


@dataclass(frozen=True, slots=True, eq=False)
class LinearRows:
    """Rows of guards near a path: ``values + jacobian d <= 0``.

    Parameters
    ----------
    values : ndarray, shape (rows,)
    jacobian : ndarray, shape (rows, variables)
    """

    values: Vector
    jacobian: Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Local:
    """The objective near a path, and the linear limits.

    Parameters
    ----------
    slope : ndarray, shape (variables,)
    curvature : ndarray, shape (variables, variables)
        Positive definite.
    limits : scipy.sparse.csr_array, shape (limits, variables)
        ``-1 <= A x <= 1``.
    """

    slope: Vector
    curvature: Matrix
    limits: Any


def best_step(
    start: Vector,
    local: Local,
    rows: LinearRows,
    reach: float,
    meter: Meter | None = None,
) -> Vector | None:
    """Return the most promising step; None if the programme has no solution.

    ``min slope.d + d.curvature.d / 2`` within limits, rows and ``|d| <= reach``.
    Only the nearest limits and rows are included first, and others if a step violates
    them: a path of many harmonics has thousands, of which dozens become active.

    Parameters
    ----------
    start : ndarray, shape (variables,)
    meter : Meter, optional
        To which the work is added; there is no step if it runs out.
    """
    from scipy import sparse

    here, size = local.limits @ start, len(start)
    limits = sparse.csr_array(local.limits)
    A = sparse.vstack([limits, -limits, sparse.csr_array(rows.jacobian)], format="csr")
    # A start that touches a limit may exceed its row by rounding.
    room = np.concatenate(
        [np.maximum(1.0 - here, 0.0), np.maximum(1.0 + here, 0.0), -rows.values]
    )
    length = np.sqrt(sparse.csr_array(A.multiply(A)).sum(axis=1))
    apart = room / np.maximum(length, _BEYOND)
    few = min(_NEAREST * size, len(room) - 1)
    chosen = apart < min(_NEAR * reach, np.partition(apart, few)[few])
    steady = _STEADY * np.trace(local.curvature) / size * np.eye(size)
    curvature = sparse.triu(sparse.csc_array(local.curvature + steady), format="csc")
    step: Vector | None = None
    for _ in range(_ADDED):
        if meter is not None and step is not None and meter.over:
            return None
        work = _SOLVED + (_PRODUCT + _SQUARED * size) * float(chosen.sum()) * size
        left = np.inf if meter is None else meter.left / work
        most = int(np.clip(left, _LEAST, _ITERATIONS))
        solved = _least(curvature, local.slope, A[chosen], room[chosen], reach, most)
        step = solved.step
        if meter is not None:
            meter.spent += work * solved.iterations
        if step is None:
            break
        beyond = A @ step > room + _BEYOND
        if not (beyond & ~chosen).any():
            break
        chosen |= beyond
    return step


class _Solved(NamedTuple):
    """The step that solves a quadratic programme, if any, and the iterations for it."""

    step: Vector | None
    iterations: int


def _least(
    curvature: Any, slope: Vector, A: Any, room: Vector, reach: float, most: int
) -> _Solved:
    """Minimise a quadratic under ``A d <= room`` and ``|d| <= reach``.

    It has no solution if `most` iterations do not find it.
    """
    import clarabel
    from scipy import sparse

    size = len(slope)
    unit = sparse.identity(size, format="csc")
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.max_iter = most
    right = np.concatenate([room, np.full(2 * size, reach)])
    solver = clarabel.DefaultSolver(
        curvature,
        slope,
        sparse.vstack([A, unit, -unit], format="csc"),
        right,
        [clarabel.NonnegativeConeT(len(right))],
        settings,
    )
    found = solver.solve()
    solved = clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved
    step = np.asarray(found.x) if found.status in solved else None
    return _Solved(step, int(found.iterations))
