"""The zero-phase Butterworth filter, without the import of all of scipy.signal.

That import takes longer than most commands take for their own work.
"""

from collections.abc import Iterator

import numpy as np

from consistent_id._support.arrays import Array, Matrix

_FORGOTTEN = 1e-22
"""Of a filter's start, relative.  Digits of a float end at 1e-16; the rest is margin
for sections in series (up to 1e4 for an order of 8), whatever the cut-off."""


def zero_phase(
    values: Array, *, cutoff: float, rate: float, order: int, pad: int
) -> Matrix:
    """Return columns filtered forwards and backwards by a low-pass Butterworth filter.

    As ``scipy.signal.sosfiltfilt`` does: ends are continued oddly, and the filter
    starts as if its first input had been there for ever.

    Parameters
    ----------
    values : ndarray, shape (samples, columns)
    cutoff, rate : float, [Hz]
        Cut-off, at which the attenuation is 6 dB, and rate of sampling.
    order : int
        Of the one-way filter.
    pad : int
        Samples by which either end is continued, fewer than there are.
    """
    before = 2.0 * values[0] - values[pad:0:-1]
    after = 2.0 * values[-1] - values[-2 : -pad - 2 : -1]
    padded = np.concatenate([before, values, after])
    sections = list(_sections(order, np.tan(np.pi * cutoff / rate)))
    for _ in range(2):  # forwards, then backwards
        padded = _filtered(padded, sections)[::-1]
    return padded[pad : len(padded) - pad]


def settling(*, cutoff: float, rate: float, order: int) -> int:
    """Return the samples after which the filter has forgotten where it began.

    What is left then of any start is `_FORGOTTEN` of it: the slowest pole ``p`` fades
    as ``|p|^n``.  Sections in series fade more slowly by a factor that the margin of
    `_FORGOTTEN` to the digits of a float covers.

    Examples
    --------
    >>> settling(cutoff=5.0, rate=1000.0, order=4)
    4216
    """
    damping = np.sin(np.pi / (2 * order)) if order > 1 else 1.0
    w = np.tan(np.pi * cutoff / rate)
    # Of z^2 (1 + d w + w^2) + ... + (1 - d w + w^2): the product of both poles.
    d = 2.0 * damping
    squared = (1.0 - d * w + w**2) / (1.0 + d * w + w**2)
    return int(np.ceil(np.log(_FORGOTTEN) / (0.5 * np.log(squared)))) + 1


def _sections(order: int, w: float) -> Iterator[tuple[float, Array, Array]]:
    """Yield gain, numerator and denominator of each section, in powers of 1/z.

    ``w^2 / (s^2 + d w s + w^2)`` for each pair of poles, and ``w / (s + w)`` for the
    last pole of an odd order, with ``s = (z - 1) / (z + 1)``.
    """
    for pair in range(order // 2):
        d = 2.0 * np.sin(np.pi * (2 * pair + 1) / (2 * order))
        a = np.array([1.0 + d * w + w**2, 2.0 * (w**2 - 1.0), 1.0 - d * w + w**2])
        yield w**2 / a[0], np.array([1.0, 2.0, 1.0]), a / a[0]
    if order % 2:
        yield w / (1.0 + w), np.array([1.0, 1.0]), np.array([1.0, (w - 1) / (1 + w)])


def _filtered(values: Matrix, sections: list[tuple[float, Array, Array]]) -> Matrix:
    """Return one pass; each section's recursion is a banded triangular system."""
    from scipy.linalg.lapack import dtbtrs

    first = values[0]
    y = np.asfortranarray(values - first)
    for gain, b, a in sections:
        x = gain * y
        y = b[0] * x
        for lag in range(1, len(b)):
            y[lag:] += b[lag] * x[:-lag]
        band = np.repeat(a[:, None], len(y), axis=1)
        y, _ = dtbtrs(band, y, uplo="L", diag="U", overwrite_b=1)
    return np.asarray(y + first)
