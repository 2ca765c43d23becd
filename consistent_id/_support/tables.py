"""Text for people: tables, and values that show themselves in a few lines.

A table is aligned for the terminal, or Markdown; a value in a notebook is a table, too.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from html import escape
from inspect import signature
from math import prod
from typing import Any, TypeVar


@dataclass(frozen=True, slots=True)
class Table:
    """A titled table with notes below it.

    Examples
    --------
    >>> print(Table("Masses", ("link", "kg"), (("arm", "2.1"),)))
    Masses
      link   kg
      arm   2.1
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        return self.text()

    def text(self) -> str:
        """Return the table for a terminal; numbers are aligned to the right."""
        lines = [self.title]
        if self.rows:
            widths = [
                max(len(row[i]) for row in (self.header, *self.rows))
                for i in range(len(self.header))
            ]
            right = [_numeric(row[i] for row in self.rows) for i in range(len(widths))]
            lines += [
                "  "
                + "  ".join(
                    cell.rjust(width) if numbers else cell.ljust(width)
                    for cell, width, numbers in zip(row, widths, right, strict=True)
                ).rstrip()
                for row in (self.header, *self.rows)
            ]
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])

    def markdown(self) -> str:
        """Return the table as GitHub-flavoured Markdown."""
        lines = [f"### {self.title}", ""]
        if self.rows:
            right = [
                _numeric(row[i] for row in self.rows) for i in range(len(self.header))
            ]
            lines.append(_row(self.header))
            lines.append(_row(["---:" if numbers else "---" for numbers in right]))
            lines += [_row(row) for row in self.rows]
            lines.append("")
        lines += [f"{note}\n" for note in self.notes]
        return "\n".join(lines)

    def html(self) -> str:
        """Return the table as HTML, for notebooks."""
        rows = "".join(_html_row(row, "td") for row in self.rows)
        head = _html_row(self.header, "th") if self.rows else ""
        notes = "".join(f"<p>{escape(note)}</p>" for note in self.notes)
        return (
            f"<table><caption>{escape(self.title)}</caption>"
            f"<thead>{head}</thead><tbody>{rows}</tbody></table>{notes}"
        )


def _html_row(cells: Sequence[str], tag: str) -> str:
    inner = "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells)
    return f"<tr>{inner}</tr>"


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _numeric(cells: Iterable[str]) -> bool:
    """Return whether a column has numbers (or dashes) only."""
    return all(
        cell.strip().lstrip("+-").replace("e", "").replace("%", "")[:1].isdigit()
        or cell in ("", "-", "inf")
        for cell in cells
    )


_Value = TypeVar("_Value")
_MOST, _LINES = 1000, 30
"""Characters and lines up to which a value is shown with all its fields in full."""
_FIELD = 100
"""Characters up to which one field of a larger value is shown in full."""
_ITEMS = 6
"""Numbers up to which an array of a larger value is shown in full."""


def brief(cls: type[_Value]) -> type[_Value]:
    """Let a dataclass or named tuple show itself in a few lines; a decorator above it.

    Small values keep the text that Python makes of all fields.  In others, large arrays
    are shown by their shapes and long sequences by their lengths.  Notebooks show the
    value's own tables, or else a table of its fields.  A dataclass that has
    ``__repr__`` or ``_repr_html_`` of its own keeps it.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @brief
    ... @dataclass(frozen=True)
    ... class Samples:
    ...     name: str
    ...     values: np.ndarray
    >>> Samples("short", np.array([1.0, 2.0]))
    Samples(name='short', values=array([1., 2.]))
    >>> Samples("long" * 250, np.ones((300, 2)))
    Samples(name='longlonglonglonglonglonglonglonglonglon...', values=<array 300 x 2>)
    """
    made: Any = cls.__repr__
    if hasattr(made, "__wrapped__") or hasattr(cls, "_fields"):  # made by Python

        def shown(self: _Value) -> str:
            text: str = made(self)
            if len(text) <= _MOST and text.count("\n") < _LINES:
                return text
            parts = ", ".join(f"{name}={short}" for name, short in _fields(self))
            return f"{type(self).__name__}({parts})"

        setattr(cls, "__repr__", shown)  # noqa: B010 (mypy refuses the assignment)
    if not hasattr(cls, "_repr_html_"):
        setattr(cls, "_repr_html_", _html)  # noqa: B010
    return cls


def _html(self: Any) -> str:
    for name in ("table", "tables"):
        own = getattr(type(self), name, None)
        if callable(own) and len(signature(own).parameters) == 1:
            found: Table | Iterable[Table] = getattr(self, name)()
            tables = [found] if isinstance(found, Table) else found
            return "".join(table.html() for table in tables)
    rows = tuple(_fields(self))
    return Table(type(self).__name__, ("field", "value"), rows).html()


def _fields(value: Any) -> list[tuple[str, str]]:
    """Return names and short texts of the fields that a value shows."""
    if is_dataclass(value):
        names = [field.name for field in fields(value) if field.repr]
    else:
        names = value._fields
    return [(name, _short(getattr(value, name))) for name in names]


def _short(value: object) -> str:
    """Return at most a line of a field's value."""
    shape = getattr(value, "shape", ())
    if prod(shape) > _ITEMS:
        return f"<array {' x '.join(map(str, shape))}>"
    text = " ".join(repr(value).split())
    if len(text) <= _FIELD:
        return text
    if isinstance(value, Mapping):
        return f"<{len(value)} entries>"
    if isinstance(value, tuple | list | frozenset | set):
        kinds = {type(item).__name__ for item in value}
        return f"<{len(value)} of {' or '.join(sorted(kinds))}>"
    if isinstance(value, str):
        return f"{text[:40]}...{text[-1]}"
    if is_dataclass(value):
        return f"<{type(value).__name__}>"
    return f"{text[: _FIELD - 3]}..."


def some_of(names: Sequence[str], most: int = 3, between: str = ", ") -> str:
    """Return names in one sentence: at most so many, and the number of the others.

    Examples
    --------
    >>> some_of(["a", "b", "c", "d"], 2)
    'a, b and 2 more'
    """
    more = len(names) - most
    shown = between.join(names[:most])
    last = " " if between == ", " else between
    return f"{shown}{last}and {more} more" if more > 0 else shown
