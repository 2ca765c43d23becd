"""Limits of position, velocity, acceleration and jerk as linear rows.

A real trigonometric polynomial of degree ``H`` that stays within 1 at ``N > 2 H``
equidistant points of its period stays within ``1 / cos(pi H / N)`` everywhere
[EhlichZeller1964]_.  A programme is given rows at few points, since each costs time; a
path is then measured at many, and made smaller by what it may exceed its limits by.

Paths that do not repeat while they are played are bounded by Taylor's formula instead:
at an extreme the slope is zero, so that the nearest of samples ``h`` apart misses it by
``h^2 / 8 max |f''|`` at most.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.excitation.basis import FourierBasis
from consistent_id.motion.proofs.grids import between_samples

_COARSE = 12  # points per period of the highest frequency, for the programme
_FINE = 32  # for measuring: the bound is then within 0.5 % of the extreme
_FINER = 64  # the same for paths that do not repeat
_LONGEST = 20_000  # points


@dataclass(frozen=True, slots=True, eq=False)
class LimitRows:
    """Limits of Fourier paths, in shares: ``|value / limit| <= 1``.

    Parameters
    ----------
    matrix : scipy.sparse.csr_array, shape (rows, variables)
        At few points, on the flattened variables: ``-1 <= A x <= 1``.
    time : ndarray, shape (samples,), [s]
        At many points.
    excess : float
        Factor by which a path may exceed, between them, what it reaches at them.
    step : float, [s]
        Between them, for paths that do not repeat while they are played; else 0.
    """

    basis: FourierBasis
    matrix: Any
    time: Vector
    excess: float
    step: float

    def largest(self, variables: Matrix) -> Vector:
        """Return the largest share of a limit that each joint uses at any time."""
        motion = self.basis.motion(variables, self.time, derivatives=3)
        motion[0] -= self.basis.limits.middle
        extremes = abs(motion).max(axis=1)
        if self.step:
            path = self.basis.trajectory(variables)
            bend = np.array([path.derivative_bound(order + 2) for order in range(4)])
            extremes += self.step**2 / 8.0 * bend
        limits = np.array([self.basis.limits.derivative(order) for order in range(4)])
        return np.asarray((extremes / limits).max(axis=0) * self.excess)

    @property
    def fine(self) -> Any:
        """Rows as `matrix`, at the many points, and so that nothing lies between."""
        return self.excess * _matrix(self.basis, self.time)

    def within(self, variables: Matrix) -> Matrix:
        """Return the path with the joints that exceed a limit moving less."""
        return np.asarray(variables / np.maximum(1.0, self.largest(variables)))


def limit_rows(basis: FourierBasis, period: float | None) -> LimitRows:
    """Return the rows of all finite limits.

    Parameters
    ----------
    period : float, optional, [s]
        After which its paths repeat; None if they do not.
    """
    repeats = period is not None and period <= basis.duration * (1.0 + 1e-9)
    if period is None or not repeats:
        fine = _interval(basis, _FINER)
        step = float(fine[1] - fine[0])
        return LimitRows(
            basis, _matrix(basis, _interval(basis, _COARSE)), fine, 1.0, step
        )
    coarse, fine = (_cycle(basis, period, density) for density in (_COARSE, _FINE))
    degree = round(basis.frequencies[-1] * period)
    excess = between_samples(degree, len(fine))
    return LimitRows(basis, _matrix(basis, coarse), fine, excess, 0.0)


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


def _cycle(basis: FourierBasis, period: float, density: int) -> Vector:
    """Return times of one period, its end left out."""
    degree = max(1, round(basis.frequencies[-1] * period))
    count = max(min(density * degree, _LONGEST), 2 * degree + 1)
    return np.asarray(np.arange(count) * period / count)


def _interval(basis: FourierBasis, density: int) -> Vector:
    """Return times from start to end."""
    cycles = basis.frequencies[-1] * basis.duration
    count = min(max(2, int(np.ceil(density * cycles)) + 1), _LONGEST)
    return np.linspace(0.0, basis.duration, count)
