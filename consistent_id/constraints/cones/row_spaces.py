"""What the equalities of a set leave free."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix
from consistent_id.constraints.cones.sets import ConicSet

_NULL = 1e-12  # singular values below this, relative to the largest, are zero


class Equalities(NamedTuple):
    """What a set's equalities are: ``A^+``, and a basis of the steps that keep them."""

    inverse: Matrix
    steps: Matrix
    kept: IntArray | None = None
    """Parameters that the rest leaves free, where each row has one parameter alone."""

    def along(self, rows: Matrix) -> Matrix:
        """Return ``rows @ steps``."""
        return rows @ self.steps if self.kept is None else rows[:, self.kept]


@lru_cache(maxsize=16)
def equalities(domain: ConicSet) -> Equalities:
    """Return pseudo-inverse and null space of a set's equalities."""
    return row_spaces(domain.A_eq)


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
    U, s, Vt = np.linalg.svd(A)
    rank = int((s > tolerance * s.max(initial=0.0)).sum())
    return Equalities((Vt[:rank].T / s[:rank]) @ U[:, :rank].T, Vt[rank:].T)
