"""Columns of a Feather or Arrow IPC file, or of an Arrow stream in a file."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.columns import require
from consistent_id.recordings.readers.long_tables import LongOrder, side_by_side
from consistent_id.recordings.readers.named_arrays import Arrays
from consistent_id.recordings.readers.parquet import (
    columns_of,
    naming_columns,
    number_columns,
    numbers_of,
)

_FILE = b"ARROW1"  # how the file format begins; a stream has no mark of its own


def read_arrays(path: Path, names: Sequence[str]) -> Arrays:
    """Return the named columns; missing values become NaN.

    Raises
    ------
    RecordingError
        If the file is not Arrow's, or a column is missing or does not contain numbers.
    """
    known, table = _columns(path)
    if (long := _long(path, table)) is not None:
        require(str(path), names, tuple(long[0]))
        return {name: long[0][name] for name in names}
    require(str(path), names, known)
    return {name: numbers_of(table[name], f"{path}: column {name!r}") for name in names}


def labels(path: Path, name: str) -> tuple[str, ...]:
    """Return the texts in the list of a column's first row; none of other columns."""
    first = _columns(path)[1][name][:1].to_pylist()
    is_list = bool(first) and isinstance(first[0], list)
    return tuple(map(str, first[0])) if is_list else ()


def read_batches(path: Path, names: Sequence[str], first: int) -> Iterator[Arrays]:
    """Yield the named columns from a row on, a batch of the file at a time.

    Raises
    ------
    RecordingError
        As `read_arrays`.
    """
    import pyarrow as pa

    with _readable(path) as (file, whole):
        stored = pa.ipc.open_file(file) if whole else pa.ipc.open_stream(file)
        require(str(path), names, stored.schema.names)
        batches = (
            map(stored.get_batch, range(stored.num_record_batches)) if whole else stored
        )
        for batch in batches:
            if first < len(batch):
                yield columns_of(batch.slice(first), names, path)
            first = max(first - len(batch), 0)


def in_pieces(path: Path) -> bool:
    """Return whether a file can be read piece by piece: unless it is a long table."""
    return not naming_columns(_columns(path)[1].schema)


def notes(path: Path) -> tuple[str, ...]:
    """Return a sentence on a table with a row for each joint, if it is one."""
    long = _long(path, _columns(path)[1])
    return () if long is None else (long[1].sentence(path.name),)


def _long(path: Path, table: Any) -> tuple[dict[str, np.ndarray], LongOrder] | None:
    """Return a table with a row for each joint side by side; None of others."""
    if not naming_columns(table.schema):
        return None
    state = path.stat()
    return _read_long(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=1)
def _read_long(
    path: Path, changed: int, size: int
) -> tuple[dict[str, np.ndarray], LongOrder] | None:
    """Return the table that a file has since it was changed [ns]."""
    table = _columns(path)[1]
    likely = naming_columns(table.schema)
    columns = {
        name: numbers_of(table[name], f"{path}: column {name!r}")
        for name in number_columns(table.schema)
    }
    for name in likely:
        columns[name] = np.array(table[name].to_pylist(), dtype=object)
    found = side_by_side(columns)
    for values in found[0].values() if found else ():
        values.setflags(write=False)
    return found


def array_names(path: Path) -> tuple[str, ...]:
    """Return the names of the columns, of a long table side by side."""
    known, table = _columns(path)
    long = _long(path, table)
    return known if long is None else tuple(long[0])


def _columns(path: Path) -> tuple[tuple[str, ...], Any]:
    """Return the names and the table; uncompressed data are mapped, not read."""
    import pyarrow as pa

    with _readable(path) as (file, whole):
        table = (pa.ipc.open_file if whole else pa.ipc.open_stream)(file).read_all()
        table.validate()
        return tuple(table.column_names), table


@contextmanager
def _readable(path: Path) -> Iterator[tuple[Any, bool]]:
    """Yield the memory-mapped file, and whether it is a file, not a stream."""
    import pyarrow as pa

    try:
        file = pa.memory_map(str(path))
        whole = file.read(len(_FILE)) == _FILE
        file.seek(0)
        yield file, whole
    except (pa.ArrowException, OSError, UnicodeDecodeError) as cause:
        raise RecordingError(
            f"{path}: not readable as Feather (version 2) or Arrow IPC: {cause}"
        ) from None
