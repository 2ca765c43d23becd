"""The slower and the faster part of training logs, each of which judges the other."""

from collections.abc import Sequence

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import RecordingError
from consistent_id.problems.problem import Problem
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import trimmed

_SLOW_PART = 0.6  # of the training time is the slower part
_BETWEEN_PARTS = 0.2  # s between the parts
_REST = 0.5  # s of rest before and after motion belong to it
_AT_REST = 0.01  # of a joint's range: noise of an encoder is not motion

Spans = tuple[tuple[float, float], ...]


def within(recordings: Sequence[Recording], spans: Spans) -> list[Recording]:
    """Return recordings within spans of time, one span for each."""
    return [
        trimmed(recording, *span)
        for recording, span in zip(recordings, spans, strict=True)
        if span[1] > span[0]
    ]


def slow_and_fast(problem: Problem) -> tuple[Spans, Spans]:
    """Return the slower and the faster part of each training log, as times [s].

    The time from the first to the last motion is split; longer rest before and
    after it is in no part.  A log with too little motion for two parts has empty ones.

    Raises
    ------
    RecordingError
        If no log has enough motion.
    """
    slow, fast = [], []
    logs = problem.logs("training")
    moving = [_moving(log) for log in logs]
    enough = [_BETWEEN_PARTS < (1.0 - _SLOW_PART) * (b - a) for a, b in moving]
    if not any(enough):
        longest = max((stop - start for start, stop in moving), default=0.0)
        raise RecordingError(
            f"problem {problem.name!r}: the joints move for {longest:.2g} s at most; "
            f"two parts, each of which judges the other, need more than "
            f"{_BETWEEN_PARTS / (1.0 - _SLOW_PART):.2g} s in a training log"
        )
    for log, (start, stop), usable in zip(logs, moving, enough, strict=True):
        if not usable:
            slow.append((start, start))
            fast.append((start, start))
            continue
        ends = [
            (start, start + _SLOW_PART * (stop - start)),
            (start + _SLOW_PART * (stop - start) + _BETWEEN_PARTS, stop),
        ]
        mirrored = [
            (stop - _SLOW_PART * (stop - start), stop),
            (start, stop - _SLOW_PART * (stop - start) - _BETWEEN_PARTS),
        ]
        spread = np.ptp(log.position, axis=0)
        speeds = [_speed(trimmed(log, *span), spread) for span in ends]
        first, second = ends if speeds[0] <= speeds[1] else mirrored
        slow.append(first)
        fast.append(second)
    return tuple(slow), tuple(fast)


def _moving(log: Recording) -> tuple[float, float]:
    """Return when a log's motion begins and ends [s].

    It moves where a joint has left its first, or has not reached its last position, by
    a share of its range.
    """
    spread = np.ptp(log.position, axis=0)
    near = np.where(spread > 0.0, _AT_REST * spread, np.inf)
    left = np.flatnonzero((abs(log.position - log.position[0]) > near).any(axis=1))
    late = np.flatnonzero((abs(log.position - log.position[-1]) > near).any(axis=1))
    if not len(left):
        return float(log.time[0]), float(log.time[0])
    first, last = (float(t) for t in (log.time[left[0]], log.time[late[-1]]))
    start, stop = float(log.time[0]), float(log.time[-1])
    return (
        first - _REST if first - start > _REST else start,
        last + _REST if stop - last > _REST else stop,
    )


def _speed(log: Recording, spread: Vector) -> float:
    """Return the mean speed over all joints, each over its range in the whole log."""
    moved = abs(np.diff(log.position, axis=0)).sum(axis=0) / log.duration
    return float((moved[spread > 0.0] / spread[spread > 0.0]).mean())
