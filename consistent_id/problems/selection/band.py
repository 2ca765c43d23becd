"""The band in which torque is predicted, and cut-offs of the motion within it.

A first band follows from the speed of the motion: the torque of products of motions and
of friction's jumps has frequencies up to twenty times those of the velocity. This band
is too wide where position or torque are noisy. So the plain model is fitted in it and
compared with the torque at each frequency. Where it explains no part of the torque, the
torque is noise.

A narrower band has fewer independent samples: ``2 B T`` of each joint in ``T`` seconds.
``p`` parameters fitted to ``n`` samples add about ``p / n`` to the squared error of a
prediction, relative to the noise of the torque. So a band always keeps at least
`SAMPLES_PER_PARAMETER` samples for each parameter.
"""

from collections.abc import Sequence

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.problems.selection.fits import FoldFits
from consistent_id.problems.selection.samples import SampledPart
from consistent_id.recordings.recording import Recording, positions_at
from consistent_id.recordings.signals.clocks import own_rate

_BAND_POWER = 0.99  # of the velocities' power, below the band's edge
_HARMONICS = 20.0
"""Edge of the torque's band over that of the velocity.  At this frequency products of
motions and the jumps of friction have fallen to a twentieth of their size.
"""

_BAND_SHARE = 0.25  # of the sampling rate, above which nothing is predicted
_NOISE_POWER = (
    30.0  # times the median power of the upper half of the spectrum is no noise
)
_NOISE_EDGE = 0.45  # of half the sampling rate: faster parts are noise by definition
_CUTOFF_RATIOS = (0.5, 1.0, 2.0, 4.0)
"""Cut-offs of the motion over the band.  A cut-off below the band removes motion that
causes torque, but helps if the position is noisy; higher cut-offs let noise in.
"""

_HIGHEST_CUTOFF = 0.4  # of the sampling rate, for a cut-off of the motion
_DENSE = 5.0  # samples in a period of the highest frequency that is kept

EXPLAINED = 0.1
"""Share of the torque's power, with equal weight for all joints, that the plain model
explains: more in the band below the edge, less above it.
"""

SAMPLES_PER_PARAMETER = 10.0
"""Least number of independent samples for each parameter in a narrowed band.  With ten,
errors of parameters add a tenth to the squared error of a prediction.  With fewer,
these errors are as large as the gain of a useful term, so cross-validation cannot
decide.
"""

_WINDOW = 4.0  # s; length of the pieces whose spectra are averaged


