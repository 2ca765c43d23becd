"""Least squares whose standard errors come from leaving segments out.

Misfits of a model that is not quite right are neither white nor of one size.  How far
each segment of the log pulls the estimate shows how sure it is.  The plain sandwich
takes the misfit that is left, which is too small where there are as many parameters as
segments; the jackknife takes the misfit that the fit of the other segments leaves.

Of a motion that repeats itself a segment is a phase, in all periods: errors of the
model repeat as well, and no period would miss another.

Segments are compressed once, and columns that all fits share are eliminated once; fits
of many choices of the other columns then cost next to nothing.
"""

from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.regression.linear import column_sizes, smallest_solution
from consistent_id.regression.regression import triangle

_SEGMENTS = 20
RANK = 1e-6  # of the largest singular value, of unit columns
_LOST = 1e-6  # squared share in the null space from which a parameter is lost
_TINY = 1e-300  # instead of an error of zero, by which one could not divide


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A solution, its standard errors, and the misfit it leaves.

    Parameters
    ----------
    solution : ndarray, shape (columns,)
    errors : ndarray, shape (columns,)
        Infinite where the data do not determine it.
    misfit : float
        Norm of ``A x - z``.
    """

    solution: Vector
    errors: Vector
    misfit: float


@dataclass(frozen=True, slots=True, eq=False)
class Jackknife:
    """Factors of ``[A, z]``: of all segments, and of all but one.

    Parameters
    ----------
    whole : ndarray, shape (rows, columns + 1)
    others : tuple of ndarray, each shape (rows, columns + 1)
    """

    whole: Matrix
    others: tuple[Matrix, ...]

    def fitted(self, columns: list[int]) -> Fitted:
        """Solve ``A x = z`` for some columns in the least-squares sense.

        With ``x_g`` the solution without segment ``g`` of ``G``, the standard errors
        are the roots of ``(G - 1) / G sum_g (x_g - x)^2``.
        """
        A, z = self.whole[:, columns], self.whole[:, -1]
        _, s, Vt = np.linalg.svd(A / column_sizes(A), full_matrices=False)
        kept = Vt[s > RANK * s.max(initial=0.0)]
        x = smallest_solution(A, z, RANK)
        moves = [
            smallest_solution(F[:, columns], F[:, -1], RANK) - x for F in self.others
        ]
        share = (len(moves) - 1) / len(moves)
        errors = np.sqrt(share * np.sum(np.square(moves), axis=0))
        lost = 1.0 - np.sum(kept**2, axis=0) > _LOST
        errors = np.where(lost, np.inf, np.maximum(errors, _TINY))
        return Fitted(x, errors, float(np.linalg.norm(z - A @ x)))

    def __add__(self, other: "Jackknife") -> "Jackknife":
        """Return the factors of both together; segments are left out in pairs."""
        others = map(_factor, self.others, other.others)
        return Jackknife(_factor(self.whole, other.whole), tuple(others))

    def without(self, count: int) -> "Jackknife":
        """Eliminate the first columns: what is left is orthogonal to them.

        Columns of which nothing is left beyond rounding become zero.
        """
        kept, rest = _independent(self.whole[:, :count]), self.whole[:, count:]
        rank = len(kept)
        eliminated = [
            _factor(np.column_stack([F[:, kept], F[:, count:]]))[rank:, rank:]
            for F in (self.whole, *self.others)
        ]
        sizes = np.linalg.norm(rest, axis=0)
        left = np.linalg.norm(eliminated[0], axis=0) > RANK * sizes
        left[-1] = True
        whole, *others = (F * left for F in eliminated)
        return Jackknife(whole, tuple(others))


def jackknife(A: Array, z: Matrix, phase: Vector | None = None) -> Jackknife:
    """Compress segments, and all but one of them.

    Parameters
    ----------
    A : ndarray, shape (joints, samples, columns)
    z : ndarray, shape (joints, samples)
    phase : ndarray, shape (samples,), optional
        In the order of which samples are cut into segments; by default as they come.
    """
    rows = np.concatenate([A, z[:, :, None]], axis=2)
    order = np.arange(rows.shape[1]) if phase is None else np.argsort(phase)
    cuts = [c for c in np.array_split(order, _SEGMENTS) if len(c)]
    parts = [_factor(rows[:, c].reshape(-1, rows.shape[2])) for c in cuts]
    none = np.zeros((0, rows.shape[2]))
    before = list(accumulate(parts, _factor, initial=none))
    after = list(accumulate(parts[::-1], _factor, initial=none))[::-1]
    others = tuple(map(_factor, before[:-1], after[1:]))
    return Jackknife(before[-1], others)


def _factor(*rows: Matrix) -> Matrix:
    return triangle(np.asfortranarray(np.vstack(rows)))


def _independent(columns: Matrix) -> list[int]:
    """Return columns that span all of them."""
    from scipy.linalg import qr

    R, order = qr(columns / column_sizes(columns), mode="r", pivoting=True)
    size = abs(np.diag(R))
    rank = int((size > RANK * size.max(initial=0.0)).sum())
    return sorted(int(i) for i in order[:rank])
