"""Convex sets of parameters: equalities, inequalities, semidefinite blocks.

Every physical constraint lowers to such a set, which solver and certificate read
independently.

A symmetric matrix is stacked by `svec`, so that inner products are kept.  Several
matrices, whatever their orders, are one long vector; operations on it process all
matrices of one order at once.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import chain
from typing import NamedTuple, Self

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector, freeze_arrays
from consistent_id._support.singular import svd
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError

_NULL = 1e-12  # singular values below this, relative to the largest, are zero


@brief
@dataclass(frozen=True, slots=True, eq=False)
class SemidefiniteBlock:
    """``F(x) = constant + sum_i x_i coefficients_i``, required positive semidefinite.

    Parameters
    ----------
    coefficients : array_like, shape (parameters, k, k)
    constant : array_like, shape (k, k)
    scale : array_like, shape (k,)
        Typical square roots of the diagonal, by whose inverse rows and columns are
        multiplied, so that entries of different units are comparable.
    """

    label: str
    coefficients: Array
    constant: Matrix
    scale: Vector

    def __post_init__(self) -> None:
        k = len(self.scale)
        freeze_arrays(
            self,
            {"coefficients": (None, k, k), "constant": (k, k), "scale": (k,)},
            self.label,
        )

    @property
    def description(self) -> str:
        """The full label; that of physical consistency is only the link's name."""
        if ":" in self.label:
            return self.label
        return f"physical consistency of link {self.label!r}"

    def value(self, x: Vector) -> Matrix:
        """Return ``F(x)``, in original units."""
        return self.constant + np.tensordot(x, self.coefficients, axes=1)

    def scaled(self, x: Vector) -> Matrix:
        """Return ``F(x)`` with rows and columns divided by `scale`."""
        return self.value(x) / np.outer(self.scale, self.scale)


