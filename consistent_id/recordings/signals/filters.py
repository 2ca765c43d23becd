"""Zero-phase filters, on motion and torque alike.

The Butterworth filter is our own: the import of all of scipy.signal takes longer than
most commands take for their own work.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from consistent_id._support.arrays import Array, Matrix
from consistent_id._support.given_values import require_type
from consistent_id.errors import RecordingError
from consistent_id.recordings.beside import BaseMotion
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import uniform_rate
from consistent_id.recordings.signals.filtered_rows import (
    altered,
    require_filter,
    torque_filtered,
)

_MOTION = ("position", "velocity", "acceleration")
DECIMATION_ORDER = 8  # of the filter against aliasing
_LOWEST = 1e-5  # cut-off over sampling rate

_ENDS = 1.0  # periods of the cut-off whose motion tells how an end is bent
_FEWEST = 8  # samples that tell it
_SURE = 3.0  # standard errors

_FORGOTTEN = 1e-22
"""Relative effect of a filter's start that counts as none.  Digits of a float end at
1e-16; the rest is margin for sections in series (up to 1e4 for an order of 8), whatever
the cut-off.
"""


def low_passed(
    recording: Recording,
    *,
    motion_cutoff: float | None = None,
    torque_cutoff: float | None = None,
    order: int = 4,
) -> Recording:
    """Filter with a zero-phase Butterworth filter.

    Motion is filtered forwards and backwards; at both ends, the motion of one period of
    the cut-off tells how it goes on, so that acceleration is kept.  Torque passes the
    same filter as a kernel, and the recording keeps its torque from before, so that
    `build_regression` can filter its rows like the torque: ``F Y x = F tau`` holds
    exactly, also where friction jumps.

    Parameters
    ----------
    recording : Recording
        Uniformly sampled.
    motion_cutoff, torque_cutoff : float, optional, [Hz]
        Cut-off of position, velocity and acceleration, also of a base, and of torque
        and wrenches; none to leave them as they are.
    order : int
        Order of the one-way filter; the attenuation at the cut-off is 6 dB.

    Raises
    ------
    RecordingError
        If the clock is not uniform or a cut-off is not below half the sampling rate.

    Examples
    --------
    >>> import consistent_id as ci
    >>> time = np.arange(200) / 100
    >>> log = ci.Recording(("elbow",), time, np.sin(time)[:, None])
    >>> smooth = ci.low_passed(log, motion_cutoff=5.0)
    >>> bool(abs(smooth.position - log.position)[50:150].max() < 1e-3)
    True
    """
    require_type(recording, Recording, "recording")
    behind = recording.torque_filter
    rate = uniform_rate(recording if behind is None else behind.source)
    if not isinstance(order, int) or order < 1:
        raise RecordingError(f"filter order is {order!r}, expected 1, 2, 3, ...")
    for cutoff in (motion_cutoff, torque_cutoff):
        if cutoff is not None and not _LOWEST * rate <= cutoff < rate / 2:
            raise RecordingError(
                f"{recording.name}: cut-off {cutoff:g} Hz, expected between "
                f"{_LOWEST * rate:.2g} Hz (below, the filter loses its digits; "
                f"decimate first) and half of the sampling rate, {rate / 2:.6g} Hz"
            )
    if motion_cutoff is not None:
        moved = partial(_motion_filtered, cutoff=motion_cutoff, order=order)
        recording = altered(recording, moved)
    has_torque = recording.torque is not None or recording.wrenches
    if torque_cutoff is not None and has_torque:
        recording = torque_filtered(recording, torque_cutoff, order)
    return recording


def _motion_filtered(recording: Recording, cutoff: float, order: int) -> Recording:
    """Return a recording with filtered motion of joints and base.

    Channels of the base are filtered in its own axes; its rotation, from which only the
    direction of forces is taken, is not.
    """
    rate = uniform_rate(recording)

    def smooth(values: Matrix) -> Matrix:
        pad = min(len(values) - 1, int(3 * order * rate / cutoff))
        few = max(int(_ENDS * rate / cutoff) + 1, _FEWEST)
        ends = values[:few], values[::-1][:few]
        bends = [_bend(end) if 2 * few <= len(values) else 0.0 for end in ends]
        padded = _continued(values, pad, bends)
        return _both_ways(padded, cutoff / rate, order)[pad : pad + len(values)]

    channels = {
        channel: smooth(values)
        for channel in _MOTION
        if (values := getattr(recording, channel)) is not None
    }
    base = recording.base
    if base is not None:
        w, dw, felt = np.split(smooth(base.stacked), 3, axis=1)
        base = BaseMotion(w, dw, felt, base.rotation)
    return replace(recording, base=base, **channels)  # type: ignore[arg-type]


def _bend(values: Matrix) -> Array:
    """Return half of the second difference at the first sample, by a cubic.

    The more of it is noise, the smaller it is made: within `_SURE` standard errors of
    the fit, it is less than half.
    """
    powers = np.linspace(0.0, 1.0, len(values))[:, None] ** np.arange(4)
    inverse = np.linalg.pinv(powers)
    rise = values - values[0]  # exactly zero while nothing moves
    bend = (inverse @ rise)[2]
    variance = np.sum((rise - powers @ (inverse @ rise)) ** 2, axis=0)
    variance *= inverse[2] @ inverse[2] / (len(values) - 4)
    whole = bend**2 + _SURE**2 * variance
    share = np.divide(bend**2, whole, out=np.zeros_like(bend), where=whole > 0.0)
    return np.asarray(share * bend / (len(values) - 1) ** 2)


def decimated(recording: Recording, factor: int) -> Recording:
    """Keep every `factor`-th sample, without aliasing.

    Torque passes a zero-phase Butterworth filter of order 8 at 0.8 of the new Nyquist
    frequency, unless it has passed a lower one.  `build_regression` filters its rows
    alike.  Motion passes it, too, unless it has been differentiated beside a torque:
    then rows are computed before they are thinned.
    """
    if not isinstance(factor, int) or factor < 1:
        raise RecordingError(f"decimation factor is {factor!r}, expected 1, 2, 3, ...")
    if factor == 1:
        return recording
    return spaced(anti_aliased(recording, factor), factor)


def spaced(recording: Recording, factor: int) -> Recording:
    """Keep every `factor`-th sample, as it is.

    If the torque is filtered, samples are kept on a grid of the clock before the
    filter.  Samples may be missing, and with every `factor`-th one of those that are
    left, few or none would be on the grid from which `build_regression` takes rows.
    """
    behind = recording.torque_filter
    if behind is None or factor == 1:
        return recording.samples(slice(None, None, factor))
    own, places = behind.step, behind.kept + behind.first
    on_grid = np.flatnonzero(places % (own * factor) == places[0] % own)
    few = recording.samples(on_grid if len(on_grid) > 1 else slice(None, None, factor))
    behind = replace(require_filter(few), thinned=own * factor)
    return replace(few, torque_filter=behind)


def anti_aliased(recording: Recording, factor: int) -> Recording:
    """Return the recording from which `decimated` takes its samples."""
    behind = recording.torque_filter
    if behind is None:
        rate = uniform_rate(recording)
    else:
        rate = uniform_rate(behind.source) / behind.step
    cutoff = decimation_cutoff(rate, factor)
    has_torque = recording.torque is not None or recording.wrenches
    prepared = has_torque and recording.acceleration is not None
    return low_passed(
        recording,
        motion_cutoff=None if prepared else cutoff,
        torque_cutoff=cutoff,
        order=DECIMATION_ORDER,
    )


def decimation_cutoff(rate: float, factor: int) -> float:
    """Return the cut-off [Hz] of the filter against aliasing."""
    return 0.8 * rate / (2 * factor)


def settling(*, cutoff: float, rate: float, order: int) -> int:
    """Return the samples after which the filter has forgotten where it began.

    The effect of any start has then fallen to `_FORGOTTEN` of it: the slowest pole
    ``p`` fades as ``|p|^n``.  Sections in series fade more slowly by a factor that the
    margin of `_FORGOTTEN` to the digits of a float covers.

    Examples
    --------
    >>> settling(cutoff=5.0, rate=1000.0, order=4)
    4216
    """
    w = np.tan(np.pi * cutoff / rate)
    # Of z^2 (1 + d w + w^2) + ... + (1 - d w + w^2): the product of both poles.
    d = 2.0 * np.sin(np.pi / (2 * order))
    squared = (1.0 - d * w + w**2) / (1.0 + d * w + w**2)
    return int(np.ceil(np.log(_FORGOTTEN) / (0.5 * np.log(squared)))) + 1


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
        Order of the one-way filter.
    pad : int
        Samples by which either end is continued, fewer than there are.
    """
    padded = _continued(values, pad)
    return _both_ways(padded, cutoff / rate, order)[pad : pad + len(values)]


def _continued(
    values: Array, pad: int, bends: Sequence[Array | float] = (0.0, 0.0)
) -> Matrix:
    """Continue both ends: ``x(-n) = 2 x(0) - x(n) + 2 b n^2``, with `bends` ``b``.

    With zero, the continuation is odd, and has no second derivative at the end.
    """
    squares = 2.0 * np.arange(1.0, pad + 1)[:, None] ** 2
    before = 2.0 * values[0] - values[pad:0:-1] + squares[::-1] * bends[0]
    after = 2.0 * values[-1] - values[-2 : -pad - 2 : -1] + squares * bends[1]
    return np.concatenate([before, values, after])


def _both_ways(padded: Matrix, cutoff: float, order: int) -> Matrix:
    """Filter forwards and backwards; the cut-off is stated over the rate."""
    sections = list(_sections(order, np.tan(np.pi * cutoff)))
    for _ in range(2):
        padded = _one_pass(padded, sections)[::-1]
    return padded


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


def _one_pass(values: Matrix, sections: list[tuple[float, Array, Array]]) -> Matrix:
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
