"""Validation that is also in training: the same rows, or the same motion.

A repeated period may be sampled at other phases and another rate, so that spans of one
recording are laid over the other at the time at which they fit best.
"""

from collections.abc import Sequence

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.recordings.recording import Recording, positions_at

_SAME = 2e-3  # share of a joint's range within which two positions are equal
_MOVED = 10.0  # times that: least travel of some joint within a span
_SPANS = 40  # spans of a recording, each half a second or longer
_SHORTEST = 0.5  # s
_POINTS = 25  # samples of a span at which positions are compared
_RATE = 200.0  # Hz: a higher rate shows no more
_STARTS = 20  # places in the other recording at which a span is tried
_REPEATED = 0.1  # least share of rows or moving spans that is reported


def leak_findings(
    training: Sequence[Recording], validation: Sequence[Recording]
) -> list[LogFinding]:
    """Find validation rows and validation motions that are also in training.

    Equal rows are a fault.  A motion that is played again is a common experiment, with
    noise of its own: a note.
    """
    found = []
    for log in validation:
        for earlier in training:
            if (share := shared_rows(log, earlier)) >= _REPEATED:
                found.append(_leak(log, earlier, share))
            elif (share := repeated_share(log, earlier)) >= _REPEATED:
                found.append(_repeated(log, earlier, share))
    return found


def _leak(log: Recording, earlier: Recording, share: float) -> LogFinding:
    return LogFinding(
        "leak",
        "fault",
        log.name,
        f"{share:.0%} of the rows of {log.name} are also in {earlier.name}",
        "validate with rows that were not used for training",
        share / _REPEATED,
        log.name,
    )


def _repeated(log: Recording, earlier: Recording, share: float) -> LogFinding:
    return LogFinding(
        "repeated motion",
        "note",
        log.name,
        f"{share:.0%} of the motion of {log.name} repeats {earlier.name}, to within "
        f"{_SAME:.1%} of the joints' ranges: split by whole periods, average or fold "
        "them; another motion is a better test, because a repeated one has the same "
        "model errors and differs only in noise",
        "also validate with another motion",
        share / _REPEATED,
        log.name,
    )


def shared_rows(validation: Recording, training: Recording) -> float:
    """Return the share of a recording's rows that are also in another.

    Rows are equal if positions and torque are equal in every digit; without torque, if
    positions and time are.
    """
    rows, others = (
        {row.tobytes() for row in _rows(log.of(training.joints), with_torque)}
        for with_torque in (
            validation.torque is not None and training.torque is not None,
        )
        for log in (validation, training)
    )
    return len(rows & others) / len(rows)


def _rows(recording: Recording, with_torque: bool) -> Array:
    beside = recording.torque if with_torque else recording.time[:, None]
    return np.column_stack([recording.position, np.asarray(beside)]) + 0.0


def repeated_share(validation: Recording, training: Recording) -> float:
    """Return the share of a recording's moving spans that occur in another."""
    training = training.samples(slice(None, None, max(int(training.rate / _RATE), 1)))
    tolerance = _SAME * np.ptp(training.position, axis=0)
    tolerance = np.where(tolerance > 0.0, tolerance, 1e-12)
    length = max(_SHORTEST, validation.duration / _SPANS)
    starts = validation.time[0] + length * np.arange(int(validation.duration / length))
    moving = hits = 0
    for start in starts:
        lapse = np.linspace(0.0, length, _POINTS)
        span = positions_at(validation.of(training.joints), start + lapse)
        if (np.ptp(span, axis=0) > _MOVED * tolerance).any():
            moving += 1
            hits += _occurs(span, lapse, training, tolerance)
    return hits / max(moving, 1)


def _occurs(span: Array, lapse: Vector, training: Recording, tolerance: Vector) -> bool:
    """Return whether a span occurs in a recording, at any time."""
    steps = abs(np.diff(training.position, axis=0, append=training.position[-1:]))
    away = abs(training.position - span[0])
    near = np.flatnonzero((away <= tolerance + steps).all(axis=1))
    nearest = near[np.argsort((away[near] / tolerance).max(axis=1))[:_STARTS]]
    return any(
        _lies_on(span, lapse, training, tolerance, float(training.time[i]))
        for i in nearest
    )


def _lies_on(
    span: Array, lapse: Vector, training: Recording, tolerance: Vector, start: float
) -> bool:
    """Return whether a span occurs near a start time.

    The time is refined by Gauss-Newton.
    """
    last = training.time[-1] - lapse[-1]
    for _ in range(3):
        if not training.time[0] - lapse[1] <= start <= last + lapse[1]:
            return False
        there = positions_at(training, start + lapse)
        if (abs(there - span) <= tolerance).all():
            return True
        rate = np.gradient(there, lapse, axis=0) / tolerance
        size = float(np.sum(rate**2))
        if size == 0.0:
            return False
        start += float(np.sum(rate * (span - there) / tolerance)) / size
    return False