@brief
@dataclass(frozen=True, eq=False)
class ConicSet:
    """``A_eq x = b_eq``, ``A_in x <= b_in``, and semidefinite blocks.

    Rows carry labels, so that an active or contradictory one can be named.
    """

    A_eq: Matrix
    b_eq: Vector
    eq_labels: tuple[str, ...]
    A_in: Matrix
    b_in: Vector
    in_labels: tuple[str, ...]
    blocks: tuple[SemidefiniteBlock, ...] = ()

    def __post_init__(self) -> None:
        for A, b, labels in (
            (self.A_eq, self.b_eq, self.eq_labels),
            (self.A_in, self.b_in, self.in_labels),
        ):
            fine = np.isfinite(A).all(axis=1) & np.isfinite(b)
            if not fine.all():
                label = labels[int(np.argmin(fine))]
                raise ProblemError(f"constraint {label!r} is not of finite numbers")

    @classmethod
    def everything(cls, size: int) -> Self:
        """Return the set without any constraint on `size` parameters."""
        none, rows = np.zeros(0), np.zeros((0, size))
        return cls(rows, none, (), rows, none, ())

    @classmethod
    def equal(cls, A: Matrix, b: Vector, labels: Iterable[str]) -> Self:
        """Return ``{x : A x = b}``."""
        free = cls.everything(A.shape[1])
        return cls(A, b, tuple(labels), free.A_in, free.b_in, ())

    @classmethod
    def at_most(cls, A: Matrix, b: Vector, labels: Iterable[str]) -> Self:
        """Return ``{x : A x <= b}``."""
        free = cls.everything(A.shape[1])
        return cls(free.A_eq, free.b_eq, (), A, b, tuple(labels))

    @classmethod
    def semidefinite(cls, blocks: Iterable[SemidefiniteBlock], size: int) -> Self:
        """Return ``{x : F(x) positive semidefinite for each block}``."""
        none, rows = np.zeros(0), np.zeros((0, size))
        return cls(rows, none, (), rows, none, (), tuple(blocks))

    def __and__(self, other: "ConicSet") -> "ConicSet":
        """Return the intersection."""
        return _together([self, other])

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of all members: equalities, inequalities, blocks."""
        blocks = tuple(block.description for block in self.blocks)
        return self.eq_labels + self.in_labels + blocks

    @cached_property
    def equalities(self) -> "Equalities":
        """Pseudo-inverse and null space of the equalities."""
        return row_spaces(self.A_eq)

    @cached_property
    def block_rows(self) -> "BlockRows":
        """The semidefinite blocks under each other."""
        orders = tuple(len(block.scale) for block in self.blocks)
        scales = [_outer(block.scale) for block in self.blocks]
        A = [
            svec(block.coefficients / scale).T
            for block, scale in zip(self.blocks, scales, strict=True)
        ]
        b = [
            svec(block.constant / scale)
            for block, scale in zip(self.blocks, scales, strict=True)
        ]
        none = np.zeros((0, self.A_eq.shape[1]))
        values = np.concatenate([np.zeros(0), *b])
        return BlockRows(np.vstack([none, *A]), values, orders)

    def only(self, members: Iterable[int]) -> "ConicSet":
        """Return the set of only these members, counted as in `labels`."""
        chosen, e, i = sorted(set(members)), len(self.b_eq), len(self.b_in)
        equal = [m for m in chosen if m < e]
        at_most = [m - e for m in chosen if e <= m < e + i]
        return ConicSet(
            self.A_eq[equal],
            self.b_eq[equal],
            tuple(self.eq_labels[m] for m in equal),
            self.A_in[at_most],
            self.b_in[at_most],
            tuple(self.in_labels[m] for m in at_most),
            tuple(self.blocks[m - e - i] for m in chosen if m >= e + i),
        )

    def without(self, member: int) -> "ConicSet":
        """Return the set without one member, counted as in `labels`."""
        return self.only(m for m in range(len(self.labels)) if m != member)

    def normalised(self, unit: Vector) -> "ConicSet":
        """Rewrite the set for ``u = x / unit``, with rows of unit size.

        Semidefinite blocks are divided by their scales, so that all entries are pure
        numbers around one.
        """
        A_eq, b_eq = _unit_rows(self.A_eq * unit, self.b_eq)
        A_in, b_in = _unit_rows(self.A_in * unit, self.b_in)
        blocks = tuple(
            SemidefiniteBlock(
                block.label,
                unit[:, None, None] * block.coefficients / _outer(block.scale),
                block.constant / _outer(block.scale),
                np.ones(len(block.scale)),
            )
            for block in self.blocks
        )
        return ConicSet(A_eq, b_eq, self.eq_labels, A_in, b_in, self.in_labels, blocks)

    def shrunk(self, size: float) -> "ConicSet":
        """Rewrite the set for ``v = u / size``; slacks are divided by `size` too."""
        blocks = tuple(
            replace(block, constant=block.constant / size) for block in self.blocks
        )
        return replace(
            self, b_eq=self.b_eq / size, b_in=self.b_in / size, blocks=blocks
        )

    def moved(self, origin: Vector) -> "ConicSet":
        """Rewrite the set for ``v = u - origin``."""
        blocks = tuple(replace(b, constant=b.value(origin)) for b in self.blocks)
        b_eq, b_in = self.b_eq - self.A_eq @ origin, self.b_in - self.A_in @ origin
        return replace(self, b_eq=b_eq, b_in=b_in, blocks=blocks)

    @cached_property
    def box(self) -> tuple[Vector, Vector]:
        """Least and largest value of each parameter by rows on it alone."""
        low = np.full(self.A_eq.shape[1], -np.inf)
        high = np.full(self.A_eq.shape[1], np.inf)
        A = np.vstack([self.A_in, self.A_eq, -self.A_eq])
        b = np.concatenate([self.b_in, self.b_eq, -self.b_eq])
        rows = np.flatnonzero(np.count_nonzero(A, axis=1) == 1)
        columns = np.argmax(A[rows] != 0.0, axis=1)
        slopes = A[rows, columns]
        bounds = b[rows] / slopes + 0.0  # and no minus zero
        up, down = slopes > 0.0, slopes < 0.0
        np.minimum.at(high, columns[up], bounds[up])
        np.maximum.at(low, columns[down], bounds[down])
        for ends in (low, high):
            ends.setflags(write=False)
        return low, high

    def snapped(self, x: Vector) -> Vector:
        """Return `x` with rows on a single parameter satisfied to the last digit.

        A mass is then exactly the datasheet's, and friction is not -1e-12.
        """
        return np.clip(x, *self.box)

    def violation(self, x: Vector) -> float:
        """Return the largest violation, zero or more, in the set's own units.

        Meaningful for a `normalised` set.
        """
        worst = [0.0]
        if len(self.b_eq):
            worst.append(float(abs(self.A_eq @ x - self.b_eq).max()))
        if len(self.b_in):
            worst.append(float((self.A_in @ x - self.b_in).max()))
        if self.blocks:
            worst.append(-float(self.block_rows.margins(x).min()))
        return float(np.max(worst)) if np.isfinite(worst).all() else np.inf


def intersection(sets: Iterable[ConicSet], size: int) -> ConicSet:
    """Return the intersection of any number of sets of `size` parameters."""
    return _together([ConicSet.everything(size), *sets])


def _together(sets: Sequence[ConicSet]) -> ConicSet:
    return ConicSet(
        np.vstack([each.A_eq for each in sets]),
        np.concatenate([each.b_eq for each in sets]),
        tuple(chain.from_iterable(each.eq_labels for each in sets)),
        np.vstack([each.A_in for each in sets]),
        np.concatenate([each.b_in for each in sets]),
        tuple(chain.from_iterable(each.in_labels for each in sets)),
        tuple(chain.from_iterable(each.blocks for each in sets)),
    )


def _unit_rows(A: Matrix, b: Vector) -> tuple[Matrix, Vector]:
    norms = np.linalg.norm(A, axis=1)
    norms = np.where(norms > 0.0, norms, 1.0)
    return A / norms[:, None], b / norms


def _outer(scale: Vector) -> Matrix:
    return np.outer(scale, scale)


class Equalities(NamedTuple):
    """A set's equalities: ``A^+``, and a basis of the steps that keep them."""

    inverse: Matrix
    steps: Matrix
    kept: IntArray | None = None
    """Free parameters, if each row has only one parameter."""

    def along(self, rows: Matrix) -> Matrix:
        """Return ``rows @ steps``."""
        return rows @ self.steps if self.kept is None else rows[:, self.kept]


