"""Clocks: jittered stamps brought to uniform ones, and the rate of those."""

from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import COMMANDS, Recording
from consistent_id.recordings.signals.beside import resampled_beside
from consistent_id.recordings.signals.spline import cubic_spline

_SLOWEST = 0.8  # new rate over old, below which resampling needs a filter first
_FASTEST = 1.25  # new rate over old, above which samples are invented
_JITTER = 1e-3  # steps that differ by less than this fraction count as uniform


def resampled(
    recording: Recording,
    rate: float,
    *,
    max_gap: float | None = None,
    upwards: bool = False,
) -> Recording:
    """Bring jittered stamps to a uniform clock by cubic (C2) interpolation.

    Parameters
    ----------
    recording : Recording
    rate : float, [Hz]
    max_gap : float, optional, [s]
        Longest step between stamps that is bridged; by default ten mean steps.
    upwards : bool
        Allow more than 1.25 times the recording's own rate.  Samples between samples
        say nothing new, yet standard errors count them as if they did.

    Raises
    ------
    RecordingError
        If a step is longer than `max_gap`: what happened in between is not known.  If
        the rate is so low that signals would fold back, or so high that samples would
        be invented.
    """
    time = recording.time
    steps = np.diff(time)
    require_rate(recording.name, rate, recording.rate, own_rate(recording), upwards)
    limit = largest_gap(recording.rate, max_gap)
    if steps.max() > limit:
        at = int(np.argmax(steps))
        raise RecordingError(
            f"{recording.name}: a gap of {steps[at]:.4g} s after sample {at} "
            f"(t = {time[at]:.6g} s), longer than {limit:.4g} s. Use its parts, see "
            "signals.split_at_gaps, or raise max_gap"
        )
    count = samples_at(rate, recording.duration)
    clock = time[0] + np.arange(count) / rate
    clock[-1] = min(clock[-1], time[-1])
    return onto_clock(recording, clock)


def require_rate(
    name: str, rate: float, mean: float, own: float, upwards: bool = False
) -> None:
    """Refuse a rate at which signals would fold back or samples be invented [Hz].

    `mean` is the recording's mean rate, `own` that at which it was meant to be written.
    """
    _positive(rate, "rate")
    if rate < _SLOWEST * mean:
        raise RecordingError(
            f"{name}: from {mean:.6g} Hz to {rate:g} Hz what is "
            "faster would fold back into the signal. Resample at about the recording's "
            "own rate, then call signals.decimated"
        )
    if rate > _FASTEST * own and not upwards:
        raise RecordingError(
            f"{name}: from {own:.6g} Hz to {rate:g} Hz samples would be "
            "invented, and counted as if they had been measured. Resample at about the "
            "recording's own rate, or say upwards=True"
        )


def largest_gap(mean_rate: float, max_gap: float | None) -> float:
    """Return the longest step between stamps that is bridged [s]."""
    limit = 10.0 / mean_rate if max_gap is None else max_gap
    if not limit > 0.0:
        raise RecordingError(f"max_gap is {limit} s, expected a positive number")
    return limit


def samples_at(rate: float, duration: float) -> int:
    """Return how many samples at a rate [Hz] fit into a duration [s]."""
    return int(np.floor(duration * rate * (1 + 1e-12))) + 1


def onto_clock(recording: Recording, clock: Vector) -> Recording:
    """Return a recording at other times, by cubic (C2) interpolation.

    Commands hold until the next.
    """
    time = recording.time

    def onto(values: Matrix | None) -> Matrix | None:
        return None if values is None else cubic_spline(time, values, clock)

    return replace(
        recording,
        time=clock,
        position=cubic_spline(time, recording.position, clock),
        velocity=onto(recording.velocity),
        acceleration=onto(recording.acceleration),
        torque=onto(recording.torque),
        **resampled_beside(recording, clock),
        **held_commands(recording, clock),  # type: ignore[arg-type]
    )


def held_commands(recording: Recording, clock: Vector) -> dict[str, Matrix]:
    """Return the commands in force at other times; each holds until the next."""
    place = np.searchsorted(recording.time, clock, side="right") - 1
    return {
        channel: values[np.maximum(place, 0)]
        for channel in COMMANDS
        if (values := getattr(recording, channel)) is not None
    }


def uniform_rate(recording: Recording) -> float:
    """Return the sampling rate [Hz] of a uniform clock.

    Raises
    ------
    RecordingError
        If steps differ by more than a thousandth of their mean.
    """
    worst = _worst_step(recording)
    if worst is not None:
        step = recording.time[worst + 1] - recording.time[worst]
        raise RecordingError(
            f"{recording.name}: the step after sample {worst} is {step:.6g} s, "
            f"their mean {1.0 / recording.rate:.6g} s; the clock is not uniform. Call "
            "signals.resampled(recording, rate) first"
        )
    return float(1.0 / np.diff(recording.time).mean())


def is_uniform(recording: Recording) -> bool:
    """Return whether `uniform_rate` would take the clock."""
    return _worst_step(recording) is None


def own_rate(recording: Recording) -> float:
    """Return the rate [Hz] at which samples were meant to be written.

    Stamps dropped now and then, and gaps, do not lower it as they do the mean rate.
    """
    return max(recording.rate, 1.0 / float(np.median(np.diff(recording.time))))


def _worst_step(recording: Recording) -> int | None:
    """Return which step is furthest from the mean, if it is too far."""
    steps = np.diff(recording.time)
    mean = steps.mean()
    worst = int(np.argmax(abs(steps - mean)))
    if abs(steps[worst] - mean) > jitter(mean, abs(recording.time).max()):
        return worst
    return None


def jitter(mean: float, latest: float) -> float:
    """Return by how much steps of a uniform clock may differ from their mean [s].

    Stamps that count from long ago are themselves rounded.
    """
    return _JITTER * mean + 4.0 * float(np.finfo(np.float64).eps) * latest


def _positive(value: float, name: str) -> None:
    if not 0.0 < value < np.inf:
        raise RecordingError(f"{name} is {value}, expected a positive number")
