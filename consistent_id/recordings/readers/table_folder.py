"""A recording in several tables of a folder, side by side: one for each channel.

Tables are one recording if their clocks are equal; tables without a clock belong to it
if they have as many rows.  The largest such group is read, and the others are named.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.log_formats import log_format, tables_in
from consistent_id.recordings.readers.columns import require
from consistent_id.recordings.readers.named_arrays import Arrays
from consistent_id.recordings.readers.units import is_time


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
    places = _places(path)
    require(str(path), names, tuple(places))
    found: dict[str, Any] = {}
    for file in dict.fromkeys(places[name][0] for name in names):
        own = {n: places[n][1] for n in names if places[n][0] == file}
        read = log_format(file).reader(file).read_arrays(file, [*own.values()])
        found |= {name: read[column] for name, column in own.items()}
    return found


def array_names(path: Path) -> tuple[str, ...]:
    """Return the names of all columns; a name of several tables follows its table's."""
    return tuple(_places(path))


def notes(path: Path) -> tuple[str, ...]:
    """Return sentences on the tables that are read, and on those that are not."""
    files = [part.file for part in _parts(path)]
    said = ", ".join(file.name for file in files)
    rest = ", ".join(file.name for file in tables_in(path) if file not in files)
    more = f"; not read, as they have another clock or no table: {rest}" if rest else ""
    return (f"{said} have one clock and are one recording{more}",)


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


def _places(path: Path) -> dict[str, tuple[Path, str]]:
    """Return the table and the column of each name."""
    parts = _parts(path)
    every = [n for part in parts for n in part.names if n != part.clock]
    places: dict[str, tuple[Path, str]] = {}
    for part in parts:
        if part.clock is not None:
            places.setdefault(part.clock, (part.file, part.clock))
        for name in part.names:
            if name != part.clock:
                own = name if every.count(name) == 1 else f"{part.file.stem}.{name}"
                places[own] = (part.file, name)
    return places


def _parts(path: Path) -> list[_TablePart]:
    """Return the tables of the largest group with one clock."""
    tables = [part for file in tables_in(path) if (part := _part(file)) is not None]
    timed = [part for part in tables if part.clock is not None]
    groups = [
        [other for other in tables if _belongs(other, part)] for part in timed or tables
    ]
    best = max(groups, key=len, default=[])
    if len(best) < 2:
        raise RecordingError(
            f"{path}: no two of its {len(tables)} tables have the same clock, so they "
            "are no single recording; give the files one by one"
        )
    return best


def _part(file: Path) -> _TablePart | None:
    """Return a table of a folder; None if it is empty, or no table, such as a README.

    A file with a clock is a table, and its faults are errors.
    """
    clock = None
    try:
        reader = log_format(file).reader(file)
        names = tuple(reader.array_names(file))
        clock = next((name for name in names if is_time(name)), None)
        if not names:
            return None
        column = clock or names[0]
        values = np.asarray(reader.read_arrays(file, [column])[column])
    except RecordingError:
        if clock is not None:
            raise
        return None
    return _TablePart(file, names, clock, values)


def _belongs(other: _TablePart, part: _TablePart) -> bool:
    if other.clock is None or part.clock is None:
        return len(other.time) == len(part.time)
    return bool(np.array_equal(other.time, part.time))
