"""Convex sets of parameters: equalities, inequalities, semidefinite blocks.

Every physical constraint lowers to one of these, which the solver's model and the
certificate then read alike, each for itself.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from typing import Self

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, freeze_arrays
from consistent_id.constraints.cones.matrices import least_eigenvalues, lengths, svec
from consistent_id.errors import ProblemError


@dataclass(frozen=True, slots=True, eq=False)
class SemidefiniteBlock:
    """``F(x) = constant + sum_i x_i coefficients_i``, required positive semidefinite.

    Parameters
    ----------
    coefficients : array_like, shape (parameters, k, k)
    constant : array_like, shape (k, k)
    scale : array_like, shape (k,)
        Typical square roots of the diagonal, by whose inverse rows and columns are
        multiplied, so that entries of unlike units compare.
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
        """The label in full; that of physical consistency is the link's name alone."""
        if ":" in self.label:
            return self.label
        return f"physical consistency of link {self.label!r}"

    def value(self, x: Vector) -> Matrix:
        """Return ``F(x)``, in original units."""
        return self.constant + np.tensordot(x, self.coefficients, axes=1)

    def scaled(self, x: Vector) -> Matrix:
        """Return ``F(x)`` with rows and columns divided by `scale`."""
        return self.value(x) / np.outer(self.scale, self.scale)


@dataclass(frozen=True, slots=True, eq=False)
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
        return ConicSet(
            np.vstack([self.A_eq, other.A_eq]),
            np.concatenate([self.b_eq, other.b_eq]),
            self.eq_labels + other.eq_labels,
            np.vstack([self.A_in, other.A_in]),
            np.concatenate([self.b_in, other.b_in]),
            self.in_labels + other.in_labels,
            self.blocks + other.blocks,
        )

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of all members: equalities, inequalities, blocks."""
        blocks = tuple(block.description for block in self.blocks)
        return self.eq_labels + self.in_labels + blocks

    def only(self, members: Iterable[int]) -> "ConicSet":
        """Return the set of these members alone, counted as in `labels`."""
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

    @property
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
        return low, high

    def snapped(self, x: Vector) -> Vector:
        """Return `x` with rows on a single parameter made to hold to the last digit.

        A mass is then the datasheet's and friction is not -1e-12.
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
            worst.append(-float(block_rows(self).margins(x).min()))
        return float(np.max(worst)) if np.isfinite(worst).all() else np.inf


def intersection(sets: Iterable[ConicSet], size: int) -> ConicSet:
    """Return the intersection of any number of sets of `size` parameters."""
    return reduce(lambda a, b: a & b, sets, ConicSet.everything(size))


def _unit_rows(A: Matrix, b: Vector) -> tuple[Matrix, Vector]:
    norms = np.linalg.norm(A, axis=1)
    norms = np.where(norms > 0.0, norms, 1.0)
    return A / norms[:, None], b / norms


def _outer(scale: Vector) -> Matrix:
    return np.outer(scale, scale)


@dataclass(frozen=True, slots=True, eq=False)
class BlockRows:
    """All semidefinite blocks of a set, each divided by its scale: ``A x + b``.

    Parameters
    ----------
    A : ndarray, shape (rows, parameters)
    b : ndarray, shape (rows,)
    orders : tuple of int
        Of the matrices, as the set has them.
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


@lru_cache(maxsize=16)
def block_rows(domain: ConicSet) -> BlockRows:
    """Return the semidefinite blocks of a set under each other."""
    orders = tuple(len(block.scale) for block in domain.blocks)
    scales = [np.outer(block.scale, block.scale) for block in domain.blocks]
    A = [
        svec(block.coefficients / scale).T
        for block, scale in zip(domain.blocks, scales, strict=True)
    ]
    b = [
        svec(block.constant / scale)
        for block, scale in zip(domain.blocks, scales, strict=True)
    ]
    none = np.zeros((0, domain.A_eq.shape[1]))
    return BlockRows(np.vstack([none, *A]), np.concatenate([np.zeros(0), *b]), orders)
