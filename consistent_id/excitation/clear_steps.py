"""Steps from a path that violates nothing to a better one that does not either.

Each step is a quadratic programme: the objective's slope and its curvature as far as
steps have shown it, the linear limits, the guards made linear where they are near, and
a reach within which that is true.  Barrier methods begin inside all limits at once and
lose what a path has that lies against several of them; this one keeps it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from consistent_id._support.arrays import Matrix, Vector

_NEAR = 12.0  # times the reach: share of a limit within which it counts
_NEAREST = 0.6  # the same, at most; a step beyond the others is made smaller
_STEADY = 1e-6  # of the curvature's mean, added to its diagonal


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
    start: Vector, local: Local, rows: LinearRows, reach: float
) -> Vector | None:
    """Return the step that promises most; None if the programme has no solution.

    ``min slope.d + d.curvature.d / 2`` within the limits that are near, the rows and
    ``|d| <= reach``.

    Parameters
    ----------
    start : ndarray, shape (variables,)
    """
    import clarabel
    from scipy import sparse

    size = len(start)
    here, curvature = local.limits @ start, local.curvature
    near = abs(here) > 1.0 - min(_NEAR * reach, _NEAREST)
    limits, here = local.limits[near], here[near]
    unit = sparse.identity(size, format="csc")
    steady = _STEADY * np.trace(curvature) / size * np.eye(size)
    left = sparse.vstack(
        [limits, -limits, unit, -unit, sparse.csc_array(rows.jacobian)], format="csc"
    )
    # A start that touches a limit may exceed its row by rounding.
    right = np.concatenate(
        [
            np.maximum(1.0 - here, 0.0),
            np.maximum(1.0 + here, 0.0),
            np.full(2 * size, reach),
            -rows.values,
        ]
    )
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    solver = clarabel.DefaultSolver(
        sparse.triu(sparse.csc_array(curvature + steady), format="csc"),
        local.slope,
        left,
        right,
        [clarabel.NonnegativeConeT(len(right))],
        settings,
    )
    found = solver.solve()
    if found.status not in (
        clarabel.SolverStatus.Solved,
        clarabel.SolverStatus.AlmostSolved,
    ):
        return None
    return np.asarray(found.x)