def velocity_edge(raw: Recording) -> float:
    """Return the frequency [Hz] below which the velocities have most of their power.

    All joints have equal weight. The spectrum is that of the position; the noise level
    of its upper half is subtracted, and so are lines in that half, which come from time
    stamps that jitter in step with the sampling.
    """
    n = len(raw)
    time = np.linspace(raw.time[0], raw.time[-1], n)
    q = positions_at(raw, time)
    ramp = np.linspace(-1.0, 1.0, n)
    q = q - q.mean(axis=0)
    q = (q - np.outer(ramp, ramp @ q) / (ramp @ ramp)) * np.hanning(n)[:, None]
    power = abs(np.fft.rfft(q, axis=0)) ** 2
    frequency = np.fft.rfftfreq(n, float(time[1] - time[0]))
    noise = _NOISE_POWER * np.median(power[len(power) // 2 :], axis=0)
    moved = (power > noise) & (frequency < _NOISE_EDGE * frequency[-1])[:, None]
    velocity = np.where(moved, power, 0.0) * frequency[:, None] ** 2
    total = velocity.sum(axis=0)
    moving = total > 0.0
    if not moving.any():
        return float(frequency[1])
    share = np.cumsum(velocity[:, moving] / total[moving], axis=0).mean(axis=1)
    return float(
        frequency[min(int(np.searchsorted(share, _BAND_POWER)), len(share) - 1)]
    )


def prediction_band(recordings: Sequence[Recording]) -> float:
    """Return the frequency [Hz] up to which torque is to be predicted."""
    edge = max(velocity_edge(raw) for raw in recordings)
    top = _BAND_SHARE * min(own_rate(raw) for raw in recordings)
    return float(f"{min(_HARMONICS * edge, top):.2g}")


def motion_cutoffs(band: float, rate: float) -> tuple[float, ...]:
    """Return cut-offs of the motion to try [Hz], ascending."""
    tried = sorted({float(f"{ratio * band:.2g}") for ratio in _CUTOFF_RATIOS})
    return tuple(f for f in tried if f <= _HIGHEST_CUTOFF * rate)


def thinning(band: float, rate: float) -> int:
    """Return the decimation step that leaves five samples in a period of the band."""
    return max(int(rate / (_DENSE * band)), 1)


def explained_edge(parts: Sequence[SampledPart], fits: FoldFits) -> float:
    """Return the frequency [Hz] up to which a model explains some of the torque.

    ``S`` is the spectrum of the torque and ``R`` that of the residual, each joint's
    divided by the power of its torque. The result is the ``f`` that maximises the sum
    of ``(1 - EXPLAINED) S - R`` up to ``f``, so weak peaks above it have no effect.

    Parameters
    ----------
    parts : sequence of SampledPart
    fits : FoldFits
        Fits of the model; the mean of their parameters is used.
    """
    model, x = fits.candidate.model, fits.parameters.mean(axis=0)
    pairs = []
    for part in parts:
        left = part.torque - part.motion.along.predicted(model, x)
        weights = part.rows.along.weights
        known = np.ones_like(left) if weights is None else weights != 0.0
        pairs.append((part.time, part.torque * known, left * known))
    step = float(np.median(np.diff(pairs[0][0])))
    longest = max(len(time) for time, _, _ in pairs)
    size = max(min(longest, int(_WINDOW / step)), 8)
    torque = _spectrum([pair[1] for pair in pairs], size)
    left = _spectrum([pair[2] for pair in pairs], size)
    power = torque.sum(axis=0)
    moving = power > 0.0
    gain = ((1.0 - EXPLAINED) * torque - left)[:, moving] / power[moving]
    best = int(np.argmax(np.cumsum(gain.sum(axis=1))))
    return float(np.fft.rfftfreq(size, step)[max(best, 1)])


def _spectrum(signals: Sequence[Matrix], size: int) -> Matrix:
    """Return the summed power spectra of pieces that overlap by half."""
    window: Vector = np.hanning(size + 2)[1:-1]
    total = np.zeros((size // 2 + 1, signals[0].shape[1]))
    for signal in signals:
        for start in range(0, max(len(signal) - size, 0) + 1, size // 2):
            piece = signal[start : start + size]
            piece = (piece - piece.mean(axis=0)) * window[: len(piece), None]
            total += abs(np.fft.rfft(piece, size, axis=0)) ** 2
    return total


def least_band(seconds: float, joints: int, parameters: int) -> float:
    """Return the narrowest band [Hz] in which a log determines its parameters.

    It is the ``B`` at which ``2 B T`` samples of each joint are `SAMPLES_PER_PARAMETER`
    times the number of parameters.

    Parameters
    ----------
    seconds : float, [s]
        Duration ``T`` of all logs.
    joints : int
        Number of joints with torque.
    parameters : int
        Number of estimated parameters: base parameters and those of drives.

    Examples
    --------
    Six joints with 54 parameters:

    >>> round(least_band(44.5, 6, 54), 2)
    1.01
    """
    return SAMPLES_PER_PARAMETER * parameters / (2.0 * seconds * joints)


def narrowed(band: float, edge: float, least: float = 0.0) -> float:
    """Return a band [Hz] narrowed to the edge of the explained torque.

    Parameters
    ----------
    band, edge : float, [Hz]
    least : float, [Hz]
        Lower limit of narrowing; a narrower band stays as it is.
    """
    return min(band, float(f"{max(edge, least):.2g}"))
