"""Time stamps of a log: their unit, their faults, and the option that repairs them."""

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import BoolArray, Vector
from consistent_id.errors import RecordingError

LATEST = 1e12
"""Latest time [s], in some 30 000 years: no clock beyond it resolves milliseconds."""

_USUAL_STEP = (5e-5, 0.5)  # s, between samples of a robot's log
LEAST_STEP = 2e-5  # s: no log of a robot is as fast, but one in hours
_COMMON_STEP = 4e-3  # s
_FROM_1970 = (1e9, 3e9)  # s, from the year 2001 to 2065
_TICKS = ("100ns", 1e-7)
_LONG = {"min": 60.0, "h": 3600.0, "day": 86400.0}
_TICKS_FROM = (1.2e17, 6.6e17)  # from 1601 or the year 1 to this century


class SampleError(RecordingError):
    """Samples have values that no robot wrote; readers add the place in the file."""


def unit_option(time: Vector) -> str:
    """Return the option with the unit in which a clock has usual steps; empty for s.

    Clocks that count from 1970 have the unit that this implies.  Days of spreadsheets
    and ticks of 100 ns count from other years.  Steps that are too short are of the
    longer unit in which they are nearest to those of most logs.

    Examples
    --------
    >>> unit_option(np.array([0.0, 4.0, 8.0])), unit_option(np.array([0.0, 0.004]))
    ('--units time=ms', '')
    >>> unit_option(1.7e15 + np.array([0.0, 100.0])), unit_option(np.array([0.0, 1e-7]))
    ('--units time=us', '--units time=day')
    >>> unit_option(np.array([0.0, 0.004 / 3600.0]))
    '--units time=h'
    """
    with np.errstate(over="ignore"):
        step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    if 0.0 < step < LEAST_STEP:
        off = {u: abs(np.log(f * step / _COMMON_STEP)) for u, f in _LONG.items()}
        return f"--units time={min(off, key=lambda unit: off[unit])}"
    if step <= _USUAL_STEP[1]:
        return ""
    units = [("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)]
    if _TICKS_FROM[0] < time[0] < _TICKS_FROM[1]:
        units = [_TICKS]
    now = [(u, f) for u, f in units if _FROM_1970[0] < f * time[0] < _FROM_1970[1]]
    for unit, factor in now or units:
        if _USUAL_STEP[0] <= factor * step <= _USUAL_STEP[1]:
            return f"--units time={unit}"
    return ""


def _has_usual_steps(time: Vector) -> bool:
    """Return whether most steps of a clock are as long as those of logs in seconds."""
    with np.errstate(over="ignore"):
        steps = np.diff(time)
    usual = (_USUAL_STEP[0] <= steps) & (steps <= _USUAL_STEP[1])
    return bool(usual.sum() > 0.5 * len(steps))


def _rate_option(time: Vector) -> str:
    """Return the option with the rate of samples of rounded stamps; empty of others.

    Those of one instant are about as many as those of another.

    Examples
    --------
    >>> _rate_option(np.floor(np.arange(500) / 125.0)), _rate_option(np.arange(9.0))
    ('--time 125Hz', '')
    """
    steps = np.diff(time)
    changes = np.flatnonzero(steps) + 1
    if (steps < 0.0).any() or not 2 < len(changes) < len(steps) / 3:
        return ""
    runs = np.diff(np.concatenate([[0], changes, [len(time)]]))
    if runs.max() > 2.0 * np.median(runs):
        return ""  # a clock that stands still for a while
    first, last = changes[0], changes[-1]
    rate = (last - first) / (time[last] - time[first])
    # The first and the last change are each known to a sample.
    whole = round(rate)
    exact = abs(rate - whole) <= 2.0 * rate / (last - first)
    return f"--time {whole if exact else float(f'{rate:.4g}'):g}Hz"


def require_stamps(time: Vector, position: ArrayLike, name: str) -> None:
    """Refuse stamps that are not finite, rounded, not in seconds, or do not increase.

    Parameters
    ----------
    time : ndarray, shape (samples,), [s]
    position : array_like, shape (samples, joints)
        Of the same samples; not checked yet.
    name : str
        Name of the recording, for messages.

    Raises
    ------
    SampleError
        With the option that repairs it, if there is one.
    """
    _require_seconds(time, name)
    steps = np.diff(time)
    option = _rate_option(time)
    if option and _moves(position, steps == 0.0):  # else rows are repeated
        raise SampleError(
            f"{name}: time stamps are rounded: most samples have that of the "
            f"sample before. If the samples are evenly spaced: {option}",
            options=option,
        )
    if (steps > 0.0).all():
        return
    bad = int(np.argmax(steps <= 0.0))
    advice = (
        'Sort the samples; of repeated ones take one: duplicates = "first" '
        "(--duplicates first)"
    )
    options = "--duplicates first" if (steps >= 0.0).all() else ""
    if not steps.any() and len(steps) > 1:
        options = "--time RATEHz"
        advice = (
            "All samples have this time. If they are evenly spaced, state "
            f"their rate: {options} (such as 1000Hz)"
        )
    raise SampleError(
        f"{name}: time goes from {time[bad]:.15g} s (sample {bad}) to "
        f"{time[bad + 1]:.15g} s; it must increase. {advice}",
        options=options,
    )


def _require_seconds(time: Vector, name: str) -> None:
    """Refuse stamps that are not finite, or too large to be seconds."""
    if not np.isfinite(time).all():
        bad = int(np.argmin(np.isfinite(time)))
        raise SampleError(f"{name}: time of sample {bad} is {time[bad]}")
    if abs(time).max() > LATEST:
        bad, option = int(np.argmax(abs(time))), unit_option(time)
        advice = f". State the unit: {option or '--units time=ns (or us, ms)'}"
        if _has_usual_steps(time):
            advice = ", as most steps of this clock are: that stamp is broken"
        raise SampleError(
            f"{name}: time of sample {bad} is {time[bad]:.3g} s, expected "
            f"seconds{advice}",
            options=option,
        )


def _moves(position: ArrayLike, steps: BoolArray) -> bool:
    """Return whether positions change in some steps."""
    position = np.asarray(position)
    if len(position) != len(steps) + 1:
        return False
    return bool(np.diff(position, axis=0)[steps].any())
