"""Messages as ``ros2 topic echo`` prints them: the part of YAML that it writes.

Mappings and lists by indentation, lists in brackets, and scalars; no anchors, tags or
texts of several lines.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

_KEY = re.compile(r"(?P<key>[\w./-]+):(?:\s+(?P<value>.*)|$)")
_NAMES = ("name", "names", "joint_names")  # of the joints of lists beside or below


class _Line(NamedTuple):
    """A line without its indentation, in characters; a list's dash counts as two."""

    indent: int
    text: str


def fields_of(text: str) -> dict[str, str]:
    r"""Return the numbers of a message by their path.

    Items of a list have the names of a list of names beside it, or above.

    Examples
    --------
    >>> said = "joint_names: [b, a]\nfeedback:\n  positions:\n  - 0.1\n  - 0.2\n"
    >>> fields_of(said)
    {'feedback.positions.b': '0.1', 'feedback.positions.a': '0.2'}
    """
    lines = [
        _Line(len(line) - len(line.lstrip()), line.strip())
        for line in text.splitlines()
        if line.strip() not in ("", "---") and not line.lstrip().startswith("#")
    ]
    value, _ = _block(lines, 0, lines[0].indent) if lines else ({}, 0)
    return dict(_numbers(value, "", [])) if isinstance(value, dict) else {}


def _block(lines: Sequence[_Line], at: int, indent: int) -> tuple[object, int]:
    """Return the mapping or list that begins at a line, and the line after it."""
    if lines[at].text.startswith("-"):
        return _items(lines, at, indent)
    found: dict[str, object] = {}
    while at < len(lines) and lines[at].indent == indent:
        match = _KEY.fullmatch(lines[at].text)
        if match is None:
            return found, len(lines)
        at += 1
        if match["value"]:
            found[match["key"]] = _scalar(match["value"])
        elif at < len(lines) and _is_below(lines[at], indent):
            found[match["key"]], at = _block(lines, at, lines[at].indent)
    return found, at


def _is_below(line: _Line, indent: int) -> bool:
    """Return whether a line belongs to the key above; lists may not be indented."""
    return line.indent > indent or (line.indent == indent and line.text.startswith("-"))


def _items(lines: Sequence[_Line], at: int, indent: int) -> tuple[list[object], int]:
    found = list[object]()
    rows = list(lines)
    while at < len(rows) and rows[at].indent == indent and rows[at].text[:1] == "-":
        text = rows[at].text[1:].lstrip()
        if _KEY.fullmatch(text):  # a mapping, whose first line has the dash
            inner = indent + len(rows[at].text) - len(text)
            rows[at] = _Line(inner, text)
            value, at = _block(rows, at, inner)
            found.append(value)
        else:
            found.append(_scalar(text))
            at += 1
    return found, at


def _scalar(text: str) -> object:
    if text.startswith("[") and text.endswith("]"):
        return [_scalar(one.strip()) for one in text[1:-1].split(",") if one.strip()]
    bare = text.strip("'\"")
    return "nan" if bare.lower() == ".nan" else bare


def _numbers(
    value: object, before: str, names: Sequence[str]
) -> Iterator[tuple[str, str]]:
    """Yield the paths of numbers, and their text."""
    if isinstance(value, Mapping):
        names, below = names_of(value, names)
        for key, inner in value.items():
            path = f"{before}.{key}" if before else key
            is_list = isinstance(inner, list)
            yield from _numbers(inner, path, names if is_list else below)
    elif isinstance(value, list):
        named = len(names) == len(value)
        for k, inner in enumerate(value):
            path = f"{before}.{names[k]}" if named else f"{before}[{k}]"
            yield from _numbers(inner, path, ())
    elif isinstance(value, str) and is_float(value):
        yield before, value


def names_of(
    value: Mapping[str, Any], above: Sequence[str] = ()
) -> tuple[Sequence[str], Sequence[str]]:
    """Return the names of the lists beside them, and of those in mappings below.

    Lists of as many items beside the names are what they name, and others below are of
    another thing, such as the pose of a tool.

    Examples
    --------
    >>> names_of({"names": ["b", "a"], "feedback": {"positions": [0.1, 0.2]}})
    (['b', 'a'], ['b', 'a'])
    >>> names_of({"names": ["b", "a"], "q": [1, 2], "tip": {"position": [0.1, 0.2]}})
    (['b', 'a'], ())
    """
    names = next((value[k] for k in _NAMES if are_names(value.get(k))), above)
    lists = (v for v in value.values() if isinstance(v, list) and v is not names)
    named = any(len(v) == len(names) > 0 for v in lists)
    return names, () if named else names


def are_names(value: object) -> bool:
    """Return whether a value is a list of distinct texts."""
    if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
        return False
    return 0 < len(set(value)) == len(value)


def is_float(text: str) -> bool:
    """Return whether a text is a number as Python writes it."""
    try:
        float(text)
    except ValueError:
        return False
    return True
