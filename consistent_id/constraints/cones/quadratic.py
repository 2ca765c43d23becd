"""Quadratic programmes over one convex set, one after another.

``minimise 1/2 u.P u + q.u  subject to  u in a ConicSet``

for several ``P`` and ``q``.  The set is handed to Clarabel once, which keeps the order
of its eliminations and the scaling.  With ``P = G^T G`` this is the least-norm problem
with its square as the objective, which takes half the time; but interior-point solvers
stop early where `P` is ill-conditioned.  So this is for fits that are compared, not for
those that are delivered, with a prior in `P` that keeps it from being singular.
"""

import numpy as np

from consistent_id._support.arrays import Array, Matrix
from consistent_id._support.threads import worker_threads
from consistent_id.constraints.cones.pinned import free_set
from consistent_id.constraints.cones.programmes import (
    cone_data,
    panics_as_errors,
    point_of,
    settings,
)
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.errors import SolverError

_WORKERS = 2  # Clarabel frees the interpreter's lock
_TOLERANCE = 1e-8  # of gap and feasibility: on it depend a few of a dozen iterations


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
        found = pool.map(lambda share: _solved(P[share], q[share], domain), shares)
        for share, solutions in zip(shares, found, strict=True):
            points[share] = solutions
    return points


def _solved(P: Array, q: Matrix, domain: ConicSet) -> Matrix:
    """Return the minimisers, one after another by one solver."""
    import clarabel
    from scipy.sparse import csc_matrix

    reduced = free_set(domain)
    free, start = reduced.free, reduced.start
    q = q[:, free] + start @ P[:, :, free]
    P = P[:, free][:, :, free]
    size = P.shape[1]
    column, row = np.tril_indices(size)  # the upper triangle, column by column
    ends = np.cumsum(np.arange(size + 1))
    data, chosen = cone_data(reduced.rows), settings(_TOLERANCE, refined=False)
    chosen.presolve_enable = chosen.chordal_decomposition_enable = False
    points, solver = [], None
    with panics_as_errors():
        for values, slope in zip(P[:, row, column], q, strict=True):
            if solver is None:
                quadratic = csc_matrix((values, row, ends), shape=(size, size))
                solver = clarabel.DefaultSolver(quadratic, slope, *data, chosen)
            else:
                solver.update(P=values, q=slope)
            points.append(solver.solve())
    found = np.tile(start, (len(points), 1))
    found[:, free] = [point_of(solution) for solution in points]
    return found
