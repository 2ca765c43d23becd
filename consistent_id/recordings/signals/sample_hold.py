"""Readings that are held: a channel slower than the log repeats its last value."""

import numpy as np

from consistent_id._support.arrays import Vector

_ALIKE = 0.8  # share of runs of about one length, which rounding does not make
_NEARLY = 0.1  # of that length, and a sample at least: clocks drift and jitter


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
