"""Number of samples of residuals that carry as much information as an independent one.

The mean of ``n`` samples of noise whose autocorrelation is ``rho``
scatters as that of ``n / (1 + 2 sum_k rho_k)`` independent ones; so do parameters whose
columns of the regressor change slowly beside the noise.  The sum ends where the
estimated ``rho`` first falls below zero: what comes later is chance [Sokal1997]_.
Filtered torque, and friction that is not what the model says, have residuals that go on
for many samples.
"""

from collections.abc import Sequence

import numpy as np

from consistent_id._support.arrays import Array, Vector

_AUTOCOVARIANCE_WINDOW = 2**16
"""Samples whose autocorrelation is found at a time; pairs across windows are left out,
which are few beside noise of up to a thousand samples."""


def correlation_length(residuals: Sequence[Vector], sigma: Vector) -> float:
    """Return the number of samples with the information of one independent sample.

    The mean over joints of `correlation_lengths`, by their share of the misfit, each
    `residuals` being one joint's.
    """
    lengths = [float(correlation_lengths([r[:, None]])[0]) for r in residuals]
    weights = [float(r @ r) / s**2 for r, s in zip(residuals, sigma, strict=True)]
    return float(np.average(lengths, weights=weights)) if any(weights) else 1.0


def correlation_lengths(residuals: Sequence[Array]) -> Vector:
    """Return each joint's ``1 + 2 sum_k rho_k``, at least one.

    Autocovariances of several recordings add.

    Parameters
    ----------
    residuals : sequence of ndarray, each shape (samples, joints)
        One for each recording, at equal steps.

    Returns
    -------
    ndarray, shape (joints,)
    """
    lengths = np.ones(residuals[0].shape[1])
    for j in range(len(lengths)):
        sums = _autocovariance([r[:, j] for r in residuals])
        if sums[0] == 0.0:
            continue
        rho = sums / sums[0]
        stop = int(np.argmax(rho < 0.0)) if (rho < 0.0).any() else len(rho)
        lengths[j] = max(1.0 + 2.0 * float(rho[1:stop].sum()), 1.0)
    return lengths


def _autocovariance(series: Sequence[Vector]) -> Vector:
    """Return ``sum_t r_t r_(t+k)`` by lag, summed over recordings and windows."""
    pieces = [
        r[first : first + _AUTOCOVARIANCE_WINDOW]
        for r in series
        for first in range(0, len(r), _AUTOCOVARIANCE_WINDOW)
    ]
    sums = np.zeros(max(len(piece) for piece in pieces))
    for piece in pieces:
        size = 2 ** int(np.ceil(np.log2(2 * len(piece))))
        power = abs(np.fft.rfft(piece, size)) ** 2
        sums[: len(piece)] += np.fft.irfft(power, size)[: len(piece)]
    return sums
