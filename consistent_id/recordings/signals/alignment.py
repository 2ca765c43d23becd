"""Channels of several clocks brought to one."""

from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import (
    held_commands,
    is_uniform,
    own_rate,
    resampled,
)
from consistent_id.recordings.signals.cuts import trimmed
from consistent_id.recordings.signals.filters import low_passed
from consistent_id.recordings.signals.spline import cubic_spline
from consistent_id.recordings.signals.track import CHANNELS, Track

SAME = 1.05  # ratio of rates up to which two clocks count as equally fast
ALIAS = 0.8  # cut-off over the slower clock's Nyquist frequency
ORDER = 8  # of the filter against aliasing


def aligned(recording: Recording, track: Track, *, delay: float = 0.0) -> Recording:
    """Return the recording with a channel that was written on another clock.

    The slower of the two clocks is kept, so that no sample is invented; before, all
    channels of both are filtered alike, as `decimated` does, to 0.8 of its Nyquist
    frequency.  Clocks that are equally fast are not filtered; the track is interpolated
    onto the recording's stamps.

    Parameters
    ----------
    recording : Recording
        Uniformly sampled, unless both clocks are equally fast.
    track : Track
        With all joints of the recording.  A channel that the recording has is replaced,
        which is how a channel that lags behind the others is put right.
    delay : float, [s]
        By which the track's stamps come too late; see `estimate_delay`.

    Raises
    ------
    RecordingError
        If a joint is missing, a clock has a gap, or the two hardly overlap.
    """
    if not np.isfinite(delay):
        raise RecordingError(f"delay is {delay} s, expected a number")
    other = track.of(recording.joints).recording()
    other = replace(other, time=other.time - delay)
    ratio = own_rate(other) / own_rate(recording)
    if max(ratio, 1.0 / ratio) > SAME:
        if not is_uniform(other):
            other = resampled(other, own_rate(other))
        cutoff = ALIAS * min(other.rate, recording.rate) / 2.0
        recording = _smooth(recording, cutoff)
        other = _smooth(other, cutoff)
    clock = other.time if ratio < 1.0 / SAME else recording.time
    clock = _shared(clock, recording, other)
    channels: dict[str, Matrix] = {
        name: _onto(clock, recording.time, values)
        for name in CHANNELS
        if (values := getattr(recording, name)) is not None
    }
    channels[track.channel] = _onto(clock, other.time, other.position)
    channels |= held_commands(recording, clock)
    return replace(recording, time=clock, **channels)  # type: ignore[arg-type]


def _smooth(recording: Recording, cutoff: float) -> Recording:
    return low_passed(
        recording, motion_cutoff=cutoff, torque_cutoff=cutoff, order=ORDER
    )


def _shared(clock: Vector, first: Recording, second: Recording) -> Vector:
    start = max(first.time[0], second.time[0])
    stop = min(first.time[-1], second.time[-1])
    shared = clock[(clock >= start) & (clock <= stop)]
    if len(shared) < 2:
        raise RecordingError(
            f"{first.name} runs from {first.time[0]:.6g} s to {first.time[-1]:.6g} s, "
            f"{second.name}, less its delay, from {second.time[0]:.6g} s to "
            f"{second.time[-1]:.6g} s; they have no two samples in common"
        )
    for recording in (first, second):
        _without_gap(trimmed(recording, shared[0], shared[-1]))
    return np.asarray(shared)


def _without_gap(recording: Recording) -> None:
    steps = np.diff(recording.time)
    if steps.max() * own_rate(recording) > 10.0:
        at = int(np.argmax(steps))
        raise RecordingError(
            f"{recording.name}: a gap of {steps[at]:.4g} s at t = "
            f"{recording.time[at]:.6g} s; call signals.split_at_gaps first"
        )


def _onto(clock: Vector, time: Vector, values: Matrix) -> Matrix:
    """Return values between their own stamps, by a cubic spline."""
    if clock is time or np.array_equal(clock, time):
        return values
    return cubic_spline(time, values, clock)
