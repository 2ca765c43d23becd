"""Several programmes over one set, by one solver.

Clarabel gets the rows once, and keeps the order of its eliminations and the scaling.

- `solve_costs`: linear programmes.
- `minimisers`: ``minimise 1/2 u.P u + q.u`` for several ``P`` and ``q``.  With
  ``P = G^T G`` this is the least-norm problem with its square as the objective, which
  takes half the time, but stops early if `P` is ill-conditioned. So it is used for fits
  that are compared, not for delivered ones, with a prior in `P` that makes it regular.
- `solve_squares`: the same for least-norm problems, about a point near their optima.
- `point_finder`: least-norm problems with one ``G`` and different ``g``.
"""

from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.executors import worker_threads
from consistent_id.constraints.cones.least_norm import (
    ConeSolution,
    LeastNorm,
    all_multipliers,
    free_set,
    norm_rows,
)
from consistent_id.constraints.cones.programmes import (
    COARSE,
    ConePoint,
    ConeRows,
    cone_data,
    cone_point,
    panics_as_errors,
    point_of,
    settings,
)
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.errors import SolverError

_WORKERS = 2  # Clarabel frees the interpreter's lock
# Of gap and feasibility: a few of a dozen iterations depend on it.
_QUADRATIC_TOLERANCE = 1e-8


def solve_costs(
    costs: Sequence[Vector], rows: Sequence[ConeRows], *, tolerance: float
) -> list[ConePoint | None]:
    """Solve the programme for one cost after another, by one solver.

    The points are those of `solve_cones`; None stands where it raises an error.
    """
    import clarabel
    from scipy.sparse import csc_matrix

    size, found, solver = len(costs[0]), list[ConePoint | None](), None
    chosen = settings(tolerance, refined=tolerance < COARSE)
    chosen.presolve_enable = chosen.chordal_decomposition_enable = False  # for updates
    for cost in costs:
        started = perf_counter()
        try:
            with panics_as_errors():
                if solver is None:
                    data = csc_matrix((size, size)), cost, *cone_data(rows)
                    solver = clarabel.DefaultSolver(*data, chosen)
                else:
                    solver.update(q=cost)
                solved_from = perf_counter()
                solution = solver.solve()
            taken = solved_from - started
            found.append(cone_point(solution, rows, taken, solved_from))
        except SolverError:
            found.append(None)
            solver = None
    return found


def minimisers(P: Array, q: Matrix, domain: ConicSet) -> Matrix:
    """Return the minimiser of each programme.

    Parameters
    ----------
    P : ndarray, shape (programmes, variables, variables)
        Symmetric positive definite; entries around one.
    q : ndarray, shape (programmes, variables)
    domain : ConicSet
        Normalised.

    Returns
    -------
    ndarray, shape (programmes, variables)

    Raises
    ------
    SolverError
        If the solver returns no finite point.
    """
    if not (np.isfinite(P).all() and np.isfinite(q).all()):
        raise SolverError("the programme has entries that are not finite numbers")
    shares = [slice(k, None, _WORKERS) for k in range(min(_WORKERS, len(q)))]
    points = np.empty_like(q)
    with worker_threads(_WORKERS) as pool:
        found = pool.map(lambda share: _minimiser(P[share], q[share], domain), shares)
        for share, solutions in zip(shares, found, strict=True):
            points[share] = solutions
    return points


def _minimiser(P: Array, q: Matrix, domain: ConicSet) -> Matrix:
    """Return the minimisers, one after another by one solver."""
    reduced = free_set(domain)
    free, start = reduced.free, reduced.start
    q = q[:, free] + start @ P[:, :, free]
    found = np.tile(start, (len(q), 1))
    solutions = _one_after_another(P[:, free][:, :, free], q, reduced.rows)
    found[:, free] = [point_of(solution) for solution in solutions]
    return found


