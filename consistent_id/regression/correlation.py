"""Samples that carry as much information as one independent sample."""

from collections.abc import Sequence

import numpy as np

from consistent_id._support.arrays import Vector


def correlation_length(residuals: Sequence[Vector], sigma: Vector) -> float:
    """Return how many samples carry as much information as one independent sample.

    ``1 + 2 sum_k rho_k`` over the lags before the residuals' autocorrelation ``rho``
    first falls below zero [Sokal1997]_; the mean over joints, by their share of the
    misfit.  Filtered torque, and friction that is not what the model says, have
    residuals that go on for many samples.
    """
    lengths, weights = [], []
    for r, s in zip(residuals, sigma, strict=True):
        size = 2 ** int(np.ceil(np.log2(2 * len(r))))
        power = abs(np.fft.rfft(r, size)) ** 2
        rho = np.fft.irfft(power, size)[: len(r)]
        energy = float(rho[0])
        rho = rho / max(energy, 1e-300)
        stop = int(np.argmax(rho < 0.0)) if (rho < 0.0).any() else len(rho)
        lengths.append(1.0 + 2.0 * float(rho[1:stop].sum()))
        weights.append(energy / s**2)
    return float(max(np.average(lengths, weights=weights), 1.0))
