"""Channels on separate clocks: their delay, and their alignment to one clock.

`estimate_delay` compares two signals of one motion.  With ``r`` the reference,
differentiated as often as needed, and ``y`` the late signal, both filtered alike,

    y(t) = gain r(t - delay) + offset + error,

with a gain, an offset and an error variance for each joint and one delay for all.  The
delay maximises the likelihood, ``-sum_j log (sum of squared errors of joint j)``.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, Self

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, freeze, freeze_arrays
from consistent_id._support.tables import brief
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import (
    cubic_spline,
    held_commands,
    is_uniform,
    own_rate,
    require_unfiltered,
    resampled,
)
from consistent_id.recordings.signals.filters import low_passed
from consistent_id.recordings.signals.parts import trimmed

Channel = Literal["position", "velocity", "acceleration", "torque"]
CHANNELS: tuple[Channel, ...] = ("position", "velocity", "acceleration", "torque")

SAME = 1.05  # ratio of rates up to which two clocks count as equally fast
ALIAS = 0.8  # cut-off over the slower clock's Nyquist frequency
ORDER = 8  # of the filter against aliasing

_DERIVATIVES_OF = {"position": 0, "velocity": 1, "acceleration": 2}
_BAND = 8.0  # sampling rate over the highest cut-off: splines are exact below
_ALIKE = 0.5  # least share of the variance that one motion explains
_BLOCKS = (10, 40)  # fewest and most blocks for the standard error
_AS_GOOD = 1.5  # ratio of standard errors up to which cut-offs are alike
_PERIODS = 2.5  # of the cut-off, least length of a block where there are enough


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """A sensor's channel of several joints, with its own stamps.

    Parameters
    ----------
    channel : {"position", "velocity", "acceleration", "torque"}
    joints : tuple of str
    time : array_like, shape (samples,), [s]
        Strictly increasing.
    values : array_like, shape (samples, joints)
    name : str
        Name of the source; used in messages.

    Raises
    ------
    RecordingError
        As a `Recording` would.

    Examples
    --------
    >>> time = np.arange(300) / 300.0
    >>> Track("acceleration", ("elbow",), time, np.cos(time)[:, None]).name
    'track'
    """

    channel: Channel
    joints: tuple[str, ...]
    time: Vector
    values: Matrix
    name: str = "track"

    def __post_init__(self) -> None:
        if self.channel not in CHANNELS:
            raise RecordingError(
                f"{self.name}: channel is {self.channel!r}, expected one of "
                f"{', '.join(CHANNELS)}"
            )
        if self.values is None:
            raise RecordingError(f"{self.name} has no {self.channel}")
        channels: dict[str, Any] = {"position": np.zeros(np.shape(self.values))}
        channels[self.channel] = self.values
        checked = Recording(self.joints, self.time, **channels, name=self.name)
        values = getattr(checked, self.channel)
        freeze(self, joints=checked.joints, time=checked.time, values=values)

    def of(self, joints: tuple[str, ...]) -> Self:
        """Return the named joints' values, in the given order."""
        recording = self.recording().of(joints)
        return replace(self, joints=recording.joints, values=recording.position)

    def recording(self) -> Recording:
        """Return a recording that carries the values as its position."""
        return Recording(self.joints, self.time, self.values, name=self.name)


def track(recording: Recording, channel: Channel) -> Track:
    """Return one channel of a recording as a track.

    Parameters
    ----------
    recording : Recording
    channel : {"position", "velocity", "acceleration", "torque"}

    Raises
    ------
    RecordingError
        If the recording has no such channel.
    """
    values: Matrix = getattr(recording, channel, None)  # type: ignore[assignment]
    return Track(channel, recording.joints, recording.time, values, recording.name)


