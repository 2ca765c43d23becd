"""The text of a problem file: written from its content, rewritten with its comments."""

import json
import math
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial, reduce
from pathlib import Path
from textwrap import wrap
from typing import Any

import msgspec

from consistent_id._support.files import when_written, write_atomically
from consistent_id._support.ownership import marked
from consistent_id.errors import ProblemError
from consistent_id.problems.file import ProblemTable, problem_table
from consistent_id.problems.parameter_tables import FileTable
from consistent_id.problems.paths import record_own

_MOST_LINES = 1000  # three times the longest that was written by hand; more take long
# A header below its blank lines and comments.  To tomlkit these belong to the table
# before; so they are put below their header, marked, while tables are changed.
_LINE = r"""[ \t]*(?:#(?:(?!\"{3}|'{3}).)*)?\n"""  # no end of a text over several lines
_HEADER = re.compile(rf"(?m)^((?:{_LINE})*)([ \t]*\[.*\n?)")
_TURNED = re.compile(r"(?m)^([ \t]*\[.*\n)((?:#\^.*\n)+)")
_COMMENT = re.compile(r"(?:[ \t]*#.*\n)*\Z")  # directly above a header
_END = "end-of-the-file"  # a table for the comments after the last one


def rewritten(
    text: str, fresh: str, changed: Sequence[str], expected: ProblemTable
) -> str:
    """Return a problem file's text with other tables, comments kept.

    A table that does not change keeps its text; a comment of the fresh text replaces
    the one above it.  In a table that changes, lines with equal values keep their text.

    Parameters
    ----------
    text : str
        As the author wrote it.
    fresh : str
        The whole file written anew.
    changed : sequence of str
        Tables that differ in the fresh text, such as ``"data.preparation"``.
    expected : ProblemTable
        The content that the file must have.  If tables cannot be replaced one by one,
        or the file is very long, the fresh text is returned.
    """
    if text.count("\n") > _MOST_LINES:
        return fresh
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    text = text.replace("\r\n", "\n").rstrip()
    comments = {
        _path(header): _COMMENT.findall(above)[0]
        for above, header in _HEADER.findall(fresh)
    }

    def comment(path: str) -> str | None:
        """Return the new comment above a table, or None to keep the old one."""
        known = [p for p in changed if path == p or path.startswith(f"{p}.")]
        return comments.get(path, "") or ("" if known else None)

    try:
        written = tomlkit.parse(_turned(f"{text}\n[{_END}]\n", comment))
        anew = tomlkit.parse(_turned(fresh, lambda _: None))
        for path in changed:
            _replace(written, anew, path.split("."))
        kept = _TURNED.sub(_turned_back, written.as_string())
        kept = kept.replace(f"[{_END}]\n", "").strip() + "\n"
        if "\n\n\n" not in text:  # a removed table leaves its blank line
            kept = re.sub(r"\n{3,}", "\n\n", kept)
        said = problem_table(kept, Path("problem.toml"))
    except (TOMLKitError, ProblemError):
        return fresh
    return kept if said == expected else fresh


def _turned(text: str, comment: Callable[[str], str | None]) -> str:
    """Move comments from above a header to below it; some tables get other ones."""

    def turned(found: re.Match[str]) -> str:
        above, header = found.groups()
        if (other := comment(_path(header))) is not None:
            above = _COMMENT.sub("", above, count=1) + other
        return header + re.sub("(?m)^(?=.*\n)", "#^", above)

    return _HEADER.sub(turned, text)


def _turned_back(found: re.Match[str]) -> str:
    header, below = found.groups()
    return re.sub(r"(?m)^#\^", "", below) + header


def _path(header: str) -> str:
    """Return a header's name without spaces."""
    try:
        inner: Any = tomllib.loads(header)
    except tomllib.TOMLDecodeError:  # a line of an array or of a text
        return ""
    names = []
    while inner:
        ((name, inner),) = inner.items()
        names.append(bare_key(name))
        inner = inner[0] if isinstance(inner, list) else inner
    return ".".join(names)


def _replace(written: Any, anew: Any, path: Sequence[str]) -> None:
    """Update a table, and those below it, to the fresh content."""
    name, *rest = path
    if name not in anew:
        written.pop(name, None)
    elif name not in written:
        _insert(written, name, anew)
    elif rest:
        _replace(written[name], anew[name], rest)
    else:
        _update(written, name, anew)


def _update(written: Any, name: str, anew: Any) -> None:
    """Give a key its new value; in a table, each key whose value differs."""
    old, fresh = written[name], anew.item(name)  # a bool has its comment as an item
    if isinstance(old, Mapping) and isinstance(fresh, Mapping):
        for key in [*fresh, *(key for key in list(old) if key not in fresh)]:
            _replace(old, fresh, [key])
    elif old != anew[name]:
        comment = fresh.trivia.comment_ws, fresh.trivia.comment
        written[name] = fresh  # with the old comment if it has none
        if hasattr(written, "item"):  # it has none if its table is in several places
            line = written.item(name).trivia
            line.comment_ws, line.comment = comment