def row_spaces(A: Matrix, tolerance: float = _NULL) -> Equalities:
    """Return the pseudo-inverse of a matrix and an orthonormal basis of its null space.

    Singular values up to the tolerance, relative to the largest, count as zero.
    """
    alone = np.count_nonzero(A, axis=1) == 1
    fixed = A.any(axis=0)
    if alone.all() and fixed.sum() == len(A):  # such as masses of a datasheet
        kept = np.flatnonzero(~fixed)
        inverse = np.divide(1.0, A.T, where=A.T != 0.0, out=np.zeros(A.T.shape))
        return Equalities(inverse, np.eye(A.shape[1])[:, kept], kept)
    U, s, Vt = svd(A)
    rank = int((s > tolerance * s.max(initial=0.0)).sum())
    return Equalities((Vt[:rank].T / s[:rank]) @ U[:, :rank].T, Vt[rank:].T)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class BlockRows:
    """All semidefinite blocks of a set, each divided by its scale: ``A x + b``.

    Parameters
    ----------
    A : ndarray, shape (rows, parameters)
    b : ndarray, shape (rows,)
    orders : tuple of int
        Orders of the matrices, as the set has them.
    """

    A: Matrix
    b: Vector
    orders: tuple[int, ...]

    def margins(self, x: Vector) -> Vector:
        """Return the least eigenvalue of each block, shape (blocks,)."""
        return least_eigenvalues(self.A @ x + self.b, self.orders)

    def products(self, x: Vector, z: Vector) -> Vector:
        """Return the inner product of each block with a matrix of a stack."""
        ends = np.cumsum(lengths(self.orders), dtype=np.intp)
        sums = np.cumsum(z * (self.A @ x + self.b))[ends - 1]
        return np.diff(sums, prepend=0.0)


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
    """Return the number of entries of each of the stacked matrices."""
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