def aligned(recording: Recording, track: Track, *, delay: float = 0.0) -> Recording:
    """Return the recording with a channel that was written on another clock.

    The slower of the two clocks is kept, so no sample is invented; before, all channels
    of both are filtered alike, as in `decimated`, to 0.8 of its Nyquist frequency.
    Channels with equally fast clocks are not filtered; the track is interpolated onto
    the recording's stamps.

    Parameters
    ----------
    recording : Recording
        Uniformly sampled, unless both clocks are equally fast.
    track : Track
        With all joints of the recording.  A channel that the recording has is replaced;
        this corrects a channel that lags behind the others.
    delay : float, [s]
        Delay of the track's stamps; see `estimate_delay`.

    Raises
    ------
    RecordingError
        If a joint is missing, a clock has a gap, or the two hardly overlap.
    """
    if not np.isfinite(delay):
        raise RecordingError(f"delay is {delay} s, expected a number")
    require_unfiltered(recording)
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
    # The filter against aliasing is near half the sampling rate, above what is of use.
    recording = replace(recording, torque_filter=None)
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


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Delay:
    """A delay, and its standard error.

    Parameters
    ----------
    seconds : float, [s]
        Delay of the second signal relative to the first.
    standard_error : float, [s]
        A jackknife over blocks of consecutive samples, so errors may be correlated
        within a block.  It is enlarged for few blocks, by Student's quantile over the
        normal one, so that 1.96 of it contain the delay in 95 % of cases.
    cutoff : float, [Hz]
        Cut-off to which both signals were filtered.
    joints : tuple of str
    correlations, gains : ndarray, shape (joints,)
        Correlation of the two signals after correcting the delay, and gain of the
        second.
    """

    seconds: float
    standard_error: float
    cutoff: float
    joints: tuple[str, ...]
    correlations: Vector
    gains: Vector

    def __post_init__(self) -> None:
        shape = (len(self.joints),)
        freeze_arrays(self, {"correlations": shape, "gains": shape})


def estimate_delay(
    reference: Track,
    late: Track,
    *,
    longest: float = 0.5,
    cutoff: float | None = None,
) -> Delay:
    """Estimate the delay of `late` relative to `reference`.

    Parameters
    ----------
    reference, late : Track
        Tracks of the same joints, each on its own clock.  The lower derivative among
        position, velocity and acceleration is differentiated; a torque is compared with
        a torque.
    longest : float, [s]
        Longest delay that is tried, either way.  For periodic motion less than half a
        period.
    cutoff : float, optional, [Hz]
        To which both are filtered; by default the one with the least standard error,
        from a series in which each is half the one before.

    Raises
    ------
    RecordingError
        If the signals do not overlap or are not of one motion, or if the delay is
        as long as `longest`.

    Examples
    --------
    >>> time = np.arange(2000) / 100.0
    >>> angle, rate = np.sin(3 * time + time**2 / 8), 3 + time / 4
    >>> position = Track("position", ("elbow",), time, angle[:, None])
    >>> speed = (rate * np.cos(3 * time + time**2 / 8))[:, None]
    >>> velocity = Track("velocity", ("elbow",), time + 0.123, speed)
    >>> round(estimate_delay(position, velocity).seconds, 3)
    0.123
    """
    if not 0.0 < longest < np.inf:
        raise RecordingError(f"longest is {longest} s, expected a positive number")
    order = _derivatives(reference, late)
    if order < 0:
        back = estimate_delay(late, reference, longest=longest, cutoff=cutoff)
        still = np.zeros(len(back.gains))  # a joint at rest has no gain
        return Delay(
            seconds=-back.seconds,
            standard_error=back.standard_error,
            cutoff=back.cutoff,
            joints=back.joints,
            correlations=back.correlations,
            gains=np.divide(1.0, back.gains, out=still, where=back.gains > 0.0),
        )
    joints = tuple(name for name in reference.joints if name in late.joints)
    if not joints:
        raise RecordingError(
            f"{reference.name} and {late.name} have no joint in common: "
            f"{reference.joints} and {late.joints}"
        )
    first, second = _uniform(reference.of(joints)), _uniform(late.of(joints))
    if cutoff is None:
        filtered = _filtered_late(first, second)
    else:
        filtered = {cutoff: low_passed(second, motion_cutoff=cutoff)}
    lowest, found = min(filtered), list[Delay]()
    for frequency, smooth in filtered.items():
        pair = _filtered_pair(first, smooth, order, frequency, longest, lowest)
        near = found[-1].seconds if found else None
        found.append(_best_shift(pair, joints, frequency, longest, near))
    best = min(found, key=lambda delay: delay.standard_error)
    errors = np.array([delay.standard_error for delay in found])
    alike = errors[errors <= _AS_GOOD * best.standard_error]
    # The least of several estimates is too small: those of like cut-offs are pooled.
    pooled = float(np.sqrt(np.mean(alike**2))) if len(alike) else np.inf
    return replace(best, standard_error=pooled)


