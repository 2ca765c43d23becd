"""Clocks: the rate of stamps, and recordings brought to other times.

The cubic spline is implemented here: scipy.interpolate imports much that no command
needs.
"""

from dataclasses import replace
from typing import TypedDict

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.given_values import require_type
from consistent_id.errors import RecordingError
from consistent_id.recordings.beside import BaseMotion, ContactFlags, Wrench
from consistent_id.recordings.recording import COMMANDS, Recording, instant

_SLOWEST = 0.8  # new rate over old, below which resampling needs a filter first
_FASTEST = 1.25  # new rate over old, above which samples are invented
_JITTER = 1e-3  # steps that differ by less than this fraction count as uniform
_SLIVER = 1e-6  # share of a sample up to which a stamp beside the clock is rounding


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
        Allow more than 1.25 times the recording's own rate.  Interpolated samples
        contain no new information, yet standard errors count them as independent.

    Raises
    ------
    RecordingError
        If a step is longer than `max_gap`: the motion in between is not known.  If the
        rate is so low that signals would fold back, or so high that samples would be
        invented.

    Examples
    --------
    >>> import consistent_id as ci
    >>> time = np.arange(200) / 100
    >>> log = ci.Recording(("elbow",), time, np.sin(time)[:, None])
    >>> ci.resampled(log, 125.0).rate
    125.0
    """
    require_type(recording, Recording, "recording")
    time = recording.time
    steps = np.diff(time)
    require_rate(recording.name, rate, recording.rate, own_rate(recording), upwards)
    limit = largest_gap(recording.rate, max_gap)
    if steps.max() > limit:
        at = int(np.argmax(steps))
        raise RecordingError(
            f"{recording.name}: a gap of {steps[at]:.4g} s after sample {at} "
            f"(t = {instant(time[at], time)} s), longer than {limit:.4g} s. Use its "
            "parts, see signals.split_at_gaps, or raise max_gap"
        )
    count = samples_at(rate, recording.duration)
    clock = time[0] + np.arange(count) / rate
    clock[-1] = min(clock[-1], time[-1])
    return onto_clock(recording, clock)


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
    """Return whether the clock is uniform enough for `uniform_rate`."""
    return _worst_step(recording) is None


def own_rate(recording: Recording) -> float:
    """Return the nominal rate [Hz] of a log.

    Unlike the mean rate, it is not lowered by dropped stamps and gaps.
    """
    return max(recording.rate, 1.0 / float(np.median(np.diff(recording.time))))


def jitter(mean: float, latest: float) -> float:
    """Return the allowed difference of a uniform clock's steps from their mean [s].

    Stamps with a distant origin are rounded more.
    """
    return _JITTER * mean + 4.0 * float(np.finfo(np.float64).eps) * latest


def require_rate(
    name: str, rate: float, mean: float, own: float, upwards: bool = False
) -> None:
    """Refuse a rate at which signals would fold back or samples be invented [Hz].

    `mean` is the recording's mean rate, `own` its nominal rate.
    """
    _positive(rate, "rate")
    if rate < _SLOWEST * mean:
        raise RecordingError(
            f"{name}: from {mean:.6g} Hz to {rate:g} Hz, faster signals would be "
            f"aliased. Resample at about the recording's "
            "own rate, then call signals.decimated"
        )
    if rate > _FASTEST * own and not upwards:
        raise RecordingError(
            f"{name}: from {own:.6g} Hz to {rate:g} Hz, samples would be invented, "
            f"and treated as measured. Resample at about the "
            "recording's own rate, or set upwards=True"
        )


def largest_gap(mean_rate: float, max_gap: float | None) -> float:
    """Return the longest step between stamps that is bridged [s]."""
    limit = 10.0 / mean_rate if max_gap is None else max_gap
    if not limit > 0.0:
        raise RecordingError(f"max_gap is {limit} s, expected a positive number")
    return limit


def samples_at(rate: float, duration: float) -> int:
    """Return the number of samples at a rate [Hz] in a duration [s]."""
    return int(np.floor(duration * rate * (1 + 1e-12))) + 1


def onto_clock(recording: Recording, clock: Vector) -> Recording:
    """Return a recording at other times, by cubic (C2) interpolation.

    Commands are constant until the next; see `held_commands`.

    Raises
    ------
    RecordingError
        If the torque is filtered.
    """
    require_unfiltered(recording)
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
        torque_shift=onto(recording.torque_shift),
        **_resampled_beside(recording, clock),
        **held_commands(recording, clock),  # type: ignore[arg-type]
    )


def require_unfiltered(recording: Recording) -> None:
    """Refuse another clock for a recording whose torque is filtered.

    Raises
    ------
    RecordingError
        Rows on another clock can no longer be filtered like the torque.
    """
    if recording.torque_filter is not None:
        raise RecordingError(
            f"{recording.name}: its torque is low-passed at "
            f"{recording.torque_filter.cutoff:g} Hz on its own clock. Bring it to "
            "another clock before you filter it; signals.decimated thins filtered "
            "samples"
        )


def held_commands(recording: Recording, clock: Vector) -> dict[str, Matrix]:
    """Return commands at other times, each the mean until the next of these times.

    A command is valid from its stamp until the next stamp, and a returned one from its
    time until the next.  Both have the same integral over time, so commands come
    neither early nor late, also where stamps are a little behind the clock.  Where
    stamps and clock agree, values are the same to the last bit.

    Parameters
    ----------
    recording : Recording
        Before its first stamp the first command is valid, after its last the last.
    clock : ndarray, shape (instants,), [s]
        Increasing.  The last interval is as long as the one before.
    """
    time = recording.time
    step = clock[-1] - clock[-2] if len(clock) > 1 else 1.0 / recording.rate
    ends = np.append(clock, clock[-1] + step)
    inside = time[(time > ends[0]) & (time < ends[-1])]
    starts = np.sort(np.concatenate([clock, inside]))
    widths = np.diff(starts, append=ends[-1])
    cells = np.searchsorted(clock, starts, side="right") - 1
    kept = widths > _SLIVER * np.diff(ends)[cells]
    starts, widths, cells = starts[kept], widths[kept], cells[kept]
    weights = (widths / np.bincount(cells, widths)[cells])[:, None]
    place = np.maximum(np.searchsorted(time, starts, side="right") - 1, 0)
    first = np.searchsorted(cells, np.arange(len(clock)))

    def means(values: Matrix) -> Matrix:
        begin = values[place[first]]  # exact where nothing changes
        steps = weights * (values[place] - begin[cells])
        return np.asarray(begin + np.add.reduceat(steps, first))

    return {
        channel: means(values)
        for channel in COMMANDS
        if (values := getattr(recording, channel)) is not None
    }


class Beside(TypedDict):
    """The fields of a recording that are not of joints."""

    base: BaseMotion | None
    wrenches: tuple[Wrench, ...]
    contacts: tuple[ContactFlags, ...]


def _resampled_beside(recording: Recording, clock: Vector) -> Beside:
    """Return fields at other times; contacts are certain where neighbours agree."""
    time, base = recording.time, recording.base
    if base is not None:
        w, dw, felt = np.split(cubic_spline(time, base.stacked, clock), 3, axis=1)
        rotation = base.rotation
        if rotation is not None:
            rotation = interpolated_rotations(time, rotation, clock)
        base = BaseMotion(w, dw, felt, rotation)
    wrenches = (
        replace(w, values=cubic_spline(time, w.values, clock))
        for w in recording.wrenches
    )
    before = np.maximum(np.searchsorted(time, clock, side="right") - 1, 0)
    after = np.minimum(before + 1, len(time) - 1)
    contacts = (
        replace(
            flags,
            closed=flags.closed[before],
            certain=flags.certain[before]
            & flags.certain[after]
            & (flags.closed[before] == flags.closed[after]),
        )
        for flags in recording.contacts
    )
    return Beside(base=base, wrenches=tuple(wrenches), contacts=tuple(contacts))


def interpolated_rotations(time: Vector, rotation: Array, clock: Vector) -> Array:
    """Return rotations at other times: those nearest to interpolated matrices."""
    matrices = cubic_spline(time, rotation.reshape(-1, 9), clock).reshape(-1, 3, 3)
    U, _, Vt = np.linalg.svd(matrices)
    return np.asarray(U @ Vt)


def cubic_spline(time: Vector, values: Matrix, clock: Vector) -> Matrix:
    """Return values between their stamps, with two continuous derivatives.

    As ``scipy.interpolate.CubicSpline(time, values)(clock)``: next to either end, the
    third derivative is continuous as well.

    Parameters
    ----------
    time : ndarray, shape (samples,)
        Increasing, two samples or more.
    values : ndarray, shape (samples, columns)
    clock : ndarray, shape (instants,)
        Between the first stamp and the last.
    """
    if len(time) < 4:  # one polynomial through all samples
        powers = np.vander(time - time[0], increasing=True)
        at = np.vander(clock - time[0], len(time), increasing=True)
        return np.asarray(at @ np.linalg.solve(powers, values))
    steps = np.diff(time)[:, None]
    chords = np.diff(values, axis=0) / steps
    slopes = _spline_slopes(steps, chords)
    k = np.clip(np.searchsorted(time, clock, side="right") - 1, 0, len(steps) - 1)
    h, t = steps[k], (clock - time[k])[:, None]
    bend = slopes[k] + slopes[k + 1] - 2.0 * chords[k]
    square = (chords[k] - slopes[k] - bend) / h
    return np.asarray(values[k] + t * (slopes[k] + t * (square + t * bend / h**2)))


def _spline_slopes(steps: Matrix, chords: Matrix) -> Matrix:
    """Return the slopes at the stamps, from a tridiagonal system."""
    from scipy.linalg import solve_banded

    h = steps[:, 0]
    bands = np.zeros((3, len(h) + 1))  # above the diagonal, on it, below it
    first, last = h[0] + h[1], h[-1] + h[-2]
    bands[0, 2:], bands[2, :-2] = h[:-1], h[1:]
    bands[0, 1], bands[2, -2] = first, last
    bands[1] = [h[1], *(2.0 * (h[:-1] + h[1:])), h[-2]]
    rise = np.empty((len(h) + 1, chords.shape[1]))
    rise[1:-1] = 3.0 * (steps[1:] * chords[:-1] + steps[:-1] * chords[1:])
    rise[0] = (h[0] + 2 * first) * h[1] * chords[0] + h[0] ** 2 * chords[1]
    rise[-1] = (h[-1] + 2 * last) * h[-2] * chords[-1] + h[-1] ** 2 * chords[-2]
    rise[[0, -1]] /= [[first], [last]]
    return np.asarray(solve_banded((1, 1), bands, rise))


def _worst_step(recording: Recording) -> int | None:
    """Return the step with the largest difference from the mean, if it is too large."""
    steps = np.diff(recording.time)
    mean = steps.mean()
    worst = int(np.argmax(abs(steps - mean)))
    if abs(steps[worst] - mean) > jitter(mean, abs(recording.time).max()):
        return worst
    return None


def _positive(value: float, name: str) -> None:
    if not 0.0 < value < np.inf:
        raise RecordingError(f"{name} is {value}, expected a positive number")
