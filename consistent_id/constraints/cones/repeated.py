"""Several programmes over one set.

Clarabel gets the rows once, and keeps the order of its eliminations and the scaling.

- `solve_costs`: linear programmes.
- `minimisers`: ``minimise 1/2 u.P u + q.u`` for several ``P`` and ``q``.  With
  ``P = G^T G`` this is the least-norm problem with its square as the objective, which
  takes half the time, but stops early if `P` is ill-conditioned. So it is used for fits
  that are compared, not for delivered ones, with a prior in `P` that makes it regular.
- `solve_squares`: the same for least-norm problems, about a point near their optima.
- `rough_squares`: how small the misfit can be, with one ``G`` and different ``g``.

Several quadratic programmes are solved together (`solve_together`), a single one, and
one that does not end there, by Clarabel.
"""

from collections.abc import Sequence
from time import perf_counter
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.constraints.cones.least_norm import (
    ConeSolution,
    LeastNorm,
    all_multipliers,
    free_set,
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
from consistent_id.constraints.cones.together import solve_together
from consistent_id.errors import SolverError

_ROUGH = 0.01
_FEW = 4  # programmes from which solving them together takes less time
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
    P : ndarray, shape (programmes or 1, variables, variables)
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
    reduced = free_set(domain)
    free, start = reduced.free, reduced.start
    q = q[:, free] + start @ P[:, :, free]
    found = np.tile(start, (len(q), 1))
    found[:, free] = _solved(P[:, free][:, :, free], q, reduced.rows)[0]
    return found


def _solved(P: Array, q: Matrix, rows: Sequence[ConeRows]) -> tuple[Matrix, Matrix]:
    """Return points and multipliers; programmes that do not end are Clarabel's."""
    x, z = np.zeros_like(q), np.zeros((len(q), sum(len(block.b) for block in rows)))
    left = np.arange(len(q))
    if len(q) >= _FEW:
        found = solve_together(P, q, rows, tolerance=_QUADRATIC_TOLERANCE)
        x, z, left = found.x, found.z, np.flatnonzero(~found.ended)
    if len(left):
        squares = P if len(P) == 1 else P[left]
        solutions = _one_after_another(squares, q[left], rows)
        x[left] = [point_of(solution) for solution in solutions]
        z[left] = [solution.z for solution in solutions]
    return x, z


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
        for place, slope in enumerate(q):
            values = P[min(place, len(P) - 1), row, column]
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
    steps, multipliers = _solved(G.transpose(0, 2, 1) @ G, q, rows)
    seconds = (perf_counter() - started) / len(problems)
    ends, found = np.cumsum([len(block.b) for block in rows])[:-1], []
    for problem, step, z in zip(problems, steps, multipliers, strict=True):
        u = start.copy()
        u[free] += step
        slope = problem.G.T @ (problem.G @ u - problem.g)
        duals = all_multipliers(domain, np.split(z, ends), 1.0, slope)
        found.append(ConeSolution(domain.snapped(u), duals, "", 0.0, seconds))
    return found


def rough_squares(
    G: Matrix,
    targets: Matrix,
    domain: ConicSet,
    origin: Vector,
    *,
    unit: float,
    enough: float = -np.inf,
) -> Vector:
    """Return about the least ``||G u - g||^2`` in a set for each target ``g``.

    Parameters
    ----------
    G : ndarray, shape (rows, parameters)
    targets : ndarray, shape (targets, rows)
    domain : ConicSet
    origin : ndarray, shape (parameters,)
        A point near the optima.
    unit : float
        A hundredth of this, or of the square where that is larger, is the error.
    enough : float
        A square that is this or less need not be the least one.

    Returns
    -------
    ndarray, shape (targets,)
        NaN where no optimum was found.
    """
    reduced = free_set(domain)
    free, start = reduced.free, np.where(reduced.free, origin, reduced.start)
    own, misfits = G[:, free], G @ start - targets
    found = solve_together(
        2.0 / unit * (own.T @ own)[None],
        2.0 / unit * misfits @ own,
        reduced.about(start[free]),
        tolerance=_ROUGH,
        least=np.sum(misfits**2, axis=1) / unit,
        enough=enough / unit,
    )
    squares = np.sum((misfits + found.x @ own.T) ** 2, axis=1)
    return np.where(found.ended, squares, np.nan)