class _FilteredSignals(NamedTuple):
    """Late values on their clock, and the reference at any time, both filtered."""

    time: Vector
    values: Matrix
    reference: Callable[[Vector], Matrix]
    slope: Callable[[Vector], Matrix]
    bend: Callable[[Vector], Matrix]


def _derivatives(reference: Track, late: Track) -> int:
    names = (reference.channel, late.channel)
    if "torque" not in names:
        return _DERIVATIVES_OF[names[1]] - _DERIVATIVES_OF[names[0]]
    if names[0] != names[1]:
        raise RecordingError(
            f"the delay between {names[0]} and {names[1]} cannot be found without a "
            "model of the robot"
        )
    return 0


def _uniform(signal: Track) -> Recording:
    recording = signal.recording()
    if is_uniform(recording):
        return recording
    return resampled(recording, own_rate(recording))


def _filtered_late(first: Recording, second: Recording) -> dict[float, Recording]:
    """Return the late signal for each cut-off that leaves most of it, lowest first."""
    cutoff = min(first.rate, second.rate) / _BAND
    spread = second.position.var(axis=0).sum()
    found = {cutoff: low_passed(second, motion_cutoff=cutoff)}
    while (cutoff := cutoff / 2.0) * second.duration > _BLOCKS[0] * _PERIODS:
        smooth = low_passed(second, motion_cutoff=cutoff)
        if smooth.position.var(axis=0).sum() < 0.5 * spread:
            break
        found[cutoff] = smooth
    return dict(reversed(found.items()))


def _filtered_pair(
    first: Recording,
    late: Recording,
    order: int,
    cutoff: float,
    longest: float,
    lowest: float,
) -> _FilteredSignals:
    from scipy.interpolate import make_interp_spline

    smooth = low_passed(first, motion_cutoff=cutoff)
    spline = make_interp_spline(smooth.time, smooth.position, k=5)
    # Extrapolation at the ends has decayed one period of the cut-off inside.
    margin = 1.0 / lowest
    start = max(first.time[0] + longest, late.time[0]) + margin
    stop = min(first.time[-1] - longest, late.time[-1]) - margin
    inside = np.flatnonzero((late.time >= start) & (late.time <= stop))
    # A few samples for each period of the cut-off represent a filtered signal.
    inside = inside[:: max(int(late.rate / (2.0 * _BAND * cutoff)), 1)]
    if len(inside) < 4 * _BLOCKS[0]:
        raise RecordingError(
            f"{first.name} runs from {first.time[0]:.6g} s to {first.time[-1]:.6g} s, "
            f"{late.name} from {late.time[0]:.6g} s to {late.time[-1]:.6g} s: "
            f"with delays up to {longest:g} s and {margin:.3g} s for the filter at "
            "each end too little of both is left to compare"
        )
    return _FilteredSignals(
        late.time[inside],
        late.position[inside],
        spline.derivative(order) if order else spline,
        spline.derivative(order + 1),
        spline.derivative(order + 2),
    )


