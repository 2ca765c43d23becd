"""Values that show themselves in a few lines, and as a table in notebooks."""

from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from inspect import signature
from math import prod
from typing import Any, TypeVar

from consistent_id._support.tables import Table

_Value = TypeVar("_Value")
_MOST = 1000
"""Characters up to which a value is shown with all its fields in full."""
_FIELD = 100
"""Characters up to which one field of a larger value is shown in full."""
_ITEMS = 6
"""Numbers up to which an array of a larger value is shown in full."""


def brief(cls: type[_Value]) -> type[_Value]:
    """Let a dataclass or named tuple show itself in a few lines; a decorator above it.

    Small values keep the text that Python makes of all fields.  Of others, large
    arrays are shown by their shapes and long sequences by their lengths.  Notebooks
    show the value's own tables, or else a table of its fields.  A dataclass that has
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
            if len(text) <= _MOST:
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
