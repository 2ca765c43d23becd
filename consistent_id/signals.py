"""From a raw log to motion and torque that belong together.

Each function takes a `Recording` and returns a new one.
"""

from dataclasses import replace

import numpy as np

from consistent_id._arrays import Matrix
from consistent_id.errors import RecordingError
from consistent_id.recording import Recording

_SLOWEST = 0.8  # new rate over old, below which resampling needs a filter first
_LOWEST = 1e-5  # cut-off over sampling rate
_JITTER = 1e-3  # steps that differ by less than this fraction count as uniform


def resampled(
    recording: Recording, rate: float, *, max_gap: float | None = None
) -> Recording:
    """Bring jittered stamps to a uniform clock by cubic (C2) interpolation.

    Parameters
    ----------
    recording : Recording
    rate : float, [Hz]
    max_gap : float, optional, [s]
        Longest step between stamps that is bridged; by default ten mean steps.

    Raises
    ------
    RecordingError
        If a step is longer than `max_gap`: what happened in between is not known.
    """
    from scipy.interpolate import CubicSpline

    _positive(rate, "rate")
    if rate < _SLOWEST * recording.rate:
        raise RecordingError(
            f"{recording.name}: from {recording.rate:.6g} Hz to {rate:g} Hz what is "
            "faster would fold back into the signal. Resample at about the recording's "
            "own rate, then call signals.decimated"
        )
    time = recording.time
    steps = np.diff(time)
    limit = 10.0 / recording.rate if max_gap is None else max_gap
    if not limit > 0.0:
        raise RecordingError(f"max_gap is {limit} s, expected a positive number")
    if steps.max() > limit:
        at = int(np.argmax(steps))
        raise RecordingError(
            f"{recording.name}: a gap of {steps[at]:.4g} s after sample {at} "
            f"(t = {time[at]:.6g} s), longer than {limit:.4g} s. Cut the recording "
            "there and use its parts, or raise max_gap"
        )
    count = int(np.floor(recording.duration * rate * (1 + 1e-12))) + 1
    clock = time[0] + np.arange(count) / rate
    clock[-1] = min(clock[-1], time[-1])

    def onto(values: Matrix | None) -> Matrix | None:
        return None if values is None else CubicSpline(time, values)(clock)

    return replace(
        recording,
        time=clock,
        position=CubicSpline(time, recording.position)(clock),
        velocity=onto(recording.velocity),
        acceleration=onto(recording.acceleration),
        torque=onto(recording.torque),
    )


def low_passed(
    recording: Recording,
    *,
    motion_cutoff: float | None = None,
    torque_cutoff: float | None = None,
    order: int = 4,
) -> Recording:
    """Filter with a zero-phase Butterworth filter, run forwards and backwards.

    Parameters
    ----------
    recording : Recording
        Uniformly sampled.
    motion_cutoff, torque_cutoff : float, optional, [Hz]
        Cut-off of position, velocity and acceleration, and of torque; none to leave
        them as they are.
    order : int
        Of the one-way filter; the attenuation at the cut-off is 6 dB.

    Raises
    ------
    RecordingError
        If the clock is not uniform or a cut-off is not below half the sampling rate.
    """
    from scipy.signal import butter, sosfiltfilt

    rate = uniform_rate(recording)
    if not isinstance(order, int) or order < 1:
        raise RecordingError(f"filter order is {order!r}, expected 1, 2, 3, ...")

    def smooth(values: Matrix | None, cutoff: float | None) -> Matrix | None:
        if values is None or cutoff is None:
            return values
        if not _LOWEST * rate <= cutoff < rate / 2:
            raise RecordingError(
                f"{recording.name}: cut-off {cutoff:g} Hz, expected between "
                f"{_LOWEST * rate:.2g} Hz (below, the filter loses its digits; "
                f"decimate first) and half of the sampling rate, {rate / 2:.6g} Hz"
            )
        sections = butter(order, cutoff, fs=rate, output="sos")
        pad = min(len(values) - 1, int(3 * order * rate / cutoff))
        return sosfiltfilt(sections, values, axis=0, padlen=pad)  # type: ignore[no-any-return]

    position = smooth(recording.position, motion_cutoff)
    return replace(
        recording,
        position=position if position is not None else recording.position,
        velocity=smooth(recording.velocity, motion_cutoff),
        acceleration=smooth(recording.acceleration, motion_cutoff),
        torque=smooth(recording.torque, torque_cutoff),
    )


