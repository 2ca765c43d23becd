"""What the columns or arrays of a log are called."""

import csv
import zipfile
from collections.abc import Iterable
from pathlib import Path

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.columns import missing_library

_SEPARATORS = (",", ";", "\t")


def column_names(path: Path) -> tuple[str, ...]:
    """Return the names of a log's columns or arrays, in the file's order.

    Parameters
    ----------
    path : Path
        CSV, TSV, Parquet or NPZ.

    Raises
    ------
    RecordingError
        If the file cannot be read, or is of another kind.
    """
    kind = path.suffix.lower()
    if kind not in (".csv", ".tsv", ".parquet", ".npz"):
        raise RecordingError(
            f"{path}: columns can be found in CSV, Parquet and NPZ files alone; say "
            "which they are (--position, --torque; in Python, Columns)"
        )
    try:
        if kind == ".parquet":
            return _of_parquet(path)
        if kind == ".npz":
            with zipfile.ZipFile(path) as members:
                return tuple(name.removesuffix(".npy") for name in members.namelist())
        with path.open(encoding="utf-8-sig", newline="") as lines:
            return _of_text(lines)
    except (OSError, UnicodeDecodeError, zipfile.BadZipFile, csv.Error) as cause:
        raise RecordingError(f"{path}: cannot be read ({cause})") from None


def _of_text(lines: Iterable[str]) -> tuple[str, ...]:
    """Return the header: the first line, or above numbers the last comment."""
    comment = first = ""
    for first in lines:
        if not first.startswith("#"):
            break
        comment = first.lstrip("# ")
    names, above = _fields(first), _fields(comment)
    return above if comment and all(map(_is_number, names)) else names


def _fields(line: str) -> tuple[str, ...]:
    """Return the fields of a line, by the separator that makes the most of them."""
    split = (
        next(csv.reader([line], delimiter=mark, skipinitialspace=True), [])
        for mark in _SEPARATORS
    )
    return tuple(name.strip() for name in max(split, key=len))


def _is_number(field: str) -> bool:
    try:
        float(field.replace(",", "."))
    except ValueError:
        return False
    return True


def _of_parquet(path: Path) -> tuple[str, ...]:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise missing_library(str(path), "Parquet", "pyarrow", "parquet") from None
    try:
        return tuple(pq.read_schema(path).names)
    except pa.ArrowException as cause:
        raise RecordingError(f"{path}: not readable as Parquet: {cause}") from None
