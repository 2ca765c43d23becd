"""Recordings from tables in memory: data frames, and mappings of arrays."""

from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.columns import Columns, require, wanted
from consistent_id.recordings.readers.long_tables import may_name, side_by_side
from consistent_id.recordings.readers.named_arrays import (
    LogName,
    parts_of,
    recording_of,
    stored_names,
)
from consistent_id.recordings.readers.units import is_time
from consistent_id.recordings.readers.used_rows import Duplicates, Missing, UsedRows
from consistent_id.recordings.recording import Recording

_SHOWN = 3  # names of columns that are no texts


class ColumnTable(Protocol):
    """A table with columns by name, listed in `columns` or `keys`."""

    def __getitem__(self, name: Any, /) -> Any:
        """Return a column."""


def recording_from(
    table: ColumnTable,
    joints: Sequence[str],
    columns: Columns | None = None,
    *,
    torque_gain: ArrayLike = 1.0,
    name: str = "table",
    omit: Sequence[int] = (),
    duplicates: Duplicates = "refuse",
    missing: Missing = "refuse",
) -> Recording:
    """Return the recording in a data frame or in a mapping of arrays.

    Parameters
    ----------
    table : DataFrame, mapping of str to array_like, or the like
    joints : sequence of str
    columns : Columns
        Names of the columns or arrays, in SI units.
    torque_gain : array_like, shape () or (joints,)
        Factor from the torque column to torque.
    name : str
        Name of the recording; used in messages.
    omit, duplicates, missing
        See `read_recording`.

    Raises
    ------
    RecordingError
        If a column is missing, occurs twice, or does not contain numbers.

    Examples
    --------
    >>> table = {"time": [0, 0.5, 1.0], "q_elbow": np.radians([0, 45, 90])}
    >>> recording_from(table, ["elbow"]).rate
    2.0
    """
    want = wanted(columns or Columns(), joints, name)
    names = _names(table, name)
    index = _index(table)
    if index in want.names and index not in names:
        raise _of_index(index, name)
    stored = stored_names(want.names)
    require(name, stored, names)
    arrays = {column: _array(table[column], column, name) for column in stored}
    return recording_of(
        parts_of(arrays, want.names, name),
        want,
        LogName(name, where=name),
        torque_gain=torque_gain,
        rows=UsedRows(omit, duplicates, missing),
    )


def as_wide_table(table: ColumnTable, name: str) -> tuple[ColumnTable, str]:
    """Return a table with a row for each instant, and a sentence if it is another.

    Parameters
    ----------
    table : ColumnTable
        Perhaps a long one, with a row for each joint and instant.
    name : str
        Name of the table; used in messages.
    """
    names = [column for column in _names(table, name) if isinstance(column, str)]
    if not any(may_name(column, names) for column in names):
        return table, ""
    every = {column: _array(table[column], column, name) for column in names}
    found = side_by_side({n: values for n, values in every.items() if values.ndim == 1})
    return (table, "") if found is None else (found[0], found[1].sentence(name))


def table_names(table: ColumnTable, name: str) -> tuple[str, ...]:
    """Return the names of a table's columns, if they are texts.

    Parameters
    ----------
    name : str
        Name of the table; used in messages.

    Raises
    ------
    RecordingError
        If no column has a text as its name, or its time is the index of its rows.
    """
    given = _names(table, name)
    names = [column for column in given if isinstance(column, str)]
    if not names:
        seen = f"has columns named {', '.join(map(repr, given[:_SHOWN]))}"
        seen += ", ..." if len(given) > _SHOWN else ""
        raise RecordingError(
            f"{name}: the table {seen if given else 'has no columns'}, expected "
            "columns whose names are texts, such as time, q_elbow and tau_elbow"
        )
    index = _index(table)
    if index is not None and is_time(index) and not any(map(is_time, names)):
        raise _of_index(index, name)
    return tuple(names)


def has_only_columns(table: ColumnTable, names: Iterable[str]) -> bool:
    """Return whether no named value of a table is an array of several columns.

    Examples
    --------
    >>> has_only_columns({"t": [0, 1], "q": [0, 1]}, ["t", "q"])
    True
    >>> has_only_columns({"q": [[0, 1], [2, 3]]}, ["q"])
    False
    """
    arrays = (_array(table[name], name, "table") for name in names)
    return all(array.ndim == 1 and array.dtype != object for array in arrays)


def _names(table: ColumnTable, where: str) -> list[str]:
    for attribute in ("column_names", "columns"):  # Arrow's tables have both
        if (names := getattr(table, attribute, None)) is not None:
            return list(names)
    if (keys := getattr(table, "keys", None)) is not None:
        return list(keys())
    raise RecordingError(
        f"{where}: {type(table).__name__} has neither columns nor keys, expected "
        "a data frame or a mapping of arrays"
    )


def _index(table: ColumnTable) -> str | None:
    """Return the name of a data frame's index, if it has one."""
    found = getattr(getattr(table, "index", None), "name", None)
    return found if isinstance(found, str) else None


def _of_index(index: str | None, where: str) -> RecordingError:
    return RecordingError(
        f"{where}: {index!r} is the index, expected a column: call reset_index()"
    )


def _array(values: Any, column: str, where: str) -> NDArray[Any]:
    if np.ma.isMaskedArray(values):
        return values  # refused by recording_of, which numpy would unmask
    try:
        return np.asarray(values)
    except (TypeError, ValueError) as cause:
        raise RecordingError(
            f"{where}: column {column!r} is not an array of numbers: {cause}"
        ) from None
