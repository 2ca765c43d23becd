"""The cubic spline, without the import of scipy.interpolate and what that imports."""

import numpy as np

from consistent_id._support.arrays import Matrix, Vector


def cubic_spline(time: Vector, values: Matrix, clock: Vector) -> Matrix:
    """Return values between their stamps, with two continuous derivatives.

    As ``scipy.interpolate.CubicSpline(time, values)(clock)``: next to either end, the
    third derivative is continuous as well.

    Parameters
    ----------
    time : ndarray, shape (samples,)
        Increasing, two samples or more.
    values : ndarray, shape (samples, columns)
    clock : ndarray, shape (instants,)
        Between the first stamp and the last.
    """
    if len(time) < 4:  # one polynomial through all
        powers = np.vander(time - time[0], increasing=True)
        at = np.vander(clock - time[0], len(time), increasing=True)
        return np.asarray(at @ np.linalg.solve(powers, values))
    steps = np.diff(time)[:, None]
    chords = np.diff(values, axis=0) / steps
    slopes = _slopes(steps, chords)
    k = np.clip(np.searchsorted(time, clock, side="right") - 1, 0, len(steps) - 1)
    h, t = steps[k], (clock - time[k])[:, None]
    bend = slopes[k] + slopes[k + 1] - 2.0 * chords[k]
    square = (chords[k] - slopes[k] - bend) / h
    return np.asarray(values[k] + t * (slopes[k] + t * (square + t * bend / h**2)))


def _slopes(steps: Matrix, chords: Matrix) -> Matrix:
    """Return the slopes at the stamps, from a tridiagonal system."""
    from scipy.linalg import solve_banded

    h = steps[:, 0]
    bands = np.zeros((3, len(h) + 1))  # above the diagonal, on it, below it
    first, last = h[0] + h[1], h[-1] + h[-2]
    bands[0, 2:], bands[2, :-2] = h[:-1], h[1:]
    bands[0, 1], bands[2, -2] = first, last
    bands[1] = [h[1], *(2.0 * (h[:-1] + h[1:])), h[-2]]
    rise = np.empty((len(h) + 1, chords.shape[1]))
    rise[1:-1] = 3.0 * (steps[1:] * chords[:-1] + steps[:-1] * chords[1:])
    rise[0] = (h[0] + 2 * first) * h[1] * chords[0] + h[0] ** 2 * chords[1]
    rise[-1] = (h[-1] + 2 * last) * h[-2] * chords[-1] + h[-1] ** 2 * chords[-2]
    rise[[0, -1]] /= [[first], [last]]
    return np.asarray(solve_banded((1, 1), bands, rise))