def _insert(written: Any, name: str, anew: Any) -> None:
    """Add a key; tables that the fresh text has later move behind a table."""
    from tomlkit.items import AoT, Table

    moved = {name: anew.item(name)}
    if isinstance(moved[name], Table | AoT):
        keys, order = list(written), list(anew)
        before = [key for key in keys if key in order[: order.index(name)]]
        behind = keys[keys.index(before[-1]) + 1 if before else 0 :]
        tables = [key for key in behind if isinstance(written[key], Table | AoT)]
        moved |= {key: written.pop(key) for key in tables}
    for key, value in moved.items():
        written[key] = value


def changed_tables(
    old: ProblemTable, new: ProblemTable, paths: Sequence[str]
) -> list[str]:
    """Return the tables of a problem file that differ.

    Parameters
    ----------
    paths : sequence of str
        Paths of the tables that may differ.
    """
    return [p for p in paths if _at(old, p) != _at(new, p)]


def _at(table: object, path: str) -> object:
    return reduce(
        lambda inner, key: None if inner is None else getattr(inner, key),
        path.split("."),
        table,
    )


_WIDTH = 86  # characters of a comment's line, behind its mark


def write_problem(text: str, file: Path) -> Path:
    """Write a problem file of this user's own, and return its path.

    It opens without ``trust``, whatever folders its inputs are in (see `record_own`),
    and may be written again as long as nobody edits it (see `marked`).

    Raises
    ------
    ProblemError
        If it is not the text of a problem, or cannot be written.
    """
    table = problem_table(text, file)
    write_atomically(file, marked(text))
    when_written(partial(record_own, table, file))
    return file


def toml_text(table: FileTable, comments: Mapping[str, str]) -> str:
    """Return a table as TOML.

    Parameters
    ----------
    comments : mapping of str to str
        Comments by the path of a key, such as ``"drive.viscous"``.  They are written
        beside a value or above a table.  A key with its default value is written only
        if it has a comment; ``""`` is enough.
    """
    return "\n".join(_lines(table, "", comments)).strip() + "\n"


def _lines(table: FileTable, path: str, comments: Mapping[str, str]) -> Iterator[str]:
    """Yield a table's own keys, then the tables in it."""
    tables, named = [], set()
    for key, value, default in _fields(table):
        inner = f"{path}.{key}".lstrip(".")
        if isinstance(value, FileTable):
            tables.append((inner, [value], f"[{inner}]"))
        elif isinstance(value, Mapping) and _has_tables(value):
            for name, member in value.items():
                path_of = f"{inner}.{bare_key(name)}"
                tables.append((path_of, [member], f"[{path_of}]"))
                named.add(path_of)
        elif isinstance(value, list) and value and isinstance(value[0], FileTable):
            tables.append((inner, value, f"[[{inner}]]"))
        elif value is None and default is msgspec.UNSET:
            yield f"{key} = 0"  # none, where a key that is missing means another's
        elif value is not None and (value != default or inner in comments):
            beside = comments.get(inner)
            yield f"{key} = {_value(value)}" + (
                f"  # {one_line(beside)}" if beside else ""
            )
    for inner, members, header in sorted(tables, key=lambda t: t[2].startswith("[[")):
        for member in members:
            lines = list(_lines(member, inner, comments))
            above = list(_comment_lines(comments.get(inner, "")))
            if lines or above or inner in named:
                yield from ["", *above, header, *lines]


def one_line(text: str) -> str:
    r"""Return a text for a comment: a line break in a file's name would end it.

    Examples
    --------
    >>> one_line("log\na = 1.csv")
    'log a = 1.csv'
    """
    return "".join(c if c.isprintable() else " " for c in text)


def _comment_lines(text: str) -> Iterator[str]:
    """Yield a comment's lines, each folded where it is too long."""
    for line in text.splitlines():
        folded = wrap(line, _WIDTH, break_long_words=False, break_on_hyphens=False)
        yield from (f"# {one_line(part)}" for part in folded)


def _has_tables(value: Mapping[str, Any]) -> bool:
    return any(isinstance(member, FileTable) for member in value.values())


def problem_name(file: Path) -> str:
    """Return the name of a problem after a file, in letters that a name may have."""
    kept = "".join(c if c.isascii() and c.isalnum() else "-" for c in file.stem)
    return kept.strip("-") or "problem"


def bare_key(name: str) -> str:
    """Return a key in TOML's form: in quotes if it needs them."""
    plain = all(c.isascii() and (c.isalnum() or c in "-_") for c in name)
    return name if plain and name else _value(name)


def _fields(table: FileTable) -> Iterator[tuple[str, Any, Any]]:
    """Yield a table's keys, values and defaults; its tag first, if it has one."""
    config = type(table).__struct_config__
    if config.tag_field is not None:
        yield config.tag_field, config.tag, None
    for field in msgspec.structs.fields(table):
        default = field.default
        if field.default_factory is not msgspec.NODEFAULT:
            default = field.default_factory()
        yield field.encode_name, getattr(table, field.name), default


def _value(value: object) -> str:
    if isinstance(value, FileTable):
        value = {k: v for k, v, default in _fields(value) if v != default}
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(item) for item in value)}]"
    if isinstance(value, Mapping):
        pairs = (
            f"{bare_key(str(key))} = {_value(item)}" for key, item in value.items()
        )
        return f"{{{', '.join(pairs)}}}"
    if value == math.inf:
        return "inf"
    return json.dumps(value, ensure_ascii=False)
