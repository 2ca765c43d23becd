"""Nesterov's and Todd's scaling of cones, for many pairs of points at once.

A cone belongs to rows ``s = b - A x`` that all programmes share: the non-negative
orthant, or semidefinite matrices of one order.  To each pair of interior points, of
which ``s`` is in the cone and ``z`` in its dual, belongs a scaling ``W`` with
``W^-T s = W z = lam``.  Its operations, in the letters of [Vandenberghe2010]_, take and
return stacks of shape (programmes, rows).  Matrices are rows of all their entries, so
that inner products are kept.

A scaling is a tuple of stacks, of which each cone says the meaning; the last one is
``lam``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector
from consistent_id.constraints.cones.programmes import ConeRows
from consistent_id.constraints.cones.sets import lengths, smat, svec

Scaling = tuple[Array, ...]


class Cone(Protocol):
    """Rows in a cone, and the operations of its scalings."""

    @property
    def A(self) -> Matrix:
        """Coefficients of the rows, shape (rows, variables)."""

    @property
    def b(self) -> Vector:
        """Constants of the rows."""

    @property
    def unit(self) -> Vector:
        """Unit element ``e``: ``e o v = v``."""

    def entries(self, s: Matrix) -> Matrix:
        """Return points as the stacked rows have them, see `ConeRows`."""

    @property
    def places(self) -> IntArray:
        """Their places among the stacked rows."""

    @property
    def degree(self) -> int:
        """``lam.lam`` over this is the scale of ``lam o lam``."""

    def scaling(self, s: Matrix, z: Matrix) -> Scaling:
        """Return the scaling of interior points."""

    def moved(self, scaling: Scaling, s: Matrix, z: Matrix) -> Scaling:
        """Return the scaling of ``(W^T s, W^-1 z)``."""

    def down(self, scaling: Scaling, s: Matrix) -> Matrix:
        """Return ``W^-T s``."""

    def up(self, scaling: Scaling, v: Matrix) -> Matrix:
        """Return ``W^T v``."""

    def back(self, scaling: Scaling, v: Matrix) -> Matrix:
        """Return ``W^-1 v``."""

    def product(self, u: Matrix, v: Matrix) -> Matrix:
        """Return Jordan's product ``u o v``."""

    def divided(self, scaling: Scaling, v: Matrix) -> Matrix:
        """Return ``u`` with ``lam o u = v``."""

    def beyond(self, scaling: Scaling, v: Matrix) -> Vector:
        """Return the least ``t`` for which ``t lam + v`` is in the cone."""

    def least(self, s: Matrix) -> Vector:
        """Return the largest ``t`` for which ``s - t e`` is in the cone."""

    def add_curvature(self, H: Array, scaling: Scaling) -> None:
        """Add ``A^T (W^T W)^-1 A`` to stacked matrices."""


@dataclass(frozen=True, slots=True, eq=False)
class _Orthant:
    """Rows that are not negative; scalings are ``(w, lam)``, ``W = diag(w)``."""

    A: Matrix
    b: Vector
    places: IntArray
    unit: Vector
    columns: IntArray
    """Variables that the rows have."""

    def entries(self, s: Matrix) -> Matrix:
        return s

    @property
    def degree(self) -> int:
        return len(self.b)

    def scaling(self, s: Matrix, z: Matrix) -> Scaling:
        return np.sqrt(s / z), np.sqrt(s * z)

    def moved(self, scaling: Scaling, s: Matrix, z: Matrix) -> Scaling:
        return scaling[0] * np.sqrt(s / z), np.sqrt(s * z)

    def down(self, scaling: Scaling, s: Matrix) -> Matrix:
        return s / scaling[0]

    def up(self, scaling: Scaling, v: Matrix) -> Matrix:
        return v * scaling[0]

    def back(self, scaling: Scaling, v: Matrix) -> Matrix:
        return v / scaling[0]

    def product(self, u: Matrix, v: Matrix) -> Matrix:
        return u * v

    def divided(self, scaling: Scaling, v: Matrix) -> Matrix:
        return v / scaling[-1]

    def beyond(self, scaling: Scaling, v: Matrix) -> Vector:
        return np.asarray((-v / scaling[-1]).max(axis=1))

    def least(self, s: Matrix) -> Vector:
        return np.asarray(s.min(axis=1))

    def add_curvature(self, H: Array, scaling: Scaling) -> None:
        rows = self.A[:, self.columns] / scaling[0][:, :, None]
        H[:, self.columns[:, None], self.columns] += rows.transpose(0, 2, 1) @ rows


