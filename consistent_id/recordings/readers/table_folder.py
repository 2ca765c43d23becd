"""A recording in several tables of a folder, side by side: one for each channel.

Tables are one recording if their clocks are equal; tables without a clock belong to it
if they have as many rows.  If no clocks are equal, tables of other columns whose clocks
cover the same time are one: they are interpolated to the slowest of these clocks, and
values are NaN where a table has none.  The largest such group is read, and the others
are named.

Tables of the same columns whose clocks follow one another without a gap are pieces of
one recording, one after another; only the first needs the names of the columns.
"""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.column_words import channel_of
from consistent_id.recordings.log_formats import log_format, tables_in
from consistent_id.recordings.readers.columns import require
from consistent_id.recordings.readers.csv_header import lacks_names
from consistent_id.recordings.readers.named_arrays import Arrays
from consistent_id.recordings.readers.units import named_clocks
from consistent_id.recordings.readers.used_rows import EmptyTableError, FaultyRowsError
from consistent_id.recordings.unnamed_columns import is_clock

_RATES = 20.0  # most ratio of the rates of two tables of one recording
_COMMON = 0.8  # share of the longer clock that two tables of one recording cover
_GAP = 10.0  # usual steps between two pieces; after more, a run of its own begins
_FOLDERS = 4  # whose clocks are kept


@dataclass(frozen=True, slots=True)
class _TablePart:
    """A table of a folder: its columns, the name of its clock, and the clock."""

    file: Path
    names: tuple[str, ...]
    clock: str | None
    time: Vector

    def read(self, names: Sequence[str]) -> Arrays:
        """Return columns of the table."""
        return _columns(self.file, names)


@dataclass(frozen=True, slots=True)
class _RecordingTables:
    """The tables of a folder that are one recording.

    Parameters
    ----------
    parts : tuple of _TablePart
        Side by side, or one after another.
    names : tuple of str
        The columns of pieces, by the names of the first that has any; empty if the
        parts are side by side.
    """

    parts: tuple[_TablePart, ...]
    names: tuple[str, ...] = ()


def read_arrays(path: Path, names: Sequence[str]) -> Arrays:
    """Return the named columns of the tables.

    Raises
    ------
    RecordingError
        If there is no such column, or no two tables have one clock.
    """
    layout = _recording_tables(path)
    if layout.names:
        require(str(path), names, layout.names)
        each = [_of_piece(part, layout.names, names) for part in layout.parts]
        return {name: np.concatenate([one[name] for one in each]) for name in names}
    places, clock = _places(layout.parts), _slowest(layout.parts)
    require(str(path), names, tuple(places))
    found: dict[str, Any] = {}
    for part in layout.parts:
        own = {n: places[n][1] for n in names if places[n][0] == part.file}
        read = part.read([*own.values()]) if own else {}
        for name, column in own.items():
            found[name] = _at(clock, part, np.asarray(read[column]))
    return found


def array_names(path: Path) -> tuple[str, ...]:
    """Return the names of all columns; a name of several tables follows its table's."""
    layout = _recording_tables(path)
    return layout.names or tuple(_places(layout.parts))


def notes(path: Path) -> tuple[str, ...]:
    """Return sentences on the tables that are read, and on those that are not."""
    layout = _recording_tables(path)
    parts = layout.parts
    files = [part.file for part in parts]
    said = _names(parts)
    rest = ", ".join(file.name for file in tables_in(path) if file not in files)
    if layout.names:
        why = "not read, as they lack these columns or have no rows"
        more = f"; {why}: {rest}" if rest else ""
        return (f"{said} are pieces of one recording, one after another{more}",)
    clock = _slowest(parts)
    moved = ", ".join(p.file.name for p in parts if not _has_clock(p, clock))
    if moved:
        moved = f"; {moved}: interpolated to the clock of {clock.file.name}"
    more = f"; not read, as they have another clock or no table: {rest}" if rest else ""
    return (f"{said} are one recording{moved}{more}",)


def require_one_run(path: Path, patterns: Sequence[str]) -> None:
    """Refuse columns of a single one of several tables that have the same columns.

    They are runs on equal clocks, as simulators write them, and not channels.

    Raises
    ------
    RecordingError
        With the tables, to be given one by one.
    """
    found = _recording_tables(path)
    parts = () if found.names else found.parts
    for part in parts:
        alike = [other for other in parts if set(other.names) == set(part.names)]
        own = [pattern.startswith(f"{part.file.stem}.") for pattern in patterns]
        if len(alike) > 1 and all(own):
            said = f"{_names(alike)} have the same columns, and {part.file.name} has "
            said += "positions and torques: they are runs"
            raise _one_by_one(path, alike, said)


