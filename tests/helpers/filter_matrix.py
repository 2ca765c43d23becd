"""The zero-phase Butterworth filter as a matrix, by another way than the library's."""

import numpy as np
from scipy import signal


def filter_matrix(samples, cutoff, order, reach, *, squared=False):
    """Return the filter of `samples` rows, their ends reflected.

    The kernel is the autocorrelation of the one-way filter's impulse response, cut off
    at `reach` and scaled to the sum one.  `cutoff` is over the sampling rate.
    """
    sections = signal.butter(order, 2.0 * cutoff, output="sos")
    impulse = np.zeros(20 * reach + 1)
    impulse[0] = 1.0
    response = signal.sosfilt(sections, impulse)
    both = signal.fftconvolve(response, response[::-1])
    middle = len(response) - 1
    h = both[middle - reach : middle + reach + 1]
    h = h / h.sum()
    if squared:
        h = h**2 / np.sum(h**2)
    F = np.zeros((samples, samples))
    mirrored = np.r_[np.arange(samples), np.arange(samples)[::-1]]
    for i in range(samples):
        places = mirrored[np.arange(i - reach, i + reach + 1) % (2 * samples)]
        np.add.at(F[i], places, h)
    return F
