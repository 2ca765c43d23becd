"""Faults of a problem file: the line, the key, and the allowed words."""

import re
from collections.abc import Iterator, Sequence
from typing import Any

import msgspec
import msgspec.inspect

from consistent_id.robot.parameters import did_you_mean

_ANY = "..."  # a key that the decoder does not name: a joint, a link
_PATH = re.compile(r" - at (`key` in )?`\$(?P<path>[^`]*)`$")
_UNKNOWN = re.compile(r"Object contains unknown field `(?P<key>.*)`$")
_MISSING = re.compile(r"Object missing required field `(?P<key>.*)`$")
_VALUE = re.compile(r"Invalid enum value '?(?P<value>.*?)'?$")
_HEADER = re.compile(r"\s*(\[\[?)\s*(?P<name>[^\[\]]+?)\s*\]\]?\s*(#.*)?$")
_WORD = r"""(?:[\w-]+|"[^"]*"|'[^']*')"""
_PART = re.compile(_WORD)
_KEY = re.compile(rf"\s*(?P<name>{_WORD}(?:\s*\.\s*{_WORD})*)\s*=")

Place = tuple[str, ...]


def fault_of(cause: str, text: str, table: type[msgspec.Struct]) -> str:
    """Return the fault, its place, and what could stand there instead.

    Parameters
    ----------
    cause : str
        The decoder's message, with the path of the key.
    text : str
        The text of the file.
    table : type
        The struct that the text does not fit.

    Returns
    -------
    str
        Begins with ``line N:``, or with the fault if its line is unknown.
    """
    found = _PATH.search(cause)
    place = () if found is None else _place(found["path"])
    said = cause if found is None else cause[: found.start()]
    of_key = found is not None and found[1] is not None
    where = _shown(place)
    if unknown := _UNKNOWN.match(said):
        key = unknown["key"]
        near = did_you_mean(key, _keys(table, place))
        line = _line(text, (*place, key))
        return f"{line}{where} has no key {key!r}; {near}"
    if missing := _MISSING.match(said):
        return f"{_line(text, place)}{where} needs the key {missing['key']!r}"
    if wrong := _VALUE.match(said):
        value = wrong["value"]
        allowed = _allowed(table, place, of_key=of_key)
        listed = ", ".join(f'"{choice}"' for choice in allowed)
        target = (*place, value) if of_key else place
        what = f'the key "{value}"' if of_key else f'"{value}"'
        line = _line(text, target, value)
        return f"{line}{where} has {what}, expected one of {listed}"
    return f"{_line(text, place)}{where}: {said}"


def _place(path: str) -> Place:
    """Return the keys and indices of a decoder's path.

    Examples
    --------
    >>> _place(".data.recordings[1].rows"), _place(".joints[...].coulomb")
    (('data', 'recordings', '1', 'rows'), ('joints', '...', 'coulomb'))
    """
    return tuple(re.findall(r"\.\.\.|[^.\[\]]+", path))


def _shown(place: Place) -> str:
    return ".".join("NAME" if part == _ANY else part for part in place) or "the file"


def _line(text: str, place: Place, value: str = "") -> str:
    """Return ``line N: `` for the line with a value that fits a place best."""
    best, number = 0, 0
    for k, (here, line) in enumerate(_places(text), start=1):
        common = _common(here, place)
        full = common == len(place) and (not value or value in line)
        score = 2 * common + full
        if common and score > best:
            best, number = score, k
    return f"line {number}: " if number else ""


def _common(here: Place, place: Place) -> int:
    """Return the number of equal parts from the left; 0 for other tables' lines."""
    agree = 0
    for mine, asked in zip(here, place, strict=False):
        if asked not in (mine, _ANY):
            break
        agree += 1
    return agree


def _places(text: str) -> Iterator[tuple[Place, str]]:
    """Yield the place that each line of a TOML text is about."""
    table: Place = ()
    counts: dict[Place, int] = {}
    for line in text.splitlines():
        if header := _HEADER.match(line):
            name = _parts(header["name"])
            table = _indexed(name, counts)
            if header[1] == "[[":
                counts[name] = counts.get(name, -1) + 1
                table = (*_indexed(name[:-1], counts), name[-1], str(counts[name]))
            yield table, line
        elif key := _KEY.match(line):
            yield (*table, *_parts(key["name"])), line
        else:
            yield (), line


def _indexed(name: Place, counts: dict[Place, int]) -> Place:
    """Return a table's name with the number of each array of tables that it is in."""
    found: list[str] = []
    for end, part in enumerate(name, start=1):
        found.append(part)
        if name[:end] in counts:
            found.append(str(counts[name[:end]]))
    return tuple(found)


def _parts(name: str) -> Place:
    return tuple(part.strip("\"'") for part in _PART.findall(name))


def _keys(table: type[msgspec.Struct], place: Place) -> list[str]:
    """Return the keys of the table at a place."""
    for kind in _at(table, place):
        if isinstance(kind, msgspec.inspect.StructType):
            return [field.encode_name for field in kind.fields]
    return []


def _allowed(
    table: type[msgspec.Struct], place: Place, *, of_key: bool
) -> Sequence[object]:
    """Return the words that may stand at a place, or be keys there."""
    for kind in _at(table, place):
        if of_key and isinstance(kind, msgspec.inspect.DictType):
            kind = kind.key_type
        if isinstance(kind, msgspec.inspect.LiteralType):
            return list(kind.values)
    return []


def _at(table: type[msgspec.Struct], place: Place) -> list[Any]:
    """Return the types that may stand at a place."""
    kinds = _alternatives(msgspec.inspect.type_info(table))
    for part in place:
        inner = [kind for outer in kinds for kind in _inside(outer, part)]
        kinds = [choice for kind in inner for choice in _alternatives(kind)]
    return kinds


def _inside(kind: Any, part: str) -> list[Any]:
    """Return the types at a key or an index."""
    inspect = msgspec.inspect
    if isinstance(kind, inspect.StructType):
        return [f.type for f in kind.fields if f.encode_name == part]
    if isinstance(kind, inspect.DictType):
        return [kind.value_type]
    return [kind.item_type] if isinstance(kind, inspect.ListType) else []


def _alternatives(kind: Any) -> list[Any]:
    inspect = msgspec.inspect
    if isinstance(kind, inspect.Metadata):
        return _alternatives(kind.type)
    if isinstance(kind, inspect.UnionType):
        return [choice for member in kind.types for choice in _alternatives(member)]
    return [kind]
