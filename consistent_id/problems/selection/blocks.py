"""Blocks of equal motion, which cross-validation leaves out in turn.

Blocks are phases where the motion repeats itself, else stretches of time: what is left
out has no like among what is fitted.  The same share of every recording is left out at
once, so that two recordings of one motion do not stand in for each other.
"""

from fractions import Fraction
from functools import lru_cache

import numpy as np

from consistent_id._support.arrays import BoolArray, IntArray, Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import estimated_period

NUMBERS = (8, 6)
"""Numbers of blocks over which errors are averaged: one alone moves a robot's error by
up to 30 %."""

_SHORTEST = 0.02  # of the motion: shorter periods need no whole ones
_WHOLE = 2  # periods that a motion has to hold, to be left out by phase

EDGES = tuple(
    float(edge)
    for edge in sorted({Fraction(k, n) for n in NUMBERS for k in range(n + 1)})
)
"""Where a block begins or ends, as shares of a motion: the edges of all cells."""


@lru_cache(maxsize=1)
def folds() -> tuple[tuple[int, tuple[int, ...]], ...]:
    """Return the blocks: of how many each is one, and its cells.

    Examples
    --------
    >>> folds()[0]
    (8, (0,))
    >>> len(folds()), folds()[8]
    (14, (6, (0, 1)))
    """
    middles = (np.array(EDGES[1:]) + np.array(EDGES[:-1])) / 2
    found = []
    for n in NUMBERS:
        for k in range(n):
            inside = np.flatnonzero((middles > k / n) & (middles < (k + 1) / n))
            found.append((n, tuple(inside.tolist())))
    return tuple(found)


@lru_cache(maxsize=1)
def left_out() -> BoolArray:
    """Return which cells each block is made of, shape (blocks, cells)."""
    cells = np.arange(len(EDGES) - 1)
    return np.array([np.isin(cells, out) for _, out in folds()])


def motion_period(raw: Recording) -> float | None:
    """Return the period [s] of a motion that repeats itself, if it does."""
    try:
        period = estimated_period(raw, shortest=_SHORTEST * raw.duration)
    except RecordingError:
        return None
    return period if raw.duration >= _WHOLE * period else None


def cells(
    time: Vector, start: float, duration: float, period: float | None, guard: float
) -> IntArray:
    """Return the cell of each sample; -1 for those near an edge.

    Parameters
    ----------
    time : ndarray, [s]
    start, duration : float, [s]
        Of the recording.
    period : float, optional, [s]
        Of a motion that repeats itself.
    guard : float, [s]
        Samples so near to an edge belong to no cell: filters and the correlation of
        noise have mixed them with what lies beyond.
    """
    length = duration if period is None else period
    share = np.clip((time - start) / length, 0.0, None)
    share = np.minimum(share, 1.0 - 1e-12) if period is None else share % 1.0
    edges = np.array(EDGES)
    place = np.clip(np.searchsorted(edges, share, "right") - 1, 0, len(edges) - 2)
    nearest = np.minimum(share - edges[place], edges[place + 1] - share)
    return np.where(nearest * length < guard, -1, place)
