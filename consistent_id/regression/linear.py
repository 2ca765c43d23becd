"""Linear least squares by singular values: rank, null space, smallest solution."""

from dataclasses import dataclass
from functools import cached_property
from itertools import permutations

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.errors import NotExcitedError

DATA_RANK_TOLERANCE = 1e-10
"""Singular values of the unit-column regressor below this, relative to the largest,
count as zero: ten times beyond what rounding leaves of an exact zero."""

_SILENT = 1e-13  # norm of a column, relative to the largest, that is rounding alone


@dataclass(frozen=True, eq=False)
class LinearSolution:
    """Solution of ``min ||A x - b||`` with its rank and null space.

    Parameters
    ----------
    x : ndarray, shape (columns,)
        The smallest solution.
    steps : ndarray, shape (columns, rank)
        Less its part along the kernel, ``x = steps @ (left.T @ b)``.
    left : ndarray, shape (rows, rank)
        Orthonormal columns that the matrix spans.
    kernel : ndarray, shape (columns, columns - rank)
        Directions that do not change ``A x``.
    row_space : ndarray, shape (rank, columns)
        Combinations that the rows determine.
    singular_values : ndarray
        Of the matrix with unit columns.
    """

    x: Vector
    steps: Matrix
    left: Matrix
    kernel: Matrix
    row_space: Matrix
    singular_values: Vector

    @property
    def rank(self) -> int:
        """Rank of the matrix."""
        return len(self.x) - int(self.kernel.shape[1])

    @cached_property
    def pseudo_inverse(self) -> Matrix:
        """``x = pseudo_inverse @ b``, shape (columns, rows)."""
        return _without(self.kernel, self.steps @ self.left.T)

    @cached_property
    def null_space(self) -> Matrix:
        """The kernel in readable (reduced) form, which takes a search."""
        return _readable(self.kernel)


def solve_linear(
    A: Matrix, b: Vector, *, tolerance: float = DATA_RANK_TOLERANCE
) -> LinearSolution:
    """Solve a least-squares problem; the smallest solution if rank is deficient.

    Rank is decided on unit columns, so it does not depend on units.
    """
    norms = np.linalg.norm(A, axis=0)
    if not norms.any():
        raise NotExcitedError("the regressor is zero: the motion excites no parameter")
    silent = norms <= _SILENT * norms.max()
    unit = np.where(silent, 1.0, norms)
    scaled = np.where(silent, 0.0, A / unit)
    U, s, Vt = np.linalg.svd(scaled, full_matrices=len(A) < A.shape[1])
    s = np.append(s, np.zeros(A.shape[1] - len(s)))
    rank = int((s > tolerance * s[0]).sum())
    steps, left = (Vt[:rank].T / s[:rank]) / unit[:, None], U[:, :rank]
    null = Vt[rank:].T / unit[:, None]
    x = _without(null, steps @ (left.T @ b))
    return LinearSolution(x, steps, left, null, Vt[:rank] * unit, s)


def _without(kernel: Matrix, x: Matrix) -> Matrix:
    """Return vectors less their parts along the kernel."""
    if not kernel.shape[1]:
        return x
    basis, _ = np.linalg.qr(kernel)
    return np.asarray(x - basis @ (basis.T @ x))


def column_sizes(A: Matrix) -> Vector:
    """Return the norms of columns, one where they are zero."""
    norms = np.linalg.norm(A, axis=0)
    return np.where(norms > 0.0, norms, 1.0)


def smallest_solution(A: Matrix, b: Array, tolerance: float | None = None) -> Array:
    """Return the smallest least-squares solution in unit columns.

    Without what else `solve_linear` says.

    Parameters
    ----------
    b : ndarray, shape (rows,) or (rows, right-hand sides)
    tolerance : float, optional
        Of rank, relative to the largest singular value; by default numpy's.
    """
    sizes = column_sizes(A)
    y = np.linalg.lstsq(A / sizes, b, rcond=tolerance)[0]
    return np.asarray((y.T / sizes).T)


def null_space(rows: Matrix, tolerance: float) -> Matrix:
    """Return an orthonormal basis of what rows, made of unit size, do not see."""
    if not rows.any():
        return np.eye(rows.shape[1])
    _, s, Vt = np.linalg.svd(rows / column_sizes(rows.T)[:, None])
    return np.asarray(Vt[int((s > tolerance * s[0]).sum()) :].T)


def _readable(null: Matrix) -> Matrix:
    """Null space in sparse form, so that directions read as short combinations.

    From the reduced echelon form, directions are added to each other as long as that
    makes one shorter; the first entry of each is one.
    """
    if null.shape[1] == 0:
        return null
    from scipy.linalg import qr

    _, _, order = qr(null.T, mode="economic", pivoting=True)
    pivots = np.sort(order[: null.shape[1]])
    directions = [_cleaned(row) for row in (null @ np.linalg.inv(null[pivots])).T]
    shorter = True
    while shorter:
        shorter = False
        for i, j in permutations(range(len(directions)), 2):
            best = _shortest_sum(directions[i], directions[j])
            if np.count_nonzero(best) < np.count_nonzero(directions[i]):
                directions[i], shorter = best, True
    return np.column_stack([row / row[np.flatnonzero(row)[0]] for row in directions])


def _shortest_sum(v: Vector, w: Vector) -> Vector:
    """Of ``v`` less a multiple of ``w``, the one with the fewest entries."""
    both = np.flatnonzero((v != 0.0) & (w != 0.0))
    sums = [_cleaned(v - v[e] / w[e] * w) for e in both]
    return min(sums, key=np.count_nonzero, default=v)


def _cleaned(row: Vector) -> Vector:
    nearest = np.round(row)
    return np.asarray(np.where(abs(row - nearest) < 1e-7, nearest, row))
