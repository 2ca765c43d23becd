"""Limits of position, velocity, acceleration and jerk as linear rows.

A real trigonometric polynomial of degree ``H`` that stays within 1 at ``N > 2 H``
equidistant points of its period stays within ``1 / cos(pi H / N)`` everywhere
[EhlichZeller1964]_.  A programme is given rows at few points, since each costs time; a
path is then measured at many, and made smaller by what it may exceed its limits by.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from consistent_id._arrays import Array, Matrix, Vector
from consistent_id.excitation.basis import FourierBasis

_COARSE = 12  # points per period of the highest frequency, for the programme
_FINE = 32  # for measuring: the bound is then within 0.5 % of the extreme
_LONGEST = 20_000  # points; beyond, the proof after the search must do


@dataclass(frozen=True, slots=True, eq=False)
class LimitRows:
    """Limits of Fourier paths, in shares: ``|value / limit| <= 1``.

    Parameters
    ----------
    basis : FourierBasis
    matrix : scipy.sparse.csr_array, shape (rows, variables)
        At few points, on the flattened variables: ``-1 <= A x <= 1``.
    time : ndarray, shape (samples,), [s]
        At many points.
    excess : float
        Factor by which a path may exceed, between them, what it reaches at them.
    """

    basis: FourierBasis
    matrix: Any
    time: Vector
    excess: float

    def largest(self, variables: Matrix) -> Vector:
        """Return the largest share of a limit that each joint uses at any time."""
        motion = self.basis.motion(variables, self.time, derivatives=3)
        motion[0] -= self.basis.limits.middle
        extremes = abs(motion).max(axis=1)
        limits = np.array([self.basis.limits.derivative(order) for order in range(4)])
        return np.asarray((extremes / limits).max(axis=0) * self.excess)

    def within(self, variables: Matrix) -> Matrix:
        """Return the path with the joints that exceed a limit moving less."""
        return np.asarray(variables / np.maximum(1.0, self.largest(variables)))


def limit_rows(basis: FourierBasis, period: float | None) -> LimitRows:
    """Return the rows of all finite limits.

    Parameters
    ----------
    basis : FourierBasis
    period : float, optional, [s]
        After which its paths repeat; None if they do not.
    """
    coarse, _ = _points(basis, period, _COARSE)
    fine, excess = _points(basis, period, _FINE)
    return LimitRows(basis, _matrix(basis, coarse), fine, excess)


def _matrix(basis: FourierBasis, time: Vector) -> Any:
    from scipy import sparse

    joints = len(basis.unit)
    blocks = []
    for order in range(4):
        limits = basis.limits.derivative(order)
        columns = basis.columns(order, time)
        for j in np.flatnonzero(np.isfinite(limits)):
            row: Array = np.zeros((len(time), basis.size))
            row[:, 1:] = columns * (basis.unit[j] / limits[j])
            row[:, 0] = float(order == 0)
            place = sparse.csr_array(([1.0], ([0], [j])), shape=(1, joints))
            blocks.append(sparse.kron(row, place, format="csr"))
    return sparse.vstack(blocks, format="csr")


def _points(
    basis: FourierBasis, period: float | None, density: int
) -> tuple[Vector, float]:
    """Return times, and the factor that a path may exceed them by in between."""
    span = basis.duration if period is None else period
    degree = max(1, round(basis.frequencies[-1] * span))
    count = density * degree
    if period is None or count > _LONGEST:
        count = min(count, _LONGEST)
        return np.linspace(0.0, basis.duration, count), 1.0
    return np.arange(count) * period / count, 1.0 / float(np.cos(np.pi / density))
