"""Linear algebra of regressions: triangles, independent columns, least squares.

Triangular factors are computed by QR, in place.  `split_at_gap` says which columns are
independent, and which nearly are not.  Least squares uses singular values: rank, null
space, smallest solution.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Matrix, Vector
from consistent_id._support.singular import lstsq, svd
from consistent_id._support.tables import brief
from consistent_id.errors import NotExcitedError

_BLOCK = 16  # columns that a QR eliminates at a time: 8 to 32 are equally fast
_PANEL = 8  # the same of rows below a triangle: 4 to 16 are equally fast


def extended(R: Matrix, rows: Matrix) -> Matrix:
    """Return the triangular factor of a triangular factor and more rows below it.

    Both are destroyed.  With a whole triangle on top, its zeros are not worked on.
    """
    width = R.shape[1]
    if len(R) + len(rows) < width:
        return triangle(np.vstack([R, rows]))
    if len(R) < width:
        R, above = np.zeros((width, width), order="F"), R
        R[: len(above)] = above
    panel = min(_PANEL, width)
    factor, *_ = _tpqrt()(0, panel, R, rows, overwrite_a=1, overwrite_b=1)
    return np.asarray(factor)


def triangle(rows: Matrix) -> Matrix:
    """Return the triangular factor of a QR decomposition, destroying `rows`."""
    if 0 in rows.shape:
        return rows[: rows.shape[1]]
    R, *_ = _geqrt()(min(_BLOCK, *rows.shape), rows, overwrite_a=1)
    R = R[: rows.shape[1]]
    return np.where(_upper(*R.shape), R, 0.0)


@lru_cache(maxsize=64)
def _upper(rows: int, columns: int) -> BoolArray:
    # numpy.triu makes this mask each time, which takes as long as a small QR.
    return np.tri(columns, rows, dtype=bool).T


@lru_cache(maxsize=1)
def _tpqrt() -> Callable[..., tuple[Any, ...]]:
    from scipy.linalg.lapack import dtpqrt

    return dtpqrt  # type: ignore[no-any-return]


@lru_cache(maxsize=1)
def _geqrt() -> Callable[..., tuple[Any, ...]]:
    # numpy.linalg.qr copies twice; LAPACK's own routine works in place.  dgeqrf takes
    # one column after another up to 128 columns: twice the time on tall matrices.
    from scipy.linalg.lapack import dgeqrt

    return dgeqrt  # type: ignore[no-any-return]


DATA_RANK_TOLERANCE = 1e-10
"""Singular values of the unit-column regressor below this, relative to the largest,
count as zero: ten times beyond what rounding leaves of an exact zero."""

_SILENT = 1e-13  # norm of a column, relative to the largest, that is rounding alone


@brief
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
        Singular values of the matrix with unit columns.
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
    U, s, Vt = svd(scaled, full_matrices=len(A) < A.shape[1])
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
        Tolerance of rank, relative to the largest singular value; by default numpy's.
    """
    sizes = column_sizes(A)
    y = lstsq(A / sizes, b, tolerance)
    return np.asarray((y.T / sizes).T)


def pulled_solution(A: Matrix, point: Vector, weight: float) -> Vector:
    """Return ``x`` of the least ``||A x||^2 + weight ||x - point||^2``."""
    from scipy.linalg import solve_triangular

    size = len(point)
    rows = np.zeros((len(A) + size, size + 1), order="F")
    rows[: len(A), :size], rows[: len(A), size] = A, -A @ point
    np.fill_diagonal(rows[len(A) :, :size], np.sqrt(weight))
    R = triangle(rows)
    step = solve_triangular(R[:size, :size], R[:size, size], check_finite=False)
    return np.asarray(point + step)


def null_space(rows: Matrix, tolerance: float) -> Matrix:
    """Return an orthonormal basis of the null space of rows, made of unit size."""
    if not rows.any():
        return np.eye(rows.shape[1])
    _, s, Vt = svd(rows / column_sizes(rows.T)[:, None])
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
    """Return ``v`` less the multiple of ``w`` that leaves the fewest entries."""
    both = np.flatnonzero((v != 0.0) & (w != 0.0))
    sums = [_cleaned(v - v[e] / w[e] * w) for e in both]
    return min(sums, key=np.count_nonzero, default=v)


def _cleaned(row: Vector) -> Vector:
    nearest = np.round(row)
    return np.asarray(np.where(abs(row - nearest) < 1e-7, nearest, row))


STRUCTURAL_TOLERANCE = 1e-9
"""A unit column nearer than this to the span of those before it is dependent.

On random motions of random robots of up to nine joints, dependent columns come within
1e-11 and independent ones stay beyond 1e-5.
"""

NEAR = 3e-3
"""A column whose own effect is below this may have it from a rounded number alone.

An angle of 3.14 for half a turn leaves 1.6e-3.  See `GAP`.
"""

GAP = 100.0
"""Ratio of the own effects of two columns, above which the smaller one is no true one.

Chosen by ``python benchmarks/rank.py``, on arms whose angles are rounded to 2 to 7
digits, and on random robots, none of which loses a column.
"""

_ROUNDED = 10.0
"""Largest own effect of a rounded number, over which an entry that it makes is not.

The gap's level would be too high: it may be far above all that is rounded, and then
takes short lengths, whose squares are entries, for zero.
"""

_ROUND = 1e-10  # entries of K below this are rounding errors