def differentiated(recording: Recording) -> Recording:
    """Fill in what is missing of velocity and acceleration by central differences.

    A measured velocity is kept and differentiated once; without it, position is
    differentiated twice, the second time by the three-point second difference.  Filter
    first: differences amplify noise.

    Raises
    ------
    RecordingError
        If the clock is not uniform or there are fewer than four samples.
    """
    step = 1.0 / uniform_rate(recording)
    if len(recording) < 4:
        raise RecordingError(
            f"{recording.name}: {len(recording)} samples, expected 4 or more to "
            "differentiate"
        )
    velocity, acceleration = recording.velocity, recording.acceleration
    if acceleration is None:
        acceleration = (
            _second_difference(recording.position, step)
            if velocity is None
            else np.gradient(velocity, step, axis=0, edge_order=2)
        )
    if velocity is None:
        velocity = np.gradient(recording.position, step, axis=0, edge_order=2)
    return replace(recording, velocity=velocity, acceleration=acceleration)


def trimmed(
    recording: Recording, start: float = -np.inf, stop: float = np.inf
) -> Recording:
    """Keep the samples with ``start <= time <= stop`` [s].

    Trim after filtering: a filter needs the samples before and after.
    """
    if np.isnan(start) or np.isnan(stop):
        raise RecordingError(f"{recording.name}: trimmed from {start} s to {stop} s")
    first, last = np.searchsorted(recording.time, [start, np.nextafter(stop, np.inf)])
    last = max(first, last)
    if last - first < 2:
        raise RecordingError(
            f"{recording.name}: {last - first} samples between {start:g} s and "
            f"{stop:g} s; it runs from {recording.time[0]:g} s to "
            f"{recording.time[-1]:g} s"
        )
    return recording.samples(slice(int(first), int(last)))


def decimated(recording: Recording, factor: int) -> Recording:
    """Keep every `factor`-th sample, after filtering all channels alike.

    The anti-aliasing filter is a zero-phase Butterworth of order 8 at 0.8 of the new
    Nyquist frequency, on motion and torque.
    """
    if not isinstance(factor, int) or factor < 1:
        raise RecordingError(f"decimation factor is {factor!r}, expected 1, 2, 3, ...")
    if factor == 1:
        return recording
    cutoff = 0.8 * uniform_rate(recording) / (2 * factor)
    smooth = low_passed(recording, motion_cutoff=cutoff, torque_cutoff=cutoff, order=8)
    return smooth.samples(slice(None, None, factor))


def uniform_rate(recording: Recording) -> float:
    """Return the sampling rate [Hz] of a uniform clock.

    Raises
    ------
    RecordingError
        If steps differ by more than a thousandth of their mean.
    """
    steps = np.diff(recording.time)
    mean = steps.mean()
    worst = int(np.argmax(abs(steps - mean)))
    # Stamps that count from long ago are themselves rounded.
    rounding = 4.0 * np.finfo(np.float64).eps * abs(recording.time).max()
    if abs(steps[worst] - mean) > _JITTER * mean + rounding:
        raise RecordingError(
            f"{recording.name}: the step after sample {worst} is {steps[worst]:.6g} s, "
            f"their mean {mean:.6g} s; the clock is not uniform. Call "
            "signals.resampled(recording, rate) first"
        )
    return float(1.0 / mean)


def _second_difference(position: Matrix, step: float) -> Matrix:
    inner = (position[2:] - 2.0 * position[1:-1] + position[:-2]) / step**2
    first = 2.0 * inner[:1] - inner[1:2]
    last = 2.0 * inner[-1:] - inner[-2:-1]
    return np.vstack([first, inner, last])


def _positive(value: float, name: str) -> None:
    if not 0.0 < value < np.inf:
        raise RecordingError(f"{name} is {value}, expected a positive number")
