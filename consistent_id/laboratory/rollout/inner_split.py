"""Training data in two parts, one of which fits learn from and the other judges.

Overfitting is the danger: what explains slow motion need not hold for fast.  So the
parts differ in speed, and each learns from the other.
"""

from collections.abc import Sequence

import numpy as np

from consistent_id.problems.problem import Problem
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import trimmed

_SLOW = 0.6  # of the training time is the slower part
_GUARD = 0.2  # s between the parts

Spans = tuple[tuple[float, float], ...]


def within(recordings: Sequence[Recording], spans: Spans) -> list[Recording]:
    """Return what lies within spans of time, of each recording its own span."""
    return [
        trimmed(recording, *span)
        for recording, span in zip(recordings, spans, strict=True)
        if span[1] > span[0]
    ]


def slow_and_fast(problem: Problem) -> tuple[Spans, Spans]:
    """Return the slower and the faster part of each training log, as times [s]."""
    slow, fast = [], []
    for log in problem.logs("training"):
        start, stop = float(log.time[0]), float(log.time[-1])
        ends = [
            (start, start + _SLOW * (stop - start)),
            (start + _SLOW * (stop - start) + _GUARD, stop),
        ]
        mirrored = [
            (stop - _SLOW * (stop - start), stop),
            (start, stop - _SLOW * (stop - start) - _GUARD),
        ]
        speeds = [_speed(trimmed(log, *span)) for span in ends]
        first, second = ends if speeds[0] <= speeds[1] else mirrored
        slow.append(first)
        fast.append(second)
    return tuple(slow), tuple(fast)


def _speed(log: Recording) -> float:
    """Return the mean speed over all joints, each over its range."""
    spread = np.ptp(log.position, axis=0)
    moved = abs(np.diff(log.position, axis=0)).sum(axis=0) / log.duration
    return float((moved[spread > 0.0] / spread[spread > 0.0]).mean())