def one_recording(files: Sequence[Path]) -> Path | None:
    """Return the folder of tables that are one recording side by side, or None."""
    folder = files[0].parent
    together = all(file.parent == folder and file.is_file() for file in files)
    if len(files) < 2 or not together:
        return None
    if folder.is_dir() and set(files) <= set(tables_in(folder)):
        try:
            layout = _recording_tables(folder)
        except RecordingError:
            return None
        parts = {part.file for part in layout.parts}
        return folder if not layout.names and set(files) <= parts else None
    return None


def _recording_tables(path: Path) -> _RecordingTables:
    """Return the tables that are one recording.

    Raises
    ------
    RecordingError
        If no two of them are.
    """
    stats = ((file, file.stat()) for file in tables_in(path))
    return _found(path, tuple((f, s.st_mtime_ns, s.st_size) for f, s in stats))


@lru_cache(maxsize=_FOLDERS)
def _found(path: Path, states: Sequence[tuple[Path, int, int]]) -> _RecordingTables:
    """Return the tables that are one recording since files were changed [ns]."""
    tables = [part for file, *_ in states if (part := _part(file)) is not None]
    return _pieces(tables) or _RecordingTables(tuple(_parts(path, tables)))


def _places(parts: Sequence[_TablePart]) -> dict[str, tuple[Path, str]]:
    """Return the table and the column of each name."""
    clock = _slowest(parts)
    every = [n for part in parts for n in part.names if n != part.clock]
    places: dict[str, tuple[Path, str]] = {}
    if clock.clock is not None:
        places[clock.clock] = (clock.file, clock.clock)
    for part in parts:
        for name in part.names:
            if name != part.clock:
                own = name if every.count(name) == 1 else f"{part.file.stem}.{name}"
                places[own] = (part.file, name)
    return places


def _parts(path: Path, tables: Sequence[_TablePart]) -> list[_TablePart]:
    """Return the tables of the largest group with one clock."""
    timed = [part for part in tables if part.clock is not None]
    best = list[_TablePart]()
    for together in (_has_clock, _belongs):  # interpolated only where no clocks agree
        groups = [
            [other for other in tables if together(other, part)]
            for part in timed or tables
        ]
        best = max(groups, key=len, default=[])
        if len(best) > 1:
            break
    if len(best) < 2:
        raise _several(path, timed or tables)
    files = [part.file for part in best]
    columns = [set(part.names) for part in best]
    rest = [p for p in tables if p.file not in files and set(p.names) in columns]
    if rest and all(names == columns[0] for names in columns):
        said = f"{_names(best)} have the same clock, and the columns of the others"
        raise _one_by_one(path, timed, f"{said}: they are copies, or runs")
    if rest:
        raise RecordingError(
            f"{path}: {_names(best)} are one recording, and {_names(rest)} have the "
            "same columns at other times; put the tables of each run into a folder of "
            "its own, and pieces of a table into one table"
        )
    return best


def _names(parts: Sequence[_TablePart]) -> str:
    return ", ".join(part.file.name for part in parts)


def _several(path: Path, tables: Sequence[_TablePart]) -> RecordingError:
    """Return the error of a folder that is no single recording."""
    if not tables:
        return RecordingError(f"{path}: none of its files is a table with rows")
    if len(tables) == 1:
        said = f"only {_names(tables)} is a table with rows"
    else:
        said = (
            f"no two of its {len(tables)} tables have the same clock, nor do their "
            "clocks follow one another without a gap, so they are no single recording"
        )
    return _one_by_one(path, tables, said)


def _one_by_one(path: Path, tables: Sequence[_TablePart], said: str) -> RecordingError:
    """Return an error with the command that names each table instead of the folder."""
    return RecordingError(
        f"{path}: {said}; give the files one by one",
        options=" ".join(shlex.quote(str(part.file)) for part in tables),
        replaces=[str(path)],
    )


def _pieces(tables: Sequence[_TablePart]) -> _RecordingTables | None:
    """Return the tables that are pieces of one recording, in their order; or None."""
    timed = [part for part in tables if part.clock is not None]
    head = max(timed, key=_says_channels, default=None)
    if head is None or head.clock is None:
        return None
    found = list[_TablePart]()
    for part in tables:
        own = dict(zip(head.names, part.names, strict=False))
        alike = set(part.names) == set(head.names)
        if alike:
            own = {name: name for name in head.names}
        if alike or (lacks_names(part.names) and len(part.names) == len(head.names)):
            found.append(_with_clock(part, own[head.clock]))
        elif part.clock is not None and _has_channels(part):
            return None
    if len(found) < 2 or any(not _has_known_ends(part.time) for part in found):
        return None
    found.sort(key=lambda part: float(part.time[0]))
    return _RecordingTables(tuple(found), head.names) if _follow(found) else None


def _has_channels(part: _TablePart) -> bool:
    return any(map(channel_of, part.names))