@dataclass(frozen=True, slots=True, eq=False)
class _Semidefinite:
    """Positive semidefinite matrices of one order; scalings are ``(R, Q, lam)``.

    ``W^-T s`` is ``Q^T S Q`` with ``Q^T R = 1``, and ``lam`` is diagonal.

    Parameters
    ----------
    A : ndarray, shape (matrices order^2, variables)
    b : ndarray, shape (matrices order^2,)
    order : int
    columns : ndarray of int, shape (matrices, coefficients)
        Variables of each matrix.
    coefficients : ndarray, shape (matrices, coefficients, order, order)
    """

    A: Matrix
    b: Vector
    places: IntArray
    unit: Vector
    order: int
    columns: IntArray
    coefficients: Array

    def entries(self, s: Matrix) -> Matrix:
        return svec(self._matrices(s)).reshape(len(s), -1)

    @property
    def degree(self) -> int:
        return len(self.columns) * self.order

    def _matrices(self, s: Matrix) -> Array:
        return s.reshape(len(s), len(self.columns), self.order, self.order)

    def scaling(self, s: Matrix, z: Matrix) -> Scaling:
        roots = _roots(self._matrices(s)), _roots(self._matrices(z))
        return self._balanced(*roots, *roots)

    def _balanced(self, of_s: Array, of_z: Array, R: Array, Q: Array) -> Scaling:
        # Singular values are alike near the central path: squares lose no digits.
        both = of_z.swapaxes(-1, -2) @ of_s
        squares, V = np.linalg.eigh(both.swapaxes(-1, -2) @ both)
        lam = np.sqrt(np.maximum(squares, np.finfo(float).tiny))
        turn = V / np.sqrt(lam)[..., None, :]
        diagonal = lam[..., None] * np.eye(self.order)
        R, Q = R @ turn, Q @ (both @ turn / lam[..., None, :])
        return R, Q, diagonal.reshape(len(lam), -1)

    def moved(self, scaling: Scaling, s: Matrix, z: Matrix) -> Scaling:
        R, Q, _ = scaling
        of_s, of_z = _roots(self._matrices(s)), _roots(self._matrices(z))
        return self._balanced(of_s, of_z, R @ of_s, Q @ of_z)

    def _between(self, left: Array, s: Matrix) -> Matrix:
        found = left @ self._matrices(s) @ left.swapaxes(-1, -2)
        return found.reshape(s.shape)

    def down(self, scaling: Scaling, s: Matrix) -> Matrix:
        return self._between(scaling[1].swapaxes(-1, -2), s)

    def up(self, scaling: Scaling, v: Matrix) -> Matrix:
        return self._between(scaling[0], v)

    def back(self, scaling: Scaling, v: Matrix) -> Matrix:
        return self._between(scaling[1], v)

    def product(self, u: Matrix, v: Matrix) -> Matrix:
        found = self._matrices(u) @ self._matrices(v)
        return (0.5 * (found + found.swapaxes(-1, -2))).reshape(u.shape)

    def _diagonal(self, scaling: Scaling) -> Array:
        return self._matrices(scaling[-1]).diagonal(axis1=-2, axis2=-1)

    def divided(self, scaling: Scaling, v: Matrix) -> Matrix:
        lam = self._diagonal(scaling)
        sums = lam[..., None, :] + lam[..., None]
        return (2.0 * self._matrices(v) / sums).reshape(v.shape)

    def beyond(self, scaling: Scaling, v: Matrix) -> Vector:
        turn = 1.0 / np.sqrt(self._diagonal(scaling))
        scaled = self._matrices(v) * turn[..., None, :] * turn[..., None]
        return np.asarray(-np.linalg.eigvalsh(scaled)[..., 0].min(axis=1))

    def least(self, s: Matrix) -> Vector:
        return np.asarray(np.linalg.eigvalsh(self._matrices(s))[..., 0].min(axis=1))

    def add_curvature(self, H: Array, scaling: Scaling) -> None:
        Q = scaling[1][:, :, None]
        scaled = Q.swapaxes(-1, -2) @ self.coefficients @ Q
        rows = scaled.reshape(*scaled.shape[:3], -1)
        added = rows @ rows.swapaxes(-1, -2)
        for place, columns in enumerate(self.columns):
            H[:, columns[:, None], columns] += added[:, place]


def _roots(S: Array) -> Array:
    """Return ``L`` with ``L L^T = S`` for positive definite matrices."""
    try:
        return np.asarray(np.linalg.cholesky(S))
    except np.linalg.LinAlgError:  # one of them has a number of the size of rounding
        values, vectors = np.linalg.eigh(S)
        floor = np.finfo(float).eps * values[..., -1:]
        return np.asarray(vectors * np.sqrt(np.maximum(values, floor))[..., None, :])


def cones_of(rows: Sequence[ConeRows]) -> list[Cone]:
    """Return the cones of rows, of which there is no second-order one.

    Equalities are left out.
    """
    found, first = list[Cone](), 0
    for block in rows:
        places = first + np.arange(len(block.b))
        first += len(block.b)
        if block.kind == "nonnegative" and len(block.b):
            columns = np.flatnonzero(block.A.any(axis=0))
            unit = np.ones(len(block.b))
            found.append(_Orthant(block.A, block.b, places, unit, columns))
        elif block.kind == "semidefinite" and block.orders:
            found += _semidefinite(block, places)
    return found


def _semidefinite(block: ConeRows, places: IntArray) -> list[Cone]:
    """Return stacked matrices, those of one order and number of variables together."""
    ends = np.cumsum(lengths(block.orders))[:-1]
    parts = (np.split(each, ends) for each in (block.A, block.b, places))
    alike: dict[tuple[int, int], list[tuple[Matrix, Vector, IntArray]]] = {}
    for order, A, b, at in zip(block.orders, *parts, strict=True):
        alike.setdefault((order, int(A.any(axis=0).sum())), []).append((A, b, at))
    return [
        _Semidefinite(
            np.vstack([smat(A.T).reshape(A.shape[1], -1).T for A, _, _ in members]),
            np.concatenate([smat(b).ravel() for _, b, _ in members]),
            np.concatenate([at for _, _, at in members]),
            np.tile(np.eye(order).ravel(), len(members)),
            order,
            np.array([np.flatnonzero(A.any(axis=0)) for A, _, _ in members]),
            np.array([smat(A[:, A.any(axis=0)].T) for A, _, _ in members]),
        )
        for (order, _), members in alike.items()
    ]
