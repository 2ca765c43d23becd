"""The band in which torque is to be predicted, and cut-offs of the motion to try."""

from collections.abc import Sequence

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.recordings.recording import Recording, positions_at
from consistent_id.recordings.signals.clocks import own_rate

_POWER = 0.99  # of the velocities' power, below the band's edge
_HARMONICS = 20.0
"""Edge of the predicted torque over that of the velocity: products of motions and the
jumps of friction reach so far, with a twentieth of their size left."""

_SHARE = 0.25  # of the sampling rate, above which nothing is predicted
_NOISE = 30.0  # times the median power of the upper half of the spectrum is no noise
_MOTION = 0.45  # of half the sampling rate: what is faster is noise by definition
_RATIOS = (0.1, 0.14, 0.2, 0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)
"""Cut-offs of the motion over the band; the highest eight that the rate allows."""

_TRIED = 8
_HIGHEST = 0.4  # of the sampling rate, for a cut-off of the motion
_DENSE = 5.0  # samples in a period of the highest frequency that is kept


def velocity_edge(raw: Recording) -> float:
    """Return the frequency [Hz] below which the velocities have their power.

    Joints count alike.  From the spectrum of the position, less what its upper half
    shows to be noise; and less lines there, which stamps that jitter in step with the
    sampling leave.
    """
    n = len(raw)
    time = np.linspace(raw.time[0], raw.time[-1], n)
    q = positions_at(raw, time)
    ramp = np.linspace(-1.0, 1.0, n)
    q = q - q.mean(axis=0)
    q = (q - np.outer(ramp, ramp @ q) / (ramp @ ramp)) * np.hanning(n)[:, None]
    power = abs(np.fft.rfft(q, axis=0)) ** 2
    frequency = np.fft.rfftfreq(n, float(time[1] - time[0]))
    noise = _NOISE * np.median(power[len(power) // 2 :], axis=0)
    moved = (power > noise) & (frequency < _MOTION * frequency[-1])[:, None]
    velocity = np.where(moved, power, 0.0) * frequency[:, None] ** 2
    total = velocity.sum(axis=0)
    moving = total > 0.0
    if not moving.any():
        return float(frequency[1])
    share = np.cumsum(velocity[:, moving] / total[moving], axis=0).mean(axis=1)
    return float(frequency[min(int(np.searchsorted(share, _POWER)), len(share) - 1)])


def prediction_band(recordings: Sequence[Recording]) -> float:
    """Return the frequency [Hz] up to which torque is to be predicted."""
    edge = max(velocity_edge(raw) for raw in recordings)
    top = _SHARE * min(own_rate(raw) for raw in recordings)
    return float(f"{min(_HARMONICS * edge, top):.2g}")


def motion_cutoffs(band: float, rate: float) -> tuple[float, ...]:
    """Return cut-offs of the motion to try [Hz], ascending."""
    tried = sorted({float(f"{ratio * band:.2g}") for ratio in _RATIOS})
    return tuple(f for f in tried if f <= _HIGHEST * rate)[-_TRIED:]


def thinning(band: float, rate: float) -> int:
    """Return of how many samples one suffices: five in a period of the band."""
    return max(int(rate / (_DENSE * band)), 1)


def velocity_scales(speeds: Vector) -> tuple[float, ...]:
    """Return widths of friction's change of sign to try, from top speeds of joints."""
    top = float(np.median(speeds))
    series = [m * 10.0**e for e in range(-6, 4) for m in (1.0, 2.0, 5.0)]
    return tuple(float(f"{s:.1g}") for s in series if 0.004 <= s / top <= 0.3)
