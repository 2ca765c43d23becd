"""Arrays of JSON: an object of lists, a list of objects, or an object in each line.

Names within objects are joined by points, ``state.q``; a list of numbers in each record
is a row of a two-dimensional array.  Lists beside a list of as many names, as in
messages of joint states, and lists of objects with names are taken apart:
``position.elbow``.  Records of a joint each are read side by side.  Numbers of records
may be texts.  Values that are no numbers or times in all records are not an array.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from math import nan
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.columns import require
from consistent_id.recordings.readers.long_tables import LongOrder, side_by_side
from consistent_id.recordings.readers.named_arrays import Arrays
from consistent_id.recordings.readers.text_numbers import number
from consistent_id.recordings.readers.units import is_time
from consistent_id.recordings.readers.yaml_messages import are_names, names_of

_LINES = (".jsonl", ".ndjson")
_MOST_JOINTS = 100  # objects of a list that are joints; more are records


def read_arrays(path: Path, names: Sequence[str]) -> Arrays:
    """Return the named arrays; NaN stands for null, and for flags among numbers.

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


def notes(path: Path) -> tuple[str, ...]:
    """Return a sentence on records of a joint each, if they are."""
    content = _records(_content(path))
    if not isinstance(content, list) or not all(isinstance(r, dict) for r in content):
        return ()
    found = _long(_lists(content))
    return () if found is None else (found[1].sentence(path.name),)


def _records(content: Any) -> Any:
    """Return the list of records that stands in an object beside a title and the like.

    Tables as pandas writes them become objects of lists.  As it is, if it is none.
    """
    if not isinstance(content, Mapping):
        return content
    if (table := _of_pandas(content)) is not None:
        return table
    long = [v for v in content.values() if isinstance(v, list)]
    found = max(long, key=len, default=[])
    are_records = len(found) > _MOST_JOINTS and isinstance(found[0], Mapping)
    return found if are_records else content


def _of_pandas(content: Mapping[str, Any]) -> dict[str, list[Any]] | None:
    """Return the columns of a frame that pandas wrote by rows or by columns; or None.

    ``split`` writes names, an index and rows; by default, a column is an object with
    the numbers of its rows as keys.
    """
    names, rows = content.get("columns"), content.get("data")
    if isinstance(names, list) and isinstance(rows, list) and rows:
        whole = (isinstance(row, list) and len(row) == len(names) for row in rows)
        named = names and all(isinstance(name, str) for name in names)
        if not named or not all(whole):
            return None
        columns = (list(column) for column in zip(*rows, strict=True))
        return _with_clock(dict(zip(names, columns, strict=True)), content.get("index"))
    first = next(iter(content.values()), None)
    if not isinstance(first, Mapping) or len(first) <= _MOST_JOINTS:
        return None
    keys = first.keys()
    same = (isinstance(c, Mapping) and c.keys() == keys for c in content.values())
    if any(number(key, ".") is None for key in keys) or not all(same):
        return None
    return _with_clock({n: list(c.values()) for n, c in content.items()}, list(keys))


def _with_clock(table: dict[str, list[Any]], index: Any) -> dict[str, list[Any]]:
    """Add a frame's index as its clock, if it does not count rows and has no other."""
    if not isinstance(index, list) or any(map(is_time, table)):
        return table
    read = [number(v, ".") if isinstance(v, str) else v for v in index]
    stamps = [float(stamp) for stamp in read if isinstance(stamp, int | float)]
    if len(stamps) < len(index):
        return table
    counts = all(later - one == 1 for one, later in pairwise(stamps))
    return table if counts else {"time": stamps} | table


