"""Which rows of a log a draft takes: what moves, for training and for validation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from consistent_id.errors import RecordingError
from consistent_id.problems.draft import DraftRecording
from consistent_id.problems.file import PreparationTable
from consistent_id.problems.preparation import prepared
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import estimated_period, standstill, trimmed
from consistent_id.recordings.signals.clocks import is_uniform, own_rate

SHARE = 0.2
"""Share of the sampling rate up to which a cut-off is tried."""

_TRAINING = 0.7  # of the motion; the rest is for validation
_PERIOD = 0.02  # of the motion: shorter periods need no whole ones
_GAP = 10.0  # steps without a sample
_ALIKE = 1.25  # ratio of rates up to which one resampled rate does for both


class Clock(NamedTuple):
    """What makes the clocks of logs uniform: a rate [Hz], and the longest gap [s]."""

    resample: float | None
    max_gap: float | None


@dataclass(frozen=True, slots=True)
class Split:
    """Logs divided into rows for training and for validation.

    Parameters
    ----------
    training : tuple of Recording
        The parts for training.
    """

    entries: tuple[DraftRecording, ...]
    training: tuple[Recording, ...]


def split_logs(logs: Mapping[Path, Recording], clock: Clock, *, whole: bool) -> Split:
    """Divide logs; if each is wholly for training, what moves of it.

    Raises
    ------
    RecordingError
        If no joint ever moves.
    """
    entries, parts = list[DraftRecording](), list[Recording]()
    for file, raw in logs.items():
        start, stop = _moving(raw, clock)
        middle = stop if whole else start + _training(raw, stop - start)
        entries += _entries(file, raw, start, middle, stop)
        parts.append(trimmed(raw, start, middle))
    return Split(tuple(entries), tuple(parts))


def _entries(
    file: Path, raw: Recording, start: float, middle: float, stop: float
) -> list[DraftRecording]:
    """Return the rows that are for training and, after the middle, for validation."""
    first, last = _rows(raw, start, middle)
    if middle >= stop:
        return [DraftRecording(file, "training", (first, last))]
    last -= 1
    end = _rows(raw, start, stop)[1]
    return [
        DraftRecording(file, "training", (first, last)),
        DraftRecording(file, "validation", (last + 1, end)),
    ]


def _rows(raw: Recording, start: float, stop: float) -> tuple[int, int]:
    """Return the first and the last row between two times, counted from 1."""
    first, last = np.searchsorted(raw.time, [start, stop]).tolist()
    return first + 1, min(last + 1, len(raw))


def _training(raw: Recording, duration: float) -> float:
    """Return how long the training lasts [s]: whole periods, where motion repeats."""
    share = _TRAINING * duration
    try:
        period = estimated_period(raw, shortest=_PERIOD * duration)
    except RecordingError:
        return share
    whole = int(duration / period)
    if whole < 2:
        return share
    return period * min(max(round(_TRAINING * whole), 1), whole - 1)


def clock_of(raws: Sequence[Recording]) -> Clock:
    """Return what makes the logs' clocks uniform.

    Raises
    ------
    RecordingError
        If one uniform rate does not do for all.
    """
    rates = [own_rate(raw) for raw in raws]
    steps = [
        float(np.diff(raw.time).max()) * rate
        for raw, rate in zip(raws, rates, strict=True)
    ]
    max_gap = float(f"{_GAP / min(rates):.3g}") if max(steps) > _GAP else None
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


def moving_rows(raw: Recording, clock: Clock) -> tuple[int, int]:
    """Return the first and the last row between which joints move, counted from 1."""
    return _rows(raw, *_moving(raw, clock))


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
