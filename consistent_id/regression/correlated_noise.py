"""What correlated noise does to least squares, from the spectra of its residuals.

Of noise ``e`` with the spectrum ``P(f)``, the scores ``Y^T e`` of a joint's rows have
the covariance ``sum_f P(f) y(f) y(f)^H``, ``y(f)`` being the transformed rows: noise
matters as far as it is as fast as the motion.  A fit takes the share ``h(f)``, the
leverage, of the power at each frequency; so

``P = smoothed |r(f)|^2 / smoothed (1 - h(f))``

is right on average however many parameters were fitted to however few samples.  White
noise has the same ``P`` everywhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.regression.triangles import extended, triangle

_BAND = 0.5
"""Frequencies over which a spectrum is averaged, in cube roots of the samples: six of a
thousand.  Wider bands miss that noise is strongest where robots move, at the lowest
frequencies; narrower ones scatter.  `benchmarks/coverage.py` shows what comes of it."""

_LEFT = 0.05
"""Least share of the power that a fit is taken to leave at any frequency."""


@dataclass(frozen=True, slots=True, eq=False)
class CorrelatedNoise:
    """Noise behind a regression's factors.

    Parameters
    ----------
    effective : ndarray, shape (joints,)
        Samples of white noise, of the same variance, that would determine the
        parameters as well, on average.
    scores : tuple of ndarray, each shape (rows, parameters)
        ``N_j`` with ``N_j^T N_j`` the covariance of the joint's scores ``Y_j^T e_j``.
    """

    effective: Vector
    scores: tuple[Matrix, ...]

    def share(self, part: float) -> "CorrelatedNoise":
        """Return the noise behind a part of the samples, the rest being like it."""
        root = np.sqrt(part)
        return CorrelatedNoise(
            self.effective * part, tuple(N * root for N in self.scores)
        )


def joined_noise(parts: Sequence[CorrelatedNoise]) -> CorrelatedNoise:
    """Return the noise behind several recordings, or parts of them: it adds."""
    of_joints = zip(*(part.scores for part in parts), strict=True)
    return CorrelatedNoise(
        np.sum([part.effective for part in parts], axis=0),
        tuple(_compressed(np.vstack(scores)) for scores in of_joints),
    )


@dataclass(frozen=True, slots=True, eq=False)
class JointNoise:
    """One joint's noise along one recording.

    Parameters
    ----------
    scores : ndarray, shape (rows, columns)
        Factor of the covariance of the scores.
    length : float
        How many times as large as under white noise of the same variance the variance
        of parameters is, on average.
    """

    scores: Matrix
    length: float


def spectral_noise(rows: Matrix, residual: Vector, steps: Matrix) -> JointNoise:
    """Find how noise that left a residual moves the scores of rows.

    Parameters
    ----------
    rows : ndarray, shape (samples, columns)
        At equal steps of time.
    residual : ndarray, shape (samples,), [N m or N]
    steps : ndarray, shape (columns, rank)
        ``rows @ steps`` are the joint's rows of an orthonormal basis of the fit.
    """
    n = len(rows)
    r = np.fft.rfft(residual) / np.sqrt(n)
    y = _spectra(rows) / np.sqrt(n)
    # All but the ends of half a spectrum stand for two frequencies.
    twice = np.full(len(r), 2.0)
    twice[0] = 1.0
    if n % 2 == 0:
        twice[-1] = 1.0
    # Only the norms of rows of `y @ steps` count: a triangle leaves them as they are.
    fitted = y @ triangle(np.array(steps.T, order="F")).T
    leverage = np.einsum("fr,fr->f", fitted, fitted).reshape(2, -1).sum(axis=0)
    width = int(_BAND * np.cbrt(n)) + 1
    left = np.maximum(_smoothed(1.0 - leverage, width), _LEFT)
    power = _smoothed(abs(r) ** 2, width) / left
    mean = float(np.average(power, weights=twice))
    spent = float(twice @ leverage)
    felt = float((twice * leverage) @ power)
    y *= np.tile(np.sqrt(twice * power), 2)[:, None]
    return JointNoise(
        scores=_compressed(y),
        length=felt / (spent * mean) if spent * mean > 0.0 else 1.0,
    )


def _spectra(rows: Matrix) -> Matrix:
    """Return real parts, and imaginary ones below, of each column's spectrum."""
    spectra = np.fft.rfft(rows.T, axis=1)
    return np.concatenate([spectra.real, spectra.imag], axis=1).T


def white_noise(rows: Matrix, residual: Vector) -> JointNoise:
    """Return noise with the residual's variance that is not correlated."""
    rms = float(np.sqrt(np.mean(residual**2)))
    return JointNoise(_compressed(rows * rms), 1.0)


def _smoothed(spectrum: Vector, width: int) -> Vector:
    """Return running means over `width` frequencies, reflected at both ends."""
    width = min(width, len(spectrum))
    before = (width - 1) // 2
    padded = np.pad(spectrum, (before, width - 1 - before), mode="symmetric")
    sums = np.cumsum(np.append(0.0, padded))
    return np.asarray((sums[width:] - sums[:-width]) / width)


def _compressed(rows: Matrix) -> Matrix:
    """Return the triangular factor of rows, destroying them."""
    return extended(np.zeros((0, rows.shape[1])), np.asfortranarray(rows))
