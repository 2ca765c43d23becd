"""Columns of a Parquet file, and of any Arrow table."""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.files import require_unpacked
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.columns import require
from consistent_id.recordings.readers.long_tables import (
    LongOrder,
    may_name,
    side_by_side,
)
from consistent_id.recordings.readers.named_arrays import Arrays
from consistent_id.recordings.readers.used_rows import BREAK

_BUFFER = 2**20  # bytes of a column that are read at a time
_ROWS = 2**15  # of a batch
EPISODE = "episode_index"  # LeRobot's, with whose episodes the clock begins again


def read_arrays(path: Path, names: Sequence[str]) -> Arrays:
    """Return the named columns; missing values become NaN.

    A clock that begins again with each of LeRobot's episodes is continued.

    Raises
    ------
    RecordingError
        If the file is not Parquet, or a column is missing or does not contain numbers.
    """
    if (long := _long(path)) is not None:
        require(str(path), names, tuple(long[0]))
        return {name: long[0][name] for name in names}
    known = array_names(path)
    if "timestamp" not in names or EPISODE not in known:
        return read_columns(path, names)
    read = dict(read_columns(path, [*dict.fromkeys([*names, EPISODE])]))
    read["timestamp"] = apart(read["timestamp"], read[EPISODE])
    return {name: read[name] for name in names}


def apart(time: np.ndarray, episodes: np.ndarray) -> np.ndarray:
    """Return the time of episodes that follow each other with a break [s].

    Parameters
    ----------
    time : ndarray, shape (samples,), [s]
        Time of each episode by itself.
    episodes : ndarray, shape (samples,)
        Number of the episode of each sample.

    Examples
    --------
    >>> apart(np.array([0.0, 0.5, 0.0, 0.5]), np.array([0, 0, 1, 1])).tolist()
    [0.0, 0.5, 3.5, 4.0]
    """
    starts = np.flatnonzero(np.diff(episodes)) + 1
    late = np.zeros(len(time))
    late[starts] = np.maximum(time[starts - 1] - time[starts], 0.0) + BREAK
    later = starts[time[starts] > time[starts - 1]]
    late[later] = 0.0  # one clock for all episodes
    return np.asarray(time + np.cumsum(late))


def labels(path: Path, name: str) -> tuple[str, ...]:
    """Return the texts in the list of a column's first row; none of other columns."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            first = next(file.iter_batches(1, columns=[name]), None)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as cause:
        raise RecordingError(f"{path}: not readable as Parquet: {cause}") from None
    (value,) = first[0].to_pylist()[:1] if first is not None else [None]
    return tuple(map(str, value)) if isinstance(value, list) else ()


def read_columns(path: Path, names: Sequence[str]) -> Arrays:
    """Return the named columns as they are stored; see `read_arrays`."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    require(str(path), names, tuple(_schema(path).names))
    try:
        with pq.ParquetFile(path, buffer_size=_BUFFER, pre_buffer=False) as file:
            values = _values(file.metadata, names)
            unpacked = 8 * sum(values.values())
            require_unpacked(path, unpacked, path.stat().st_size, RecordingError)
            return _whole(file, names, path, max(values.values(), default=0))
    except (pa.ArrowException, OSError, UnicodeDecodeError) as cause:
        raise RecordingError(f"{path}: not readable as Parquet: {cause}") from None


def _values(metadata: Any, names: Sequence[str]) -> dict[str, int]:
    """Return the number of values of the named columns, those in lists included."""
    counts = dict.fromkeys(names, 0)
    for g in range(metadata.num_row_groups):
        group = metadata.row_group(g)
        for c in range(group.num_columns):
            column = group.column(c)
            name = column.path_in_schema.partition(".")[0]
            for known in {name, column.path_in_schema} & counts.keys():
                counts[known] += column.num_values
    return counts