def _lists(content: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Return the values of each name in all records, None where one has none."""
    records = [dict(_leaves(record)) for record in content]
    names = dict.fromkeys(name for record in records for name in record)
    return {name: [record.get(name) for record in records] for name in names}


def _arrays(path: Path) -> dict[str, np.ndarray]:
    content = _records(_content(path))
    if isinstance(content, Mapping):
        lists = dict(_leaves(content))
        if any(isinstance(values, list) for values in lists.values()):
            texts = {n: np.array(v) for n, v in lists.items() if are_names(v)}
            return texts | _numbers(lists)
        content = [content]
    content = content if isinstance(content, list) else []
    if not content or not all(isinstance(record, dict) for record in content):
        raise RecordingError(
            f"{path}: expected JSON of records: an object of lists, a list of objects, "
            "or an object in each line"
        )
    lists = _lists(content)
    found = _long(lists)
    if found is not None:
        return found[0]
    return _numbers({name: _unquoted(values) for name, values in lists.items()})


def _long(
    lists: Mapping[str, list[Any]],
) -> tuple[dict[str, np.ndarray], LongOrder] | None:
    """Return records of a joint each as arrays of all joints; None of others."""
    texts = {
        name: np.array([str(value) for value in values], dtype=object)
        for name, values in lists.items()
        if all(isinstance(value, str | int) for value in values)
        and any(isinstance(value, str) for value in values)
    }
    whole = {
        name: np.array(values)
        for name, values in lists.items()
        if all(isinstance(value, int) for value in values)
    }
    numbers = {name: a for name, a in _numbers(lists).items() if a.ndim == 1}
    return side_by_side(texts | numbers | whole)


def _content(path: Path) -> Any:
    """Return the file's value; of several lines the list of theirs."""
    try:
        raw = path.read_bytes()
        if path.suffix.lower() in _LINES:
            return _of_lines(raw)
        try:
            return msgspec.json.decode(raw)
        except msgspec.DecodeError:
            for read in (json.loads, _of_lines):  # NaN as Python writes it, and lines
                with suppress(ValueError):
                    return read(raw)
            raise
    except (OSError, msgspec.DecodeError, ValueError, RecursionError) as cause:
        raise RecordingError(f"{path}: not readable as JSON: {cause}") from None


def _of_lines(raw: bytes) -> list[Any]:
    """Return the values of a text with one in each line."""
    with suppress(msgspec.DecodeError):
        return msgspec.json.Decoder().decode_lines(raw)
    found, lines = list[Any](), raw.splitlines()
    for place, line in enumerate(lines, start=1):
        try:
            found += [json.loads(line)] if line.strip() else []
        except ValueError as cause:
            end = ". It is the last one, and may be cut off: delete it"
            said = f"line {place}: {cause}{end * (place == len(lines) > 1)}"
            raise ValueError(said) from None
    return found


def _leaves(
    value: Mapping[str, Any], before: str = "", above: Sequence[str] = ()
) -> Iterator[tuple[str, Any]]:
    """Yield paths and values; lists have the names beside them, or above."""
    names, below = names_of(value, above)
    for key, inner in value.items():
        if isinstance(inner, Mapping):
            yield from _leaves(inner, f"{before}{key}.", below)
        elif isinstance(inner, list) and inner and inner is not names:
            yield from _items(f"{before}{key}", inner, names)
        else:
            yield f"{before}{key}", inner


def _items(
    key: str, items: list[Any], names: Sequence[str]
) -> Iterator[tuple[str, Any]]:
    """Yield a list as a whole, or its items by their names."""
    own = [item.get("name") for item in items if isinstance(item, Mapping)]
    if len(own) == len(items) and are_names(own):
        for name, item in zip(own, items, strict=True):
            yield from _leaves({**item, "name": None}, f"{key}.{name}.")
    elif (
        len(own) == len(items) <= _MOST_JOINTS
    ):  # an object for each joint, in their order
        for place, item in enumerate(items):
            yield from _leaves(item, f"{key}[{place}].")
    elif len(names) == len(items) and not isinstance(items[0], list):
        yield from ((f"{key}.{n}", i) for n, i in zip(names, items, strict=True))
    else:
        yield key, items


def _unquoted(values: list[Any]) -> list[Any]:
    """Return numbers that are written as texts; as they are, if a text is none."""
    if not any(isinstance(value, str) for value in values):
        return values
    read = [number(v, ".") if isinstance(v, str) else v for v in values]
    pairs = zip(read, values, strict=True)
    return values if any(r is None and v is not None for r, v in pairs) else read


def _numbers(lists: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Return the lists that are arrays of numbers, of one or two dimensions."""
    found = {}
    for name, values in lists.items():
        if isinstance(values, list) and is_time(name):
            values = [number(v, ".") if isinstance(v, str) else v for v in values]
        if not isinstance(values, list) or any(isinstance(v, str) for v in values):
            continue
        kinds = {type(v) for v in values} - {type(None)}
        if bool in kinds and kinds & {int, float}:
            values = [nan if isinstance(v, bool) else v for v in values]
        try:
            array = np.array(values, dtype=np.float64)
        except (TypeError, ValueError):
            continue
        if array.ndim in (1, 2) and not np.isnan(array).all():
            found[name] = array
            if kinds == {bool} and None not in values:
                found[name] = array.astype(np.bool_)
    return found
