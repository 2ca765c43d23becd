"""Logs from a caller: files, tables in memory, recordings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from consistent_id._support.arrays import Vector
from consistent_id._support.files import local_path
from consistent_id.errors import ProblemError, RecordingError
from consistent_id.recordings.readers.data_frames import ColumnTable, as_wide_table
from consistent_id.recordings.recording import Recording

GivenLog = str | Path | ColumnTable | Recording
"""A log: a file; a data frame, an Arrow table or a mapping of arrays; a recording."""

_COLUMNS = {
    "position": "q",
    "velocity": "dq",
    "torque": "tau",
    "position_command": "q_des",
}
_BESIDE = ("base", "wrenches", "contacts", "torque_known")


@dataclass(frozen=True, slots=True, eq=False)
class GivenLogs:
    """Logs by path; a table in memory has a made-up path.

    Parameters
    ----------
    tables : mapping of Path to ColumnTable
        Tables in memory, with a row for each instant.
    notes : tuple of str
        Sentences on tables that had a row for each joint and instant.
    """

    training: tuple[Path, ...]
    validation: tuple[Path, ...]
    tables: Mapping[Path, ColumnTable]
    notes: tuple[str, ...] = ()


def given_logs(
    training: GivenLog | Sequence[GivenLog], validation: GivenLog | Sequence[GivenLog]
) -> GivenLogs:
    """Return logs by path; tables in memory are numbered in their order.

    Raises
    ------
    ProblemError
        If there is none to learn from, or one is given twice.
    RecordingError
        If a recording has signals that a table of joints does not have.
    """
    roles = [_several(training), _several(validation)]
    if not roles[0]:
        raise ProblemError("no training log, expected at least one")
    every = [log for logs in roles for log in logs]
    names = {id(log): _path(log, number) for number, log in enumerate(every, 1)}
    _require_distinct([names[id(log)] for log in every])
    found = {
        names[id(log)]: as_wide_table(_table(log), str(names[id(log)]))
        for log in every
        if not _is_file(log)
    }
    tables = {path: table for path, (table, _) in found.items()}
    notes = tuple(note for _, note in found.values() if note)
    first, second = (tuple(names[id(log)] for log in logs) for logs in roles)
    return GivenLogs(first, second, tables, notes)


def _several(logs: GivenLog | Sequence[GivenLog]) -> tuple[GivenLog, ...]:
    """Return logs as a tuple; a data frame is one log, though it is iterable."""
    return tuple(logs) if isinstance(logs, list | tuple) else (logs,)


def _is_file(log: GivenLog) -> bool:
    return isinstance(log, str | Path)


def _path(log: GivenLog, number: int) -> Path:
    return local_path(log) if isinstance(log, str | Path) else Path(f"log-{number}")


def _table(log: GivenLog) -> ColumnTable:
    return _columns_of(log) if isinstance(log, Recording) else cast(ColumnTable, log)


def _columns_of(log: Recording) -> dict[str, Vector]:
    """Return a recording's arrays by names of columns."""
    beside = [name for name in _BESIDE if _is_there(getattr(log, name))]
    if beside:
        raise RecordingError(
            f"{log.name}: has {', '.join(beside)}, which a call without a problem file "
            "does not know; build_regression and identify take such recordings"
        )
    table = {"time": log.time}
    for channel, word in _COLUMNS.items():
        if (values := getattr(log, channel)) is not None:
            for joint, column in zip(log.joints, values.T, strict=True):
                table[f"{word}_{joint}"] = column
    return table


def _is_there(value: object) -> bool:
    return value is not None and not (isinstance(value, tuple) and not value)


def _require_distinct(every: Sequence[Path]) -> None:
    for file in every:
        if every.count(file) > 1:
            raise ProblemError(
                f"{file} is given twice; a log is for training or for validation"
            )
