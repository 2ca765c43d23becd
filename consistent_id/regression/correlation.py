"""Samples that carry as much information as one independent sample.

The mean of ``n`` samples of noise whose autocorrelation is ``rho`` scatters as that of
``n / (1 + 2 sum_k rho_k)`` independent ones; so do parameters whose columns of the
regressor change slowly beside the noise.  The sum ends where the estimated ``rho``
first falls below zero: what comes later is chance [Sokal1997]_.  Filtered torque, and
friction that is not what the model says, have residuals that go on for many samples.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Vector

_MOST_SPENT = 0.5
"""Largest share of a joint's effective samples that is given back for the fit: beyond
it there are hardly more independent samples than parameters, and no estimate is good.
"""

_WINDOW = 2**16
"""Samples whose autocorrelation is found at a time; pairs across windows are left out,
which are few beside noise of up to a thousand samples."""

_EXACT = 1e-3  # residual, relative to the least noise, that is rounding alone


def correlation_length(residuals: Sequence[Vector], sigma: Vector) -> float:
    """Return how many samples carry as much information as one independent sample.

    The mean over joints of `correlation_lengths`, by their share of the misfit, each
    `residuals` being one joint's.
    """
    lengths = [float(correlation_lengths([r[:, None]])[0]) for r in residuals]
    weights = [float(r @ r) / s**2 for r, s in zip(residuals, sigma, strict=True)]
    return float(np.average(lengths, weights=weights)) if any(weights) else 1.0


def correlation_lengths(
    residuals: Sequence[Array], *, spent: ArrayLike = 0.0, noise: ArrayLike = 0.0
) -> Vector:
    """Return each joint's ``1 + 2 sum_k rho_k``, at least one.

    Autocovariances of several recordings add.  A fit takes from the residuals what its
    parameters can follow: of the variance of ``n`` samples the share
    ``d = length p / n``, if it spends ``p`` degrees of freedom on a joint, and all of
    it is slow.  So ``rho_k = (1 - d) rho_k(residuals) + d``, until length and share
    agree.

    Parameters
    ----------
    residuals : sequence of ndarray, each shape (samples, joints)
        One for each recording, at equal steps.
    spent : array_like, shape (joints,) or ()
        Degrees of freedom that the fit takes from each joint.
    noise : array_like, shape (joints,) or (), optional
        Least level of noise worth the name: residuals far below it are rounding.

    Returns
    -------
    ndarray, shape (joints,)
    """
    joints = residuals[0].shape[1]
    counts = sum(np.count_nonzero(r, axis=0) for r in residuals)
    spent, noise = np.broadcast_to(spent, joints), np.broadcast_to(noise, joints)
    lengths = np.ones(joints)
    for j in range(joints):
        sums = _autocovariance([r[:, j] for r in residuals])
        if counts[j] == 0 or sums[0] <= counts[j] * (_EXACT * noise[j]) ** 2:
            continue
        rho = sums / sums[0]
        stop = int(np.argmax(rho < 0.0)) if (rho < 0.0).any() else len(rho)
        lengths[j] = _length(rho[1:stop], float(spent[j]) / float(counts[j]))
    return lengths


def _length(rho: Vector, spent: float) -> float:
    """Return the length at which it and the share that the fit has taken agree."""
    total, lags = float(rho.sum()), len(rho)
    length = max(1.0 + 2.0 * total, 1.0)
    for _ in range(50):
        d = min(length * spent, _MOST_SPENT)
        new = max(1.0 + 2.0 * ((1.0 - d) * total + d * lags), 1.0)
        if abs(new - length) <= 1e-6 * length:
            break
        length = new
    return length


def _autocovariance(series: Sequence[Vector]) -> Vector:
    """Return ``sum_t r_t r_(t+k)`` by lag, summed over recordings and windows."""
    pieces = [
        r[first : first + _WINDOW]
        for r in series
        for first in range(0, len(r), _WINDOW)
    ]
    sums = np.zeros(max(len(piece) for piece in pieces))
    for piece in pieces:
        size = 2 ** int(np.ceil(np.log2(2 * len(piece))))
        power = abs(np.fft.rfft(piece, size)) ** 2
        sums[: len(piece)] += np.fft.irfft(power, size)[: len(piece)]
    return sums
