"""What coarse readings look like: the step of an encoder, and values that are held."""

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.recordings.recording import Recording

_LEVELS = 12  # fewest steps between levels that show a quantum
_REACHES = (3, 30, 300, 3000)  # multiples over which the quantum is refined in turn
_DIVISORS = 12  # of the smallest step that are tried
_OFF = 0.1  # of the quantum, by which a step may miss a multiple,
_EXACT = 1e-3  # and where there are few different multiples
_KINDS = 6  # fewest different ones
_MOST = 0.98  # of the steps that must be multiples
_ROUNDING = 1e-12  # of the largest value: steps below are rounding

_ALIKE = 0.8  # share of runs of about one length, which rounding does not make
_NEARLY = 0.1  # of that length, and a sample at least: clocks drift and jitter


def encoder_resolution(recording: Recording) -> Vector:
    """Return the step of each joint's position, shape (joints,), [rad or m].

    It is the largest number of which all steps between positions are multiples; 0 where
    there is none, as in positions that were computed, and where a joint did not move.
    A reading that is off by up to half a step has the variance ``step**2 / 12``.

    Examples
    --------
    >>> time = np.arange(500) / 100.0
    >>> read = np.round(np.sin(time) / 0.0025) * 0.0025
    >>> log = Recording(("elbow",), time, read[:, None])
    >>> encoder_resolution(log).round(12).tolist()
    [0.0025]
    """
    return np.array([quantum(values) for values in recording.position.T])


def quantum(values: Vector) -> float:
    """Return the largest number of which all differences are multiples, or 0.

    Between neighbouring levels steps are small multiples, so that neither rounding of
    the quantum nor of the values adds up.
    """
    levels = np.unique(values)
    gaps = np.diff(levels)
    gaps = gaps[gaps > _ROUNDING * abs(levels).max()]
    if len(gaps) < _LEVELS:
        return 0.0
    # A few odd values, as an interpolating logger writes, may lie between levels.
    for smallest in (gaps.min(), np.quantile(gaps, 0.01, method="lower")):
        for divisor in range(1, _DIVISORS + 1):
            step = _refined(gaps, float(smallest) / divisor)
            if step > 0.0:
                return step
    return 0.0


def _refined(gaps: Vector, step: float) -> float:
    """Return a step near the given one of which the gaps are multiples, or 0."""
    for reach in _REACHES:
        near = gaps[gaps < (reach + 0.5) * step]
        multiples = np.round(near / step)
        if not multiples.any():
            return 0.0
        step = float((multiples * near).sum() / (multiples**2).sum())
    near = gaps[gaps < (_REACHES[-1] + 0.5) * step]
    multiples = np.round(near / step)
    off = abs(near / step - multiples)
    known = len(near) >= max(_LEVELS, len(gaps) / 2)
    # Steps of a motion at even speed are all alike, though not exactly.
    nearly = _OFF if len(np.unique(multiples)) >= _KINDS else _EXACT
    return step if known and (off <= nearly).mean() >= _MOST else 0.0


def held_samples(values: Vector) -> int:
    """Return for how many samples a channel holds each of its readings; 1 if it is new.

    Runs of one value are about as long as each other where a slower channel is sampled
    and held, and of any length where readings are rounded or clipped.

    Examples
    --------
    >>> held_samples(np.repeat(np.sin(np.arange(50.0)), 4))
    4
    >>> held_samples(np.round(3.0 * np.sin(0.02 * np.arange(1000.0))))
    1
    """
    edges = np.flatnonzero(np.diff(values) != 0.0)
    runs = np.diff(edges)  # whole ones, between two changes
    if len(runs) == 0:
        return 1
    usual = int(np.median(runs))
    alike = abs(runs - usual) <= max(_NEARLY * usual, 1.0)
    return usual if usual > 1 and alike.mean() >= _ALIKE else 1