def _says_channels(part: _TablePart) -> tuple[bool, bool]:
    """Return whether names say channels, and whether there are names at all."""
    return _has_channels(part), not lacks_names(part.names)


def _with_clock(part: _TablePart, clock: str) -> _TablePart:
    """Return a table with a column as its clock."""
    if clock == (part.clock or part.names[0]):
        return replace(part, clock=clock)
    return replace(
        part, clock=clock, time=np.array(_columns(part.file, [clock])[clock])
    )


def _follow(parts: Sequence[_TablePart]) -> bool:
    """Return whether the clocks follow one another, with no gap as between two runs."""
    steps = np.concatenate([np.diff(part.time) for part in parts])
    rising = steps[steps > 0.0]
    if not len(rising):
        return False
    longest = max(_GAP * float(np.median(rising)), float(rising.max()))
    between = [after.time[0] - one.time[-1] for one, after in pairwise(parts)]
    return all(0.0 <= step <= longest for step in between)


def _has_known_ends(time: Vector) -> bool:
    numbers = time.ndim == 1 and time.size > 0 and time.dtype.kind in "iuf"
    return bool(numbers and np.isfinite(time[[0, -1]]).all())


def _of_piece(
    part: _TablePart, known: Sequence[str], names: Sequence[str]
) -> dict[str, np.ndarray]:
    """Return columns of a piece by the names that they have in all pieces."""
    own = {name: name for name in names}
    if set(part.names) != set(known):
        own = {name: part.names[known.index(name)] for name in names}
    read = part.read([*own.values()])
    return {name: np.asarray(read[column]) for name, column in own.items()}


def _columns(file: Path, names: Sequence[str]) -> Arrays:
    reader = log_format(file).reader(file)
    try:
        read: Arrays = reader.read_arrays(file, names)
    except FaultyRowsError as cause:
        raise FaultyRowsError(
            cause.said,
            ". Mend that row, or take the file out of the folder: rows to omit are "
            "counted over all its tables",
            every=cause.every,
        ) from None
    return read


def _part(file: Path) -> _TablePart | None:
    """Return a table of a folder; None if it is empty, or no table, such as a README.

    A file with a clock is a table, and its faults are errors, unless its first line is
    the only sign: no row can be read, and no other column is a channel.  Without a
    header, a first column that rises evenly is a clock.
    """
    clock = None
    try:
        names = tuple(log_format(file).reader(file).array_names(file))
        clock = next(iter(named_clocks(names)), None)
        if not names:
            return None
        column = clock or names[0]
        values = np.array(_columns(file, [column])[column])
    except EmptyTableError:
        return None
    except RecordingError as cause:
        is_text = isinstance(cause, FaultyRowsError) and cause.every
        if clock is None or (is_text and not any(map(channel_of, names))):
            return None
        raise
    numbers = _has_known_ends(values)
    if clock is None and lacks_names(names) and numbers and is_clock(values):
        clock = column
    return _TablePart(file, names, clock, values) if values.size else None


def _belongs(other: _TablePart, part: _TablePart) -> bool:
    if _has_clock(other, part):
        return True
    if other.clock is None or part.clock is None:
        return False
    if {*other.names} & {*part.names} - {other.clock, part.clock}:
        return False  # runs of one kind
    return _cover_the_same(other.time, part.time)


def _has_clock(other: _TablePart, part: _TablePart) -> bool:
    """Return whether rows of a table are those of another one."""
    if other.clock is None or part.clock is None:
        return len(other.time) == len(part.time)
    return bool(np.array_equal(other.time, part.time))


def _cover_the_same(one: Vector, other: Vector) -> bool:
    """Return whether two clocks increase and cover nearly the same time."""
    if any(time.dtype.kind not in "iuf" or len(time) < 2 for time in (one, other)):
        return False
    if any((np.diff(time) <= 0.0).any() for time in (one, other)):
        return False
    if not 1.0 / _RATES <= len(one) / len(other) <= _RATES:
        return False
    common = min(one[-1], other[-1]) - max(one[0], other[0])
    return bool(common >= _COMMON * max(np.ptp(one), np.ptp(other)))


def _slowest(parts: Sequence[_TablePart]) -> _TablePart:
    """Return the table whose clock is that of the recording."""
    timed = [part for part in parts if part.clock is not None]
    return min(timed or parts, key=lambda part: len(part.time))


def _at(clock: _TablePart, part: _TablePart, values: np.ndarray) -> np.ndarray:
    """Return values of a table at the times of another one; NaN where it has none."""
    if _has_clock(part, clock):
        return values
    if values.ndim != 1 or values.dtype.kind not in "iuf":
        raise RecordingError(
            f"{part.file}: arrays cannot be interpolated to the clock of "
            f"{clock.file.name}, only columns of numbers"
        )
    moved = np.interp(clock.time, part.time, values, left=np.nan, right=np.nan)
    return np.asarray(moved)
