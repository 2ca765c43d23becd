"""Which columns of a regressor are independent, and which nearly are not."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.regression.triangles import triangle

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
    """Split columns from left to right; what only rounding tells apart is dependent.

    A column's own effect is its distance from the span of those before it, relative to
    the largest column of its kind.  Sorted, own effects have a gap where structure ends
    and rounding of the robot's geometry begins: the smaller ones are below `NEAR`, and
    `GAP` times below the next.

    Parameters
    ----------
    W : ndarray, shape (rows, columns)
    kinds : sequence of str
        Of the columns: parameters of one kind have one unit.
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
        split = split._replace(regrouping=_without_rounding(split, share, level))
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
