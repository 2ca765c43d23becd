"""By how much one signal is later than another of the same motion.

With ``r`` the reference, differentiated as often as needed, and ``y`` the late signal,
both filtered alike,

    y(t) = gain r(t - delay) + offset + error,

with a gain, an offset and an error variance for each joint and one delay for all.  The
delay maximises the likelihood, ``-sum_j log (sum of squared errors of joint j)``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector, freeze_arrays
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import is_uniform, own_rate, resampled
from consistent_id.recordings.signals.filters import low_passed
from consistent_id.recordings.signals.track import Track

_ORDER = {"position": 0, "velocity": 1, "acceleration": 2}
_BAND = 8.0  # sampling rate over the highest cut-off: splines are exact below
_ALIKE = 0.5  # share of the variance that one motion explains, at least
_BLOCKS = (16, 64)  # fewest and most blocks for the standard error


@dataclass(frozen=True, slots=True, eq=False)
class Delay:
    """A delay, and how sure it is.

    Parameters
    ----------
    seconds : float, [s]
        By which the second signal comes later than the first.
    standard_error : float, [s]
        From the scatter of blocks of consecutive samples, so errors may be correlated
        within a block.
    cutoff : float, [Hz]
        To which both signals were filtered.
    joints : tuple of str
    correlations, gains : ndarray, shape (joints,)
        Of the two signals with the delay taken out; the gain is that of the second.
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
    """Estimate by how much `late` comes later than `reference`.

    Parameters
    ----------
    reference, late : Track
        Of the same joints, each on its own clock.  Of position, velocity and
        acceleration the lower derivative is differentiated; a torque is compared with
        a torque.
    longest : float, [s]
        Longest delay looked for, either way.  For periodic motion less than half a
        period.
    cutoff : float, optional, [Hz]
        To which both are filtered; by default, of a series in which each is half the
        one before, the one with the least standard error.

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
    cutoffs = _cutoffs(first, second) if cutoff is None else [cutoff]
    found: list[Delay] = []
    for frequency in cutoffs:
        pair = _filtered_pair(first, second, order, frequency, longest, min(cutoffs))
        near = found[-1].seconds if found else None
        found.append(_best_shift(pair, joints, frequency, longest, near))
    return min(found, key=lambda delay: delay.standard_error)


class _Pair(NamedTuple):
    """Late values on their clock, and the reference at any time, both filtered."""

    time: Vector
    values: Matrix
    reference: Callable[[Vector], Matrix]
    slope: Callable[[Vector], Matrix]
    bend: Callable[[Vector], Matrix]


def _derivatives(reference: Track, late: Track) -> int:
    names = (reference.channel, late.channel)
    if "torque" not in names:
        return _ORDER[names[1]] - _ORDER[names[0]]
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


def _cutoffs(first: Recording, second: Recording) -> list[float]:
    """Return cut-offs that leave most of the late signal, the lowest first."""
    highest = min(first.rate, second.rate) / _BAND
    spread = second.position.var(axis=0).sum()
    cutoffs = [highest]
    while (lower := cutoffs[0] / 2.0) * second.duration > 10.0:
        smooth = low_passed(second, motion_cutoff=lower).position
        if smooth.var(axis=0).sum() < 0.5 * spread:
            break
        cutoffs.insert(0, lower)
    return cutoffs


def _filtered_pair(
    first: Recording,
    second: Recording,
    order: int,
    cutoff: float,
    longest: float,
    lowest: float,
) -> _Pair:
    from scipy.interpolate import make_interp_spline

    smooth = low_passed(first, motion_cutoff=cutoff)
    late = low_passed(second, motion_cutoff=cutoff)
    spline = make_interp_spline(smooth.time, smooth.position, k=5)
    # What was assumed beyond the ends has died out one period of the cut-off inside.
    margin = 1.0 / lowest
    start = max(first.time[0] + longest, second.time[0]) + margin
    stop = min(first.time[-1] - longest, second.time[-1]) - margin
    inside = np.flatnonzero((late.time >= start) & (late.time <= stop))
    # A filtered signal is all there in a few samples for each period of the cut-off.
    inside = inside[:: max(int(late.rate / (2.0 * _BAND * cutoff)), 1)]
    if len(inside) < 4 * _BLOCKS[0]:
        raise RecordingError(
            f"{first.name} runs from {first.time[0]:.6g} s to {first.time[-1]:.6g} s, "
            f"{second.name} from {second.time[0]:.6g} s to {second.time[-1]:.6g} s: "
            f"with delays up to {longest:g} s and {margin:.3g} s for the filter at "
            "each end too little of both is left to compare"
        )
    return _Pair(
        late.time[inside],
        late.position[inside],
        spline.derivative(order) if order else spline,
        spline.derivative(order + 1),
        spline.derivative(order + 2),
    )


def _best_shift(
    pair: _Pair,
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
        along = np.maximum((r * y).sum(axis=0), 0.0)  # a gain below zero is no delay
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
            f"no delay up to {longest:g} s makes the signals alike: the correlations "
            f"of {', '.join(joints)} are {np.round(delay.correlations, 2).tolist()} at "
            "best. Check columns, units and signs, or raise longest"
        )
    if abs(delay.seconds) > longest * (1 - 1e-3):
        raise RecordingError(
            f"the signals are most alike with a delay of {delay.seconds:.4g} s, the "
            f"longest that was looked for; raise longest = {longest:g} s"
        )
    return delay


def _with_error(
    pair: _Pair, y: Matrix, shift: float, joints: tuple[str, ...], cutoff: float
) -> Delay:
    """Return the delay with its sandwich standard error over blocks."""
    tiny = np.finfo(np.float64).tiny
    r = _centred(pair.reference(pair.time - shift))
    power, along = np.maximum((r**2).sum(axis=0), tiny), (r * y).sum(axis=0)
    gain = along / power
    error = y - gain * r
    J = -gain * _centred(pair.slope(pair.time - shift))
    J -= r * ((r * J).sum(axis=0) / power)
    # Not the mean of J^2: noise of the reference is steep, yet holds no information.
    bend = -gain * _centred(pair.bend(pair.time - shift))
    variance = np.maximum((error**2).mean(axis=0), 1e-24 * (y**2).mean(axis=0) + tiny)
    scores = (J * error / variance).sum(axis=1)
    curvature = (bend * y / variance).sum()
    span = pair.time[-1] - pair.time[0]
    number = int(np.clip(span * cutoff / 4.0, *_BLOCKS))
    sizes = np.sqrt(power) * np.sqrt(np.maximum((y**2).sum(axis=0), tiny))
    sums = np.array([part.sum() for part in np.array_split(scores, number)])
    spread = np.sqrt(number / (number - 1) * (sums**2).sum())
    return Delay(
        seconds=shift,
        standard_error=float(spread / curvature) if curvature > 0.0 else np.inf,
        cutoff=cutoff,
        joints=joints,
        correlations=along / sizes,
        gains=gain,
    )


def _centred(values: Matrix) -> Matrix:
    return np.asarray(values - values.mean(axis=0))
