"""Symmetric matrices as vectors, many of them at once.

A matrix is stacked by `svec`, so that inner products are kept.  Several matrices,
whatever their orders, are one long vector; what is done with it is done for all
matrices of one order at once.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector


def svec(F: Array) -> Array:
    """Stack symmetric matrices, shape (..., k, k), so that inner products are kept.

    Upper triangle, column by column, off-diagonals times sqrt(2); (..., k (k + 1) / 2).
    """
    i, j, weight = _triangle(F.shape[-1])
    return np.asarray(F[..., i, j] * weight)


def smat(v: Array) -> Array:
    """Return the symmetric matrices that `svec` has stacked, shape (..., k, k)."""
    k = int((np.sqrt(8 * v.shape[-1] + 1) - 1) / 2)
    i, j, weight = _triangle(k)
    F = np.zeros((*v.shape[:-1], k, k))
    F[..., i, j] = F[..., j, i] = v / weight
    return F


def matrices(z: Vector, orders: Sequence[int]) -> tuple[Matrix, ...]:
    """Return the matrices of the given orders that are stacked in a vector."""
    found: list[Matrix] = [np.zeros((0, 0))] * len(orders)
    for which, places in _by_order(tuple(orders)):
        for index, F in zip(which, smat(z[places]), strict=True):
            found[index] = F
    return tuple(found)


def stacked(blocks: Sequence[Matrix]) -> Vector:
    """Return matrices as one vector."""
    return np.concatenate([svec(F) for F in blocks]) if blocks else np.zeros(0)


def lengths(orders: Sequence[int]) -> list[int]:
    """Return how many entries of a vector each of the stacked matrices takes."""
    return [k * (k + 1) // 2 for k in orders]


def positive_part(z: Vector, orders: Sequence[int]) -> Vector:
    """Return the nearest stack of positive semidefinite matrices."""
    found = z.copy()
    for _, places in _by_order(tuple(orders)):
        values, vectors = np.linalg.eigh(smat(z[places]))
        roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, None]
        found[places] = svec(roots @ np.swapaxes(roots, 1, 2))
    return found


def least_eigenvalues(z: Vector, orders: Sequence[int]) -> Vector:
    """Return the least eigenvalue of each matrix of a stack."""
    found = np.zeros(len(orders))
    for which, places in _by_order(tuple(orders)):
        found[which] = np.linalg.eigvalsh(smat(z[places]))[:, 0]
    return found


@lru_cache(maxsize=64)
def _by_order(orders: tuple[int, ...]) -> tuple[tuple[IntArray, IntArray], ...]:
    """Return, per order, which matrices have it, and their places in the vector."""
    sizes = np.array(lengths(orders), dtype=np.intp)
    starts = np.cumsum(sizes) - sizes
    groups = [np.flatnonzero(sizes == size) for size in np.unique(sizes)]
    return tuple((g, starts[g][:, None] + np.arange(sizes[g[0]])) for g in groups)


@lru_cache(maxsize=32)
def _triangle(k: int) -> tuple[IntArray, IntArray, Vector]:
    # Rows of the lower triangle are columns of the upper one.
    j, i = np.tril_indices(k)
    return i, j, np.where(i == j, 1.0, np.sqrt(2.0))