def _best_shift(
    pair: _FilteredSignals,
    joints: tuple[str, ...],
    cutoff: float,
    longest: float,
    near: float | None,
) -> Delay:
    from scipy.optimize import minimize_scalar

    y = pair.values - pair.values.mean(axis=0)
    total = np.maximum((y**2).sum(axis=0), np.finfo(np.float64).tiny)

    def cost(shift: float) -> float:
        r = _centred(pair.reference(pair.time - shift))
        along = np.maximum((r * y).sum(axis=0), 0.0)  # a negative gain is not a delay
        power = np.maximum((r**2).sum(axis=0), np.finfo(np.float64).tiny)
        left = 1.0 - along**2 / power / total
        return float(np.log(np.maximum(left, 1e-24)).sum())

    step = 0.125 / cutoff
    if near is None:
        grid = np.arange(-np.ceil(longest / step), np.ceil(longest / step) + 1) * step
        grid = np.unique(np.clip(grid, -longest, longest))
        near = float(grid[np.argmin([cost(shift) for shift in grid])])
    low, high = max(near - step, -longest), min(near + step, longest)
    best = minimize_scalar(
        cost, bounds=(low, high), method="bounded", options={"xatol": 1e-7 / cutoff}
    )
    delay = _with_error(pair, y, float(best.x), joints, cutoff)
    alike = (delay.correlations**2 * total).sum() / total.sum()
    if not alike > _ALIKE:
        raise RecordingError(
            f"no delay up to {longest:g} s makes the signals similar: the correlations "
            f"of {', '.join(joints)} are {np.round(delay.correlations, 2).tolist()} at "
            "best. Check columns, units and signs, or raise longest"
        )
    if abs(delay.seconds) > longest * (1 - 1e-3):
        raise RecordingError(
            f"the signals are most similar with a delay of {delay.seconds:.4g} s, "
            f"the longest that was tried; raise longest = {longest:g} s"
        )
    return delay


def _with_error(
    pair: _FilteredSignals,
    y: Matrix,
    shift: float,
    joints: tuple[str, ...],
    cutoff: float,
) -> Delay:
    """Return the delay with its standard error, a jackknife over blocks."""
    from scipy.special import ndtri, stdtrit

    tiny = np.finfo(np.float64).tiny
    reference = pair.reference(pair.time - shift)
    r = _centred(reference)
    power, along = np.maximum((r**2).sum(axis=0), tiny), (r * y).sum(axis=0)
    gain = along / power
    error = y - gain * r
    variance = np.maximum((error**2).mean(axis=0), 1e-24 * (y**2).mean(axis=0) + tiny)
    slope, bend = (part(pair.time - shift) for part in (pair.slope, pair.bend))
    alone = [np.ones_like(y), r, y, slope, bend]
    products = [*alone, r * r, r * y, slope * r, slope * y, bend * y]
    span = pair.time[-1] - pair.time[0]
    number = int(np.clip(span * cutoff / _PERIODS, *_BLOCKS))
    parts = np.array_split(np.array(products), number, axis=1)
    sums = np.array([part.sum(axis=1) for part in parts])
    left = _shifts_left(sums.sum(axis=0) - sums, variance)
    few = stdtrit(number - 1, 0.975) / ndtri(0.975)
    spread = float(few * np.sqrt((number - 1) * np.var(left)))
    sizes = np.sqrt(power) * np.sqrt(np.maximum((y**2).sum(axis=0), tiny))
    return Delay(
        seconds=shift,
        standard_error=spread if np.isfinite(spread) else np.inf,
        cutoff=cutoff,
        joints=joints,
        correlations=along / sizes,
        gains=gain,
    )


def _shifts_left(sums: Array, variance: Vector) -> Vector:
    """Return a Newton step of the delay for each set of samples, all gains refitted.

    Parameters
    ----------
    sums : ndarray, shape (sets, 10, joints)
        Sums of one, ``r``, ``y``, the reference's slope ``s`` and bend ``b``, and of
        ``r r``, ``r y``, ``s r``, ``s y``, ``b y``.
    variance : ndarray, shape (joints,)
        Variance of the errors.
    """
    n, r, y, s, b, rr, ry, sr, sy, by = np.moveaxis(sums, 1, 0)
    power = np.maximum(rr - r * r / n, np.finfo(np.float64).tiny)
    gain = (ry - r * y / n) / power
    score = -gain * (sy - s * y / n - gain * (sr - s * r / n)) / variance
    # Not the mean square of the slope: noise of the reference is steep, but contains
    # no information.
    curvature = (-gain * (by - b * y / n) / variance).sum(axis=1)
    flat = curvature <= 0.0
    return np.where(flat, np.nan, score.sum(axis=1) / np.where(flat, 1.0, curvature))


def _centred(values: Matrix) -> Matrix:
    return np.asarray(values - values.mean(axis=0))