def _one_after_another(P: Array, q: Matrix, rows: Sequence[ConeRows]) -> list[Any]:
    """Return Clarabel's solutions of quadratic programmes over the same rows."""
    import clarabel
    from scipy.sparse import csc_matrix

    size = P.shape[1]
    column, row = np.tril_indices(size)  # the upper triangle, column by column
    ends = np.cumsum(np.arange(size + 1))
    chosen = settings(_QUADRATIC_TOLERANCE, refined=False)
    chosen.presolve_enable = chosen.chordal_decomposition_enable = False
    chosen.equilibrate_enable = False  # entries are around one: see `minimisers`
    found, solver = [], None
    with panics_as_errors():
        for values, slope in zip(P[:, row, column], q, strict=True):
            if solver is None:
                quadratic = csc_matrix((values, row, ends), shape=(size, size))
                data = cone_data(rows)
                solver = clarabel.DefaultSolver(quadratic, slope, *data, chosen)
            else:
                solver.update(P=values, q=slope)
            found.append(solver.solve())
    return found


def solve_squares(problems: Sequence[LeastNorm], origin: Vector) -> list[ConeSolution]:
    """Solve problems over the same domain by their squares; certificates check them.

    Parameters
    ----------
    origin : ndarray, shape (parameters,)
        A point near the optima: the solver's numbers are then small.

    Raises
    ------
    SolverError
        If the solver returns no finite point with multipliers.
    """
    started = perf_counter()
    domain = problems[0].domain
    reduced = free_set(domain)
    free, start = reduced.free, np.where(reduced.free, origin, reduced.start)
    G = np.array([problem.G[:, free] for problem in problems])
    misfits = [problem.G @ start - problem.g for problem in problems]
    q, rows = np.einsum("krc,kr->kc", G, misfits), reduced.about(start[free])
    solutions = _one_after_another(G.transpose(0, 2, 1) @ G, q, rows)
    seconds = (perf_counter() - started) / len(problems)
    ends, found = np.cumsum([len(block.b) for block in rows])[:-1], []
    for problem, solution in zip(problems, solutions, strict=True):
        u = start.copy()
        u[free] += point_of(solution)
        duals = np.split(np.asarray(solution.z), ends)
        slope = problem.G.T @ (problem.G @ u - problem.g)
        multipliers = all_multipliers(domain, duals, 1.0, slope)
        status, u = str(solution.status), domain.snapped(u)
        found.append(ConeSolution(u, multipliers, status, 0.0, seconds))
    return found


def point_finder(
    G: Matrix, domain: ConicSet, *, tolerance: float, origin: Vector
) -> Callable[[Vector], Vector]:
    """Return a function from ``g`` to the point of least ``||G u - g||`` in a set.

    The points are those of `solve_least_norm` up to the tolerance.  Each thread needs a
    function of its own: it has one solver, of which only the right-hand sides change.

    Raises
    ------
    SolverError
        By the function, if ``g`` is not finite.

    Parameters
    ----------
    G : ndarray, shape (rows, parameters)
    domain : ConicSet
    tolerance : float
    origin : ndarray, shape (parameters,)
        A point near the optima, from which ``||G u - g||`` is some 1000 at most.
    """
    import clarabel
    from scipy.sparse import csc_matrix

    reduced = free_set(domain)
    free, start = reduced.free, np.where(reduced.free, origin, reduced.start)
    size, about = 1 + int(free.sum()), G @ start
    chosen = settings(tolerance, refined=tolerance < COARSE)
    chosen.presolve_enable = chosen.chordal_decomposition_enable = False  # for updates
    rows = norm_rows(G[:, free], np.zeros(len(G)), reduced, start[free])
    A, b, cones = cone_data(rows)
    with panics_as_errors():
        solver = clarabel.DefaultSolver(
            csc_matrix((size, size)), np.eye(size)[0], A, b, cones, chosen
        )

    def point(g: Vector) -> Vector:
        if not np.isfinite(g).all():
            raise SolverError("the programme has entries that are not finite numbers")
        b[len(b) - len(g) :] = about - g
        with panics_as_errors():
            solver.update(b=b)
            found = point_of(solver.solve())
        u = start.copy()
        u[free] += found[1:]
        return domain.snapped(u)

    return point
