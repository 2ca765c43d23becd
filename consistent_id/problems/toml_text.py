"""The text of a problem file, written from its content, with comments."""

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from textwrap import wrap
from typing import Any

import msgspec

from consistent_id.problems.table_types import Table

_WIDTH = 86  # characters of a comment's line, behind its mark


def toml_text(table: Table, comments: Mapping[str, str]) -> str:
    """Return a table as TOML.

    Parameters
    ----------
    comments : mapping of str to str
        By the path of a key, such as ``"drive.viscous"``: beside a value, or above a
        table.  A key with its default value is left out if it has none; ``""`` is
        enough.
    """
    return "\n".join(_lines(table, "", comments)).strip() + "\n"


def _lines(table: Table, path: str, comments: Mapping[str, str]) -> Iterator[str]:
    """Yield a table's own keys, then the tables in it."""
    tables, named = [], set()
    for key, value, default in _fields(table):
        inner = f"{path}.{key}".lstrip(".")
        if isinstance(value, Table):
            tables.append((inner, [value], f"[{inner}]"))
        elif isinstance(value, Mapping) and _has_tables(value):
            for name, member in value.items():
                path_of = f"{inner}.{bare_key(name)}"
                tables.append((path_of, [member], f"[{path_of}]"))
                named.add(path_of)
        elif isinstance(value, list) and value and isinstance(value[0], Table):
            tables.append((inner, value, f"[[{inner}]]"))
        elif value is None and default is msgspec.UNSET:
            yield f"{key} = 0"  # none, where a key that is missing means another's
        elif value is not None and (value != default or inner in comments):
            beside = comments.get(inner)
            yield f"{key} = {_value(value)}" + (f"  # {beside}" if beside else "")
    for inner, members, header in sorted(tables, key=lambda t: t[2].startswith("[[")):
        for member in members:
            lines = list(_lines(member, inner, comments))
            above = list(_comment_lines(comments.get(inner, "")))
            if lines or above or inner in named:
                yield from ["", *above, header, *lines]


def _comment_lines(text: str) -> Iterator[str]:
    """Yield a comment's lines, each folded where it is too long."""
    for line in text.splitlines():
        folded = wrap(line, _WIDTH, break_long_words=False, break_on_hyphens=False)
        yield from (f"# {part}" for part in folded)


def _has_tables(value: Mapping[str, Any]) -> bool:
    return any(isinstance(member, Table) for member in value.values())


def problem_name(file: Path) -> str:
    """Return the name of a problem after a file, in letters that a name may have."""
    kept = "".join(c if c.isascii() and c.isalnum() else "-" for c in file.stem)
    return kept.strip("-") or "problem"


def bare_key(name: str) -> str:
    """Return a key as TOML wants it: in quotes if it needs them."""
    plain = all(c.isascii() and (c.isalnum() or c in "-_") for c in name)
    return name if plain and name else _value(name)


def _fields(table: Table) -> Iterator[tuple[str, Any, Any]]:
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
    if isinstance(value, Table):
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
