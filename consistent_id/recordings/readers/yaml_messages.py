"""Messages as ``ros2 topic echo`` prints them: the part of YAML that it writes.

Mappings and lists by indentation or in brackets, and scalars; no anchors or tags.
Texts of several lines are left out: they are no numbers.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

_KEY = re.compile(
    r"(?P<key>'[^']*'|\"[^\"]*\"|[^\s'\"\[\]{}#].*?):(?:\s+(?P<value>.*)|$)"
)
_BLOCK = re.compile(r"[|>][-+\d]*")  # begins a text of several lines
_COMMENT = re.compile(r"\s+#.*")
_PIECE = re.compile(r"\s*([\[\]{},]|'[^']*'|\"[^\"]*\"|[^\[\]{},]+)")
_CLOSING = {"[": "]", "{": "}"}
_OPENING = ("[", "{", "'", '"', "|", ">")
_NUMBERS = {".nan": "nan", "null": "nan", "~": "nan", ".inf": "inf", "-.inf": "-inf"}
_NAMES = ("name", "names", "joint_names")  # of the joints of lists beside or below


class MessageError(ValueError):
    """A line of a message that is not understood."""


class _Line(NamedTuple):
    """A line without its indentation, in characters; a list's dash counts as two."""

    indent: int
    text: str


def fields_of(text: str) -> dict[str, str]:
    r"""Return the numbers of a message by their path.

    Items of a list have the names of a list of names beside it, or above.

    Raises
    ------
    MessageError
        If a line is not understood, such as one that is indented unevenly.

    Examples
    --------
    >>> said = "joint_names: [b, a]\nfeedback:\n  positions:\n  - 0.1\n  - 0.2\n"
    >>> fields_of(said)
    {'feedback.positions.b': '0.1', 'feedback.positions.a': '0.2'}
    """
    stripped = ((line, line.strip()) for line in text.splitlines())
    lines = [
        _Line(len(line) - len(line.lstrip()), bare)
        for line, bare in stripped
        if bare not in ("", "---") and not bare.startswith("#")
    ]
    if not lines:
        return {}
    value, at = _block(lines, 0, lines[0].indent)
    if at < len(lines):
        raise MessageError(f"{lines[at].text!r} is indented as no line above it")
    return dict(_numbers(value, "", [])) if isinstance(value, dict) else {}


def _block(lines: list[_Line], at: int, indent: int) -> tuple[object, int]:
    """Return the mapping or list that begins at a line, and the line after it."""
    if _is_item(lines[at].text):
        return _items(lines, at, indent)
    found: dict[str, object] = {}
    while at < len(lines) and lines[at].indent == indent:
        text = lines[at].text
        match = _KEY.fullmatch(text)
        if match is None or _is_item(text):
            raise MessageError(f"{text!r} is neither KEY: VALUE nor an item of a list")
        key, value = match["key"].strip("'\""), _plain(match["value"] or "")
        at += 1
        if value and not value.startswith("#"):
            found[key], at = _scalar(lines, at, indent, value)
        elif at < len(lines) and _is_below(lines[at], indent):
            found[key], at = _block(lines, at, lines[at].indent)
    return found, at


def _plain(text: str) -> str:
    """Return a value without a comment behind it."""
    return _COMMENT.sub("", text) if "#" in text else text


def _is_item(text: str) -> bool:
    return text == "-" or text.startswith("- ")


def _is_below(line: _Line, indent: int) -> bool:
    """Return whether a line belongs to the key above; lists may not be indented."""
    return line.indent > indent or (line.indent == indent and _is_item(line.text))


def _items(lines: list[_Line], at: int, indent: int) -> tuple[list[object], int]:
    """Return a list; what follows a dash becomes a line of its own in `lines`."""
    found = list[object]()
    while at < len(lines) and lines[at].indent == indent and _is_item(lines[at].text):
        text = lines[at].text[1:].lstrip()
        inner = indent + len(lines[at].text) - len(text)
        below = not text and at + 1 < len(lines) and lines[at + 1].indent > indent
        if below:
            value, at = _block(lines, at + 1, lines[at + 1].indent)
        elif (":" in text and _KEY.fullmatch(text)) or _is_item(text):
            lines[at] = _Line(inner, text)
            value, at = _block(lines, at, inner)
        else:
            value, at = _scalar(lines, at + 1, indent, _plain(text))
        found.append(value)
    return found, at


def _scalar(
    lines: Sequence[_Line], at: int, indent: int, text: str
) -> tuple[object, int]:
    """Return the value that begins with a text, and the line after it."""
    if text[:1] not in _OPENING and (at == len(lines) or lines[at].indent <= indent):
        return _bare(text), at
    first, quote = at, text[:1] if text.startswith(("'", '"')) else ""
    closed = not quote or (len(text) > 1 and text.endswith(quote))
    while at < len(lines) and (not closed or lines[at].indent > indent):
        closed = closed or lines[at].text.endswith(quote)
        at += 1
    below = [line.text for line in lines[first:at]]
    if text[:1] in _CLOSING:
        return _in_brackets(" ".join([text, *below])), at
    if _BLOCK.fullmatch(text):
        return "", at
    for line in [] if quote else below:  # of a text, which goes on
        if _KEY.fullmatch(line) or _is_item(line):
            raise MessageError(f"{line!r} is indented below the value {text!r}")
    return _bare(" ".join([text, *below])), at


def _in_brackets(text: str) -> object:
    """Return the list or mapping in brackets that a text is."""
    pieces = _PIECE.findall(text)
    value, at = _flow(pieces, 0)
    if "".join(pieces[at:]).strip():
        raise MessageError(f"{text!r} goes on behind its last bracket")
    return value


def _flow(
    pieces: Sequence[str], at: int
) -> tuple[list[object] | dict[str, object], int]:
    """Return the list or mapping that begins at a piece, and the piece after it."""
    found, keyed = list[object](), dict[str, object]()
    close, key, at = _CLOSING[pieces[at]], "", at + 1
    while at < len(pieces) and pieces[at] != close:
        value: object = pieces[at].strip()
        if value in _CLOSING:
            value, at = _flow(pieces, at)
        else:
            name, colon, rest = str(value).partition(":")
            if close == "}" and colon:
                key, value = _bare(name), rest.strip()
            at += 1
            if value in ("", ","):
                continue
            value = _bare(str(value))
        keyed[key] = value
        found.append(value)
    if at == len(pieces):
        raise MessageError(f"{close!r} is missing behind {' '.join(pieces)!r}")
    return (keyed if close == "}" else found), at + 1


def _bare(text: str) -> str:
    bare = text.strip(" '\"")
    return _NUMBERS.get(bare.lower(), bare)


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