def _whole(file: Any, names: Sequence[str], path: Path, most: int) -> Arrays:
    """Return whole columns, filled batch by batch: Arrow's copy is never complete.

    Parameters
    ----------
    most : int
        Values of the longest column; with lists, batches have fewer rows.
    """
    rows = file.metadata.num_rows
    whole: dict[str, np.ndarray] = {}
    if not rows:
        empty = file.schema_arrow.empty_table()
        return {n: numbers_of(empty[n], f"{path}: column {n!r}") for n in names}
    batch_rows = max(1, min(_ROWS, _ROWS * rows // max(most, rows)))
    at = 0
    for batch in file.iter_batches(batch_rows, columns=list(names), use_threads=False):
        for name, values in columns_of(batch, names, path).items():
            if name not in whole:
                whole[name] = np.empty((rows, *values.shape[1:]), values.dtype)
            if values.shape[1:] != whole[name].shape[1:]:
                raise _uneven(f"{path}: column {name!r}")
            if values.dtype != whole[name].dtype:  # flags of which some are missing
                whole[name] = whole[name].astype(np.float64)
            whole[name][at : at + len(values)] = values
        at += len(batch)
    return whole


def read_batches(path: Path, names: Sequence[str], first: int) -> Iterator[Arrays]:
    """Yield the named columns from a row on, in pieces.

    Raises
    ------
    RecordingError
        As `read_arrays`.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    require(str(path), names, tuple(_schema(path).names))
    try:
        with pq.ParquetFile(path, buffer_size=_BUFFER, pre_buffer=False) as file:
            of_groups = [
                file.metadata.row_group(i).num_rows for i in range(file.num_row_groups)
            ]
            ends = np.cumsum([0, *of_groups])
            group = int(np.searchsorted(ends[1:], first, side="right"))
            surplus = first - int(ends[min(group, len(of_groups))])
            for batch in file.iter_batches(
                _ROWS, range(group, len(of_groups)), list(names), use_threads=False
            ):
                if surplus < len(batch):
                    yield columns_of(batch.slice(surplus), names, path)
                surplus = max(surplus - len(batch), 0)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as cause:
        raise RecordingError(f"{path}: not readable as Parquet: {cause}") from None


def columns_of(batch: Any, names: Sequence[str], path: Path) -> Arrays:
    """Return the named columns of a batch of rows."""
    import pyarrow as pa

    table = pa.Table.from_batches([batch])
    return {name: numbers_of(table[name], f"{path}: column {name!r}") for name in names}


def in_pieces(path: Path) -> bool:
    """Return whether a file can be read piece by piece: unless it is a long table."""
    return not naming_columns(_schema(path))


def notes(path: Path) -> tuple[str, ...]:
    """Return a sentence on a table with a row for each joint, if it is one."""
    long = _long(path)
    return () if long is None else (long[1].sentence(path.name),)


def naming_columns(schema: Any) -> list[str]:
    """Return the columns of text that may name the joint of each row."""
    import pyarrow as pa

    texts = (pa.types.is_string, pa.types.is_large_string, pa.types.is_dictionary)
    return [
        name
        for name, kind in zip(schema.names, schema.types, strict=True)
        if any(is_text(kind) for is_text in texts) and may_name(name, schema.names)
    ]


def number_columns(schema: Any) -> list[str]:
    """Return the columns with a number in each row."""
    import pyarrow as pa

    return [
        name
        for name, kind in zip(schema.names, schema.types, strict=True)
        if pa.types.is_primitive(kind) and not pa.types.is_boolean(kind)
    ]


def _long(path: Path) -> tuple[dict[str, np.ndarray], LongOrder] | None:
    """Return a table with a row for each joint side by side; None of other files."""
    if not naming_columns(schema := _schema(path)):
        return None
    state = path.stat()
    return _read_long(path, state.st_mtime_ns, state.st_size, schema)


# A table is asked for its names, its notes and its values.
@lru_cache(maxsize=1)
def _read_long(
    path: Path, changed: int, size: int, schema: Any
) -> tuple[dict[str, np.ndarray], LongOrder] | None:
    """Return the table that a file has since it was changed [ns]."""
    columns = dict(read_columns(path, number_columns(schema)))
    columns |= {name: _texts(path, name) for name in naming_columns(schema)}
    found = side_by_side(columns)
    for values in found[0].values() if found else ():
        values.setflags(write=False)
    return found


def _texts(path: Path, name: str) -> np.ndarray:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        column = pq.read_table(path, columns=[name])[name]
    except (pa.ArrowException, OSError, UnicodeDecodeError) as cause:
        raise RecordingError(f"{path}: not readable as Parquet: {cause}") from None
    return np.array(column.to_pylist(), dtype=object)


def array_names(path: Path) -> tuple[str, ...]:
    """Return the names of the columns, of a long table side by side."""
    long = _long(path)
    return tuple(_schema(path).names if long is None else long[0])


def _schema(path: Path) -> Any:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return pq.read_schema(path)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as cause:
        raise RecordingError(f"{path}: not readable as Parquet: {cause}") from None


def numbers_of(column: Any, where: str) -> np.ndarray:
    """Return an Arrow column as float64, or as bool; what is missing becomes NaN.

    Time stamps and durations become seconds.  A column of lists of one length becomes
    an array, a row for each list.

    Raises
    ------
    RecordingError
        If it does not contain numbers, or contains lists of different lengths.
    """
    import pyarrow as pa

    kind = column.type
    if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind):
        return _rows_of(column, where)
    if pa.types.is_boolean(kind):  # of bits, which NumPy does not have
        flags = numbers_of(column.cast(pa.uint8()), where)
        return flags if column.null_count else flags.astype(np.bool_)
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        return _seconds_of(column)
    if not (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
        raise RecordingError(f"{where} holds {kind}, expected numbers in SI units")
    column = column.combine_chunks()
    if column.null_count:
        column = column.cast(pa.float64(), safe=False).fill_null(np.nan)
    # Casts import pyarrow.compute, and to_numpy() pandas, which takes time.
    return np.asarray(np.from_dlpack(column), dtype=np.float64)


def _seconds_of(column: Any) -> np.ndarray:
    """Return time stamps, or durations, in seconds; stamps count from 1970."""
    import pyarrow as pa

    a_second = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[column.type.unit]
    return numbers_of(column.cast(pa.int64()), "time stamps") / a_second


def _rows_of(column: Any, where: str) -> np.ndarray:
    """Return a column of lists as an array, shape (samples, length of each)."""
    import pyarrow as pa

    lists = column.combine_chunks()
    if isinstance(lists, pa.ChunkedArray):
        lists = lists.chunk(0)
    if pa.types.is_fixed_size_list(lists.type):
        lengths = {lists.type.list_size}
    else:
        lengths = set(np.diff(np.from_dlpack(lists.offsets)).tolist())
    if lists.null_count or len(lengths) != 1:
        raise _uneven(where)
    flat = numbers_of(pa.chunked_array([lists.flatten()]), where)
    return flat.reshape(len(lists), *lengths)


def _uneven(where: str) -> RecordingError:
    return RecordingError(
        f"{where} holds lists of different lengths, or none in some rows; expected "
        "one value for each joint in every row"
    )
