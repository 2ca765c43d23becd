"""The quintic spline of uniform samples, without the import of scipy.interpolate."""

from dataclasses import dataclass
from math import comb, factorial, perm

import numpy as np

from consistent_id._support.arrays import Matrix, Vector

_K = 5  # degree
_MIDDLE = np.array([1.0, 26.0, 66.0, 26.0, 1.0]) / 120.0  # the B-spline at its knots


@dataclass(frozen=True, slots=True, eq=False)
class UniformSpline:
    """A spline of degree five with four continuous derivatives.

    Beyond the ends it goes on with the samples at them turned about the last one, so
    that a few samples away from the ends it is as any other quintic spline.

    Parameters
    ----------
    start, step : float, [s]
        Of the samples' clock.
    weights : ndarray, shape (samples + 4, columns)
        Of B-splines, the first of which is centred two steps before the start.
    """

    start: float
    step: float
    weights: Matrix

    @classmethod
    def through(cls, time: Vector, values: Matrix) -> "UniformSpline":
        """Return the spline through samples on a uniform clock.

        Parameters
        ----------
        time : ndarray, shape (samples,)
        values : ndarray, shape (samples, columns)
            Five or more.
        """
        from scipy.linalg import solve_banded

        padded = np.pad(values, ((2, 2), (0, 0)), "reflect", reflect_type="odd")
        bands = np.repeat(_MIDDLE[:, None], len(padded), axis=1)
        weights = solve_banded((2, 2), bands, padded)
        step = float(time[-1] - time[0]) / (len(time) - 1)
        return cls(float(time[0]), step, weights)

    def at(self, time: Vector, derivative: int = 0) -> Matrix:
        """Return values or a derivative, shape (instants, columns).

        Parameters
        ----------
        time : ndarray, shape (instants,)
            Between the first sample and the last.
        derivative : int
        """
        place = (time - self.start) / self.step
        whole = np.clip(np.floor(place), 0, len(self.weights) - _K - 1)
        powers = np.vander(place - whole, _K + 1, increasing=True)
        pieces = powers @ _pieces(derivative) / self.step**derivative
        first = whole.astype(np.intp)
        return np.asarray(
            sum(pieces[:, [i]] * self.weights[first + i] for i in range(_K + 1))
        )


def _pieces(derivative: int) -> Matrix:
    """Return the polynomials of the six B-splines on one step, shape (powers, 6).

    B-spline ``i`` of those that are not zero there is ``sum_j (-1)^j C(6, j)
    (t + 5 - i - j)^5 / 5!`` over ``j <= 5 - i``.
    """
    found = np.zeros((_K + 1, _K + 1))
    for i in range(_K + 1):
        for j in range(_K + 1 - i):
            for p in range(derivative, _K + 1):
                power = comb(_K, p) * float(_K - i - j) ** (_K - p)
                sign = (-1) ** j * comb(_K + 1, j) / factorial(_K)
                found[p - derivative, i] += sign * power * perm(p, derivative)
    return found
