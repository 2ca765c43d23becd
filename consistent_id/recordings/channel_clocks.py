"""Clocks of channels: a log whose torque has another clock than its position.

Such a clock has a part of its channel's name, as ``tau_time`` beside ``tau1`` or
``drive/time`` beside ``drive/torque``.  Its samples are not those of the positions,
even if they are as many.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from consistent_id.errors import RecordingError
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers.columns import Columns
from consistent_id.recordings.readers.data_frames import ColumnTable
from consistent_id.recordings.readers.recording_file import reader_of
from consistent_id.recordings.readers.units import is_time
from consistent_id.recordings.unnamed_columns import rises

_WORD = r"(?:time|timestamps?|stamp|clock|t|ts|zeit)"
_BEFORE = re.compile(rf"{_WORD}[_./ ]+(?P<stem>.+)", re.IGNORECASE)
_AFTER = re.compile(rf"(?P<stem>.+)[_./ ]+{_WORD}", re.IGNORECASE)


def stem_of_clock(name: str) -> str:
    """Return the channel or group in the name of a clock; empty of none.

    Examples
    --------
    >>> stem_of_clock("t_tau"), stem_of_clock("drive/time"), stem_of_clock("time")
    ('tau', 'drive', '')
    """
    found = _AFTER.fullmatch(name) or _BEFORE.fullmatch(name)
    return "" if found is None or is_time(found["stem"]) else found["stem"]


def own_clock(column: str, clocks: Sequence[str]) -> str | None:
    """Return the clock whose name has the beginning of a column's, if one has.

    Examples
    --------
    >>> own_clock("q{number}", ["time", "t_q", "t_tau"])
    't_q'
    """
    owned = [
        name
        for name in clocks
        if (stem := stem_of_clock(name))
        and re.match(rf"{re.escape(stem)}(?![a-zA-Z])", column, re.IGNORECASE)
    ]
    return max(owned, key=len, default=None)


def require_one_clock(
    log: Path,
    names: Sequence[str],
    found: Columns,
    table: ColumnTable | None = None,
) -> None:
    """Refuse a log whose torques or velocities have another clock than its positions.

    Two clocks are compared only where one of them is the time of the recording.

    Parameters
    ----------
    names : sequence of str
        All columns of the log.
    found : Columns
        Those that are read.
    table : ColumnTable, optional
        The log, if it is in memory; the path stands for it.

    Raises
    ------
    RecordingError
        With a form of the log that is read.
    """
    clocks = [name for name in names if stem_of_clock(name)]
    position, time = found.position, found.time
    if len(clocks) < 2 or position is None:
        return
    first = own_clock(position, clocks)
    for channel in ("velocity", "torque"):
        column = getattr(found, channel)
        other = None if column is None else own_clock(column, clocks)
        if first is None or other in (None, first) or time not in (first, other):
            continue
        rows = {
            clock: next((n for n in names if own_clock(n, clocks) == clock != n), clock)
            for clock in (first, other)
        }
        if _differ(log, rows, table):
            raise RecordingError(
                f"{log}: the position has the clock {first}, the {channel} {other}, "
                "and their times differ. A table has one clock: write each of these "
                "channels with its clock into a table of its own, and give their "
                "folder, which is read as one recording on the slower clock. If all "
                f"rows are of {time} nevertheless, state the columns, too: --time "
                f"{time} --position {position} --{channel} {column}"
            )


def _differ(log: Path, arrays: Mapping[str, str], table: ColumnTable | None) -> bool:
    """Return whether two columns are clocks with other times.

    Parameters
    ----------
    arrays : mapping of str to str
        An array that has a row for each value of a clock.
    table : ColumnTable, optional
        As of `require_one_clock`.
    """
    names = list(dict.fromkeys([*arrays, *arrays.values()]))
    try:
        read = {name: np.asarray(values) for name, values in _read(log, names, table)}
    except RecordingError:  # texts, or faults that are found when the log is read
        return False
    clocks = [read[name].reshape(-1) for name in arrays]
    shapes = [read[name].shape for name in arrays.values()]
    for clock, shape in zip(clocks, shapes, strict=True):
        if clock.dtype.kind not in "iuf" or len(clock) not in shape:
            return False
    if len(clocks[0]) != len(clocks[1]):
        return all(map(rises, clocks))
    both = np.isfinite(clocks[0]) & np.isfinite(clocks[1])
    one, two = (clock[both] for clock in clocks)
    return rises(one) and rises(two) and not np.array_equal(one, two)


def _read(
    log: Path, names: Sequence[str], table: ColumnTable | None
) -> Iterator[tuple[str, object]]:
    if table is not None:
        return ((name, table[name]) for name in names)
    lenient = {"missing": "omit"} if log_format(log).is_text else {}
    return iter(reader_of(log).read_arrays(log, names, **lenient).items())
