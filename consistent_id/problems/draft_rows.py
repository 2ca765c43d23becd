"""The rows of a log for a draft: motion, for training and for validation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from consistent_id.errors import RecordingError
from consistent_id.problems.draft import DraftRecording, Role
from consistent_id.problems.file import PreparationTable, RecordingTable
from consistent_id.problems.log_entries import span_of
from consistent_id.problems.preparation import prepared
from consistent_id.problems.statement import Statement
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import estimated_period, standstill, trimmed
from consistent_id.recordings.signals.clocks import is_uniform, own_rate
from consistent_id.recordings.signals.repetitions import whole_periods

SHARE = 0.2
"""Share of the sampling rate up to which a cut-off is tried."""

_TRAINING = 0.7  # of the motion; the rest is for validation
_PERIOD = 0.02  # of the motion: with shorter periods, training may end within one
_MOVES = 0.02  # rad or m: a joint with less travel rests
_HARDLY = 0.2  # of its travel, below which a joint hardly moves
_LEAST = 0.05  # of the motion: a shorter validation part tells nothing
_GAP = 10.0  # steps without a sample
_ALIKE = 1.25  # ratio of rates up to which one resampled rate suffices for both


class Clock(NamedTuple):
    """Settings for uniform clocks of logs: a rate [Hz], and the longest gap [s]."""

    resample: float | None
    max_gap: float | None


@dataclass(frozen=True, slots=True)
class Split:
    """Logs, divided into rows for training and for validation.

    Parameters
    ----------
    training : tuple of Recording
        The parts for training.
    """

    entries: tuple[DraftRecording, ...]
    training: tuple[Recording, ...]


def split_logs(
    logs: Mapping[Path, Recording], clock: Clock, stated: Statement, *, whole: bool
) -> Split:
    """Divide logs; if a log is for training only, keep all its motion.

    Raises
    ------
    RecordingError
        If no joint ever moves.
    """
    entries, parts = list[DraftRecording](), list[Recording]()
    for file, raw in logs.items():
        kept = _kept(raw, file, stated)
        start, stop = _moving(kept, clock)
        middle = stop
        if not whole:
            middle = start + _training(kept, stop - start)
            middle = _with_all_joints(trimmed(kept, start, stop), middle)
        entries += _entries(file, raw, stated, (start, middle, stop))
        parts.append(trimmed(raw, start, middle))
    return Split(tuple(entries), tuple(parts))


def _kept(raw: Recording, file: Path, stated: Statement) -> Recording:
    """Return the stated rows; all rows if none are stated."""
    if stated.rows_of(file) is None:
        return raw
    entry = _entry(file, "training", stated, stated.rows_of(file))
    return trimmed(raw, *span_of(raw, entry))


def _entry(
    file: Path, role: Role, stated: Statement, rows: tuple[int, int] | None
) -> RecordingTable:
    """Return the table of a recording, for functions that read its rows."""
    omit = list(stated.omitted_of(file))
    kept = None if rows is None else list(rows)
    return RecordingTable(file=str(file), role=role, rows=kept, omit=omit)


def _entries(
    file: Path, raw: Recording, stated: Statement, times: tuple[float, float, float]
) -> list[DraftRecording]:
    """Return the rows that are for training and, after the middle, for validation.

    Parameters
    ----------
    times : tuple of float
        When training begins, where it ends and validation begins, the end [s].
    """
    start, middle, stop = times
    first, last = _rows(raw, start, middle)
    omitted = stated.omitted_of(file)

    def entry(role: Role, first: int, last: int) -> DraftRecording:
        return DraftRecording(file, role, (_row(first, omitted), _row(last, omitted)))

    if middle >= stop:
        return [entry("training", first, last)]
    end = _rows(raw, start, stop)[1]
    return [entry("training", first, last - 1), entry("validation", last, end)]


def _rows(raw: Recording, start: float, stop: float) -> tuple[int, int]:
    """Return the first and the last row between two times, counted from 1."""
    first, last = np.searchsorted(raw.time, [start, stop]).tolist()
    return first + 1, min(last + 1, len(raw))


def _row(row: int, omitted: Sequence[int]) -> int:
    """Return the number of a row in its file, where omitted rows count, too."""
    for other in sorted(set(omitted)):
        row += other <= row
    return row


def _training(raw: Recording, duration: float) -> float:
    """Return the duration of the training [s]: whole periods, if the motion repeats."""
    share = _TRAINING * duration
    try:
        period = estimated_period(raw, shortest=_PERIOD * duration)
    except RecordingError:
        return share
    whole = whole_periods(duration, period, raw.duration / (len(raw) - 1))
    if whole < 2:
        return share
    return period * min(max(round(_TRAINING * whole), 1), whole - 1)


def _with_all_joints(moving: Recording, middle: float) -> float:
    """Return the end of training, put off where a joint hardly moves before it [s].

    Joints may move one after another: training would tell nothing of the last ones.
    Where next to nothing is left for validation, it is the end of the motion.
    """
    q = moving.position
    travel = np.maximum.accumulate(q) - np.minimum.accumulate(q)
    travel = travel[:, travel[-1] > _MOVES]
    reached = travel / travel[-1]
    if (reached[np.searchsorted(moving.time, middle) - 1] >= _HARDLY).all():
        return middle
    all_moved = int(np.argmax((reached >= _TRAINING).all(axis=1)))
    left = moving.time[-1] - moving.time[all_moved]
    end = all_moved if left >= _LEAST * moving.duration else -1
    return float(moving.time[end])


def clock_with(
    training: Sequence[Recording],
    held_out: Sequence[Recording],
    longest: float | None = None,
) -> Clock:
    """Return the settings for uniform clocks of training logs, and of held-out ones.

    Raises
    ------
    RecordingError
        If one uniform rate does not fit all logs that need one.
    """
    own = clock_of(training, longest)
    if own.resample is None and not all(map(is_uniform, held_out)):
        return clock_of([*training, *held_out], longest)
    return own._replace(max_gap=_longest_gap([*training, *held_out], longest))


def clock_of(raws: Sequence[Recording], longest: float | None = None) -> Clock:
    """Return the settings for uniform clocks, with the longest gap if it is stated.

    Raises
    ------
    RecordingError
        If one uniform rate does not fit all.
    """
    rates = [own_rate(raw) for raw in raws]
    max_gap = _longest_gap(raws, longest)
    if all(is_uniform(raw) for raw in raws):
        return Clock(None, max_gap)
    if max(rates) > _ALIKE * min(rates):
        seen = ", ".join(
            f"{raw.name} {rate:.4g} Hz" for raw, rate in zip(raws, rates, strict=True)
        )
        raise RecordingError(
            f"clocks jitter, and the logs' rates differ too much to be resampled to "
            f"one: {seen}. Resample the faster ones first"
        )
    return Clock(float(f"{min(rates):.4g}"), max_gap)


def _longest_gap(raws: Sequence[Recording], longest: float | None) -> float | None:
    """Return the longest gap that is no cut [s]; None if no log has a gap."""
    if longest is not None:
        return longest
    rates = [own_rate(raw) for raw in raws]
    each = zip(raws, rates, strict=True)
    steps = [float(np.diff(raw.time).max()) * rate for raw, rate in each]
    return float(f"{_GAP / min(rates):.3g}") if max(steps) > _GAP else None


def moving_rows(
    raw: Recording, file: Path, clock: Clock, stated: Statement
) -> tuple[int, int]:
    """Return the first and the last row between which joints move, counted from 1."""
    first, last = _rows(raw, *_moving(_kept(raw, file, stated), clock))
    omitted = stated.omitted_of(file)
    return _row(first, omitted), _row(last, omitted)


def _moving(raw: Recording, clock: Clock) -> tuple[float, float]:
    """Return when the first joint begins to move, and when the last one stops [s]."""
    low = min(10.0, SHARE * own_rate(raw))
    table = PreparationTable(
        max_gap=clock.max_gap, resample=clock.resample, motion_cutoff=low
    )
    times = [
        part.time[~standstill(part).all(axis=1)]
        for part in prepared(raw, table)
        if part.velocity is not None and part.velocity.any()
    ]
    moving = np.concatenate([np.empty(0), *times])
    if len(moving) < 2:
        raise RecordingError(f"{raw.name}: no joint ever moves")
    return float(moving[0]), float(moving[-1])
