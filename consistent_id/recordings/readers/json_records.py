"""Arrays of JSON: an object of lists, a list of objects, or an object in each line.

Names within objects are joined by points, ``state.q``; a list of numbers in each record
is a row of a two-dimensional array.  What is no number in all records is not an array.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.columns import require
from consistent_id.recordings.readers.named_arrays import Arrays

_LINES = (".jsonl", ".ndjson")


def read_arrays(path: Path, names: Sequence[str]) -> Arrays:
    """Return the named arrays; NaN stands for null.

    Raises
    ------
    RecordingError
        If the file is no such JSON, or an array is missing.
    """
    found = _arrays(path)
    require(str(path), names, tuple(found))
    return {name: found[name] for name in names}


def array_names(path: Path) -> tuple[str, ...]:
    """Return the names of all arrays of numbers, in the file's order."""
    return tuple(_arrays(path))


def _arrays(path: Path) -> dict[str, np.ndarray]:
    content = _content(path)
    if isinstance(content, Mapping):
        lists = dict(_leaves(content))
        if any(isinstance(values, list) for values in lists.values()):
            return _numbers(lists)
        content = [content]
    content = content if isinstance(content, list) else []
    records = [dict(_leaves(record)) for record in content if isinstance(record, dict)]
    if not records or len(records) < len(content):
        raise RecordingError(
            f"{path}: expected JSON of records: an object of lists, a list of objects, "
            "or an object in each line"
        )
    names = dict.fromkeys(name for record in records for name in record)
    return _numbers({name: [r.get(name) for r in records] for name in names})


def _content(path: Path) -> Any:
    """Return the file's value; of several lines the list of theirs."""
    try:
        raw = path.read_bytes()
        if path.suffix.lower() in _LINES:
            return msgspec.json.Decoder().decode_lines(raw)
        return msgspec.json.decode(raw)
    except (OSError, msgspec.DecodeError, RecursionError) as cause:
        raise RecordingError(f"{path}: not readable as JSON: {cause}") from None


def _leaves(value: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for key, inner in value.items():
        if isinstance(inner, Mapping):
            yield from _leaves(inner, f"{before}{key}.")
        else:
            yield f"{before}{key}", inner


def _numbers(lists: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Return the lists that are arrays of numbers, of one or two dimensions."""
    found = {}
    for name, values in lists.items():
        if not isinstance(values, list) or any(isinstance(v, str) for v in values):
            continue
        try:
            array = np.array(values, dtype=np.float64)
        except (TypeError, ValueError):
            continue
        if array.ndim in (1, 2) and not np.isnan(array).all():
            found[name] = array
    return found