class ColumnSplit(NamedTuple):
    """Columns that are independent, and how they give the others.

    Attributes
    ----------
    independent, dependent : tuple of int
    regrouping : ndarray, shape (independent, dependent)
        ``W[:, dependent] = W[:, independent] @ K``.
    """

    independent: tuple[int, ...]
    dependent: tuple[int, ...]
    regrouping: Matrix


class NearSplit(NamedTuple):
    """A split of columns in which nearly dependent ones are dependent.

    Attributes
    ----------
    split : ColumnSplit
    near : dict of int to float
        Dependent columns, and their own effects, which are not zero.
    """

    split: ColumnSplit
    near: dict[int, float]


def split_at_gap(W: Matrix, kinds: Sequence[str]) -> NearSplit:
    """Split columns from left to right; columns that differ by rounding are dependent.

    A column's own effect is its distance from the span of those before it, relative to
    the largest column of its kind.  Sorted, own effects have a gap where structure ends
    and rounding of the robot's geometry begins: the smaller ones are below `NEAR`, and
    `GAP` times below the next.

    Parameters
    ----------
    W : ndarray, shape (rows, columns)
    kinds : sequence of str
        Kinds of the columns: parameters of one kind have one unit.
    """
    norms, unit = _unit(_shortened(W), STRUCTURAL_TOLERANCE)
    largest: dict[str, float] = {}
    for kind, norm in zip(kinds, norms.tolist(), strict=True):
        largest[kind] = max(norm, largest.get(kind, 0.0))
    share = norms / [largest[kind] or 1.0 for kind in kinds]
    _, distances = _orthogonal(unit, STRUCTURAL_TOLERANCE)
    effects = {c: d * float(share[c]) for c, d in distances.items()}
    level = gap_level(np.array(list(effects.values())))
    tolerance = level / np.where(share > 0.0, share, 1.0)
    split = _split(norms, unit, np.maximum(tolerance, STRUCTURAL_TOLERANCE))
    near = {c: e for c, e in effects.items() if c in set(split.dependent)}
    if near:
        rounded = min(level, _ROUNDED * max(near.values()))
        split = split._replace(regrouping=_without_rounding(split, share, rounded))
    return NearSplit(split, near)


def _without_rounding(split: ColumnSplit, share: Vector, level: float) -> Matrix:
    """Return ``K`` without what a rounded number adds to it."""
    K = split.regrouping
    sizes = share[list(split.independent)][:, None]
    K = np.where(abs(K) * sizes < level, 0.0, K)
    nearest = np.round(K)
    return np.asarray(np.where(abs(K - nearest) * sizes < level, nearest, K))


def gap_level(effects: Vector) -> float:
    """Return a level within the gap of own effects, or 0 if there is none."""
    ordered = np.sort(effects)
    below, above = ordered[:-1], ordered[1:]
    gaps = np.flatnonzero((below < NEAR) & (above > GAP * below))
    if not len(gaps):
        return 0.0
    last = gaps[-1]
    return float(np.sqrt(below[last] * above[last]))


def independent_columns(
    W: Matrix, tolerance: float = STRUCTURAL_TOLERANCE
) -> ColumnSplit:
    """Split columns into independent and dependent ones, from left to right.

    Parameters
    ----------
    W : ndarray, shape (rows, columns)
    tolerance : float
        Distance of a unit column from the span of the independent ones before it, at
        or below which it counts as dependent.  Columns whose norm is below this
        fraction of the largest count as zero.
    """
    return _split(*_unit(_shortened(W), tolerance), tolerance)


def _split(norms: Vector, unit: Matrix, tolerance: float | Vector) -> ColumnSplit:
    Q, distances = _orthogonal(unit, tolerance)
    independent = list(distances)
    dependent = [i for i in range(len(norms)) if i not in distances]
    K: Matrix = np.zeros((len(independent), len(dependent)))
    if independent and dependent:
        R = Q.T @ unit[:, independent]
        K[:] = np.linalg.solve(R, Q.T @ unit[:, dependent])
        K[:] = K * norms[dependent] / norms[independent, None]
    nearest = np.round(K)
    K = np.asarray(np.where(abs(K - nearest) < _ROUND, nearest, K))
    return ColumnSplit(tuple(independent), tuple(dependent), K)


def _shortened(W: Matrix) -> Matrix:
    """Return no more rows than columns, of which norms and angles are the same."""
    return triangle(np.array(W, order="F")) if len(W) > W.shape[1] else W


def _unit(W: Matrix, tolerance: float) -> tuple[Vector, Matrix]:
    """Return norms of columns, zero for negligible ones, and the unit columns."""
    norms = np.linalg.norm(W, axis=0)
    norms = np.where(norms <= tolerance * norms.max(initial=0.0), 0.0, norms)
    unit = np.where(norms > 0.0, W / np.where(norms > 0.0, norms, 1.0), 0.0)
    return norms, unit


def _orthogonal(
    unit: Matrix, tolerance: float | Vector
) -> tuple[Matrix, dict[int, float]]:
    """Return a basis of the independent columns, and the distance of each of them."""
    least = np.broadcast_to(tolerance, unit.shape[1:])
    Q = np.empty(unit.shape, order="F")
    distances: dict[int, float] = {}
    for column in range(unit.shape[1]):
        rest, known = unit[:, column], Q[:, : len(distances)]
        for _ in range(2):  # twice is enough for orthogonality to rounding
            rest = rest - known @ (known.T @ rest)
        distance = float(np.linalg.norm(rest))
        if distance > least[column]:
            Q[:, len(distances)] = rest / distance
            distances[column] = distance
    return Q[:, : len(distances)], distances
