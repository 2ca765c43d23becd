"""A recording in several tables of a folder, side by side: one for each channel.

Tables are one recording if their clocks are equal; tables without a clock belong to it
if they have as many rows.  If no clocks are equal, tables of other columns whose clocks
cover the same time are one: they are interpolated to the slowest of these clocks, and
values are NaN where a table has none.  The largest such group is read, and the others
are named.

Tables of the same columns whose clocks follow one another are pieces of one recording,
one after another; only the first needs the names of the columns.
"""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.log_formats import log_format, tables_in
from consistent_id.recordings.readers.columns import require
from consistent_id.recordings.readers.csv import lacks_names
from consistent_id.recordings.readers.named_arrays import Arrays
from consistent_id.recordings.readers.units import named_clocks

_RATES = 20.0  # most ratio of the rates of two tables of one recording
_COMMON = 0.8  # share of the longer clock that two tables of one recording cover


@dataclass(frozen=True, slots=True)
class _TablePart:
    """A table of a folder: its columns, the name of its clock, and the clock."""

    file: Path
    names: tuple[str, ...]
    clock: str | None
    time: Vector


def read_arrays(path: Path, names: Sequence[str]) -> Arrays:
    """Return the named columns of the tables.

    Raises
    ------
    RecordingError
        If there is no such column, or no two tables have one clock.
    """
    if pieces := _pieces(path):
        require(str(path), names, tuple(pieces[0].columns))
        each = [piece.read(names) for piece in pieces]
        return {name: np.concatenate([one[name] for one in each]) for name in names}
    parts = _parts(path)
    places, clock = _places(parts), _slowest(parts)
    require(str(path), names, tuple(places))
    found: dict[str, Any] = {}
    for file in dict.fromkeys(places[name][0] for name in names):
        own = {n: places[n][1] for n in names if places[n][0] == file}
        read = log_format(file).reader(file).read_arrays(file, [*own.values()])
        (part,) = (part for part in parts if part.file == file)
        for name, column in own.items():
            found[name] = _at(clock, part, np.asarray(read[column]))
    return found


def array_names(path: Path) -> tuple[str, ...]:
    """Return the names of all columns; a name of several tables follows its table's."""
    if pieces := _pieces(path):
        return tuple(pieces[0].columns)
    return tuple(_places(_parts(path)))


def notes(path: Path) -> tuple[str, ...]:
    """Return sentences on the tables that are read, and on those that are not."""
    if pieces := _pieces(path):
        said = ", ".join(piece.file.name for piece in pieces)
        return (f"{said} are pieces of one recording, one after another",)
    parts = _parts(path)
    files, clock = [part.file for part in parts], _slowest(parts)
    moved = ", ".join(p.file.name for p in parts if not _has_clock(p, clock))
    if moved:
        moved = f"; {moved}: interpolated to the clock of {clock.file.name}"
    said = ", ".join(file.name for file in files)
    rest = ", ".join(file.name for file in tables_in(path) if file not in files)
    more = f"; not read, as they have another clock or no table: {rest}" if rest else ""
    return (f"{said} are one recording{moved}{more}",)


def one_recording(files: Sequence[Path]) -> Path | None:
    """Return the folder of tables that are one recording, or None."""
    folder = files[0].parent
    together = all(file.parent == folder and file.is_file() for file in files)
    if len(files) < 2 or not together:
        return None
    if folder.is_dir() and set(files) <= set(tables_in(folder)):
        try:
            parts = {part.file for part in _parts(folder)}
        except RecordingError:
            return None
        return folder if set(files) <= parts else None
    return None


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


def _parts(path: Path) -> list[_TablePart]:
    """Return the tables of the largest group with one clock."""
    tables = [part for file in tables_in(path) if (part := _part(file)) is not None]
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
        raise RecordingError(
            f"{path}: no two of its {len(tables)} tables have the same clock, so they "
            "are no single recording; give the files one by one",
            options=" ".join(shlex.quote(str(part.file)) for part in tables),
            replaces=[str(path)],
        )
    return best


@dataclass(frozen=True, slots=True)
class _Piece:
    """A table of a recording in pieces, its clock, and its columns by their names."""

    file: Path
    columns: dict[str, str]
    time: Vector

    def read(self, names: Sequence[str]) -> Arrays:
        """Return columns by the names that they have in all pieces."""
        own = [self.columns[name] for name in names]
        read = log_format(self.file).reader(self.file).read_arrays(self.file, own)
        return {
            name: np.asarray(read[column])
            for name, column in zip(names, own, strict=True)
        }


def _pieces(path: Path) -> list[_Piece]:
    """Return the tables that are pieces of one recording, in their order; or none."""
    tables = [part for file in tables_in(path) if (part := _part(file)) is not None]
    head = next((part for part in tables if part.clock is not None), None)
    if head is None or head.clock is None or len(tables) < 2:
        return []
    found = []
    for part in tables:
        columns = dict(zip(head.names, part.names, strict=False))
        if set(part.names) == set(head.names):
            columns = {name: name for name in head.names}
        elif not lacks_names(part.names) or len(part.names) != len(head.names):
            return []
        piece = _Piece(part.file, columns, part.time)
        if columns[head.clock] != part.clock:
            time = np.asarray(piece.read([head.clock])[head.clock])
            piece = replace(piece, time=time)
        found.append(piece)
    found.sort(key=lambda piece: float(piece.time[0]))
    follow = all(one.time[-1] < after.time[0] for one, after in pairwise(found))
    return found if follow else []


def _part(file: Path) -> _TablePart | None:
    """Return a table of a folder; None if it is empty, or no table, such as a README.

    A file with a clock is a table, and its faults are errors.
    """
    clock = None
    try:
        reader = log_format(file).reader(file)
        names = tuple(reader.array_names(file))
        clock = next(iter(named_clocks(names)), None)
        if not names:
            return None
        column = clock or names[0]
        values = np.asarray(reader.read_arrays(file, [column])[column])
    except RecordingError:
        if clock is not None:
            raise
        return None
    if not values.size:
        raise RecordingError(f"{file}: no rows; move it out of the folder")
    return _TablePart(file, names, clock, values)


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
