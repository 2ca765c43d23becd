"""Long tables, with a row for each joint and instant, as tables of a row an instant.

A long table has a column that names the joint, by text or by an integer, and one column
for each channel; or a column that names the signal, and one of values.  Its stamps may
be equal for all joints, be lost for some of them, or differ from joint to joint: then
values are interpolated to the stamps of the joint that has the fewest.
"""

import csv
import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from consistent_id._support.arrays import BoolArray, IntArray, Matrix, Vector
from consistent_id.recordings.column_words import channel_of, words
from consistent_id.recordings.readers.text_files import SPACE, separator_of
from consistent_id.recordings.readers.text_numbers import (
    date_order,
    decimal_mark,
    is_number,
    number,
)
from consistent_id.recordings.readers.units import (
    clock_columns,
    fraction_unit,
    is_time,
    split_clock,
)

_JOINT = {"joint", "joints", "jnt", "axis", "motor", "actuator", "servo", "dof"}
_NUMBER = {"id", "index", "idx", "nr", "no", "num", "number", "name", "names"}
_SIGNAL = {"signal", "variable", "field", "channel", "name", "key", "metric", "tag"}
_SIGNAL |= {"label", "series", "topic"}
_VALUE = {"value", "values", "val"}
_HEAD = 1_000  # rows that show what a table may be
_FEWEST = 2  # joints or signals
_MOST = 500  # joints or signals
_CHANGES = 0.5  # least share of rows after which another joint follows
_COMMON = 0.8  # least share of instants at which all joints have a row
_OVERLAP = 0.8  # least share of the time that every joint covers
_GAP = 3.0  # usual steps between samples, beyond which nothing is interpolated
_DIGIT = re.compile(r"\d")


@dataclass(frozen=True, slots=True, eq=False)
class LongOrder:
    """The rows of a long table for each instant and joint.

    Parameters
    ----------
    joints : tuple of str
    before, after : ndarray of int, shape (instants, joints)
        Rows between which a value lies.
    weight : ndarray, shape (instants, joints)
        Share of the value of the second row.
    own : int
        The joint whose stamps are used.
    left_out : int
        Instants without a row of every joint, which are not used.
    """

    joints: tuple[str, ...]
    before: IntArray
    after: IntArray
    weight: Matrix
    own: int = 0
    left_out: int = 0

    @property
    def moved(self) -> bool:
        """Whether values are interpolated."""
        return bool(self.weight.any())

    def sentence(self, name: str) -> str:
        """Return a sentence that says how the table of a name is read."""
        said = (
            f"{name} has a row for each instant and each of {', '.join(self.joints)}: "
            "they are read side by side"
        )
        if self.moved:
            said += f", interpolated to the stamps of {self.joints[self.own]}"
        if self.left_out:
            said += f"; {self.left_out} instants that lack some of them are left out"
        return said


def joint_column(names: Sequence[str], columns: Mapping[str, Sequence[str]]) -> str:
    """Return the column that names the joint or signal of each row; empty for none.

    Parameters
    ----------
    names : sequence of str
        All columns.
    columns : mapping of str to sequence of str
        Their cells, as text.

    Examples
    --------
    >>> cells = {"t": ["0", "0", "1", "1"], "joint": ["a", "b", "a", "b"]}
    >>> joint_column(["t", "joint", "q"], cells | {"q": ["1", "2", "3", "4"]})
    'joint'
    """
    likely = [n for n in names if may_name(n, names) and _names_rows(columns[n])]
    found = [name for name in likely if len(set(columns[name])) >= _FEWEST]
    if len(found) != 1:
        return ""
    (key,) = found
    if _value_column(names, key) is not None:
        return key
    # A table with several positions in a row may have a text beside them.
    positions = [n for n in names if channel_of(n) == "position"]
    if len(positions) == 1:
        says_joint = words(key) & (_JOINT | {"name", "names"})
        return key if says_joint or _alternates(columns[key]) else ""
    numbered = any(map(_DIGIT.search, positions))
    clock = _clock_of(names)
    stands = clock and not _alternates(columns[clock[-1]])
    return key if stands and not numbered and _alternates(columns[key]) else ""


def _alternates(cells: Sequence[str]) -> bool:
    """Return whether most cells differ from the one before."""
    each = np.array(cells)
    return bool(np.mean(each[1:] != each[:-1]) > _CHANGES)


def may_name(name: str, names: Sequence[str]) -> bool:
    """Return whether a column of this name may name joints or signals."""
    said = words(name)
    if not said or not said <= _JOINT | _NUMBER | _SIGNAL:
        return False
    if said & (_JOINT | _NUMBER):
        return any(channel_of(n) == "position" for n in names) or (
            _value_column(names, name) is not None
        )
    return _value_column(names, name) is not None


def _value_column(names: Sequence[str], key: str) -> str | None:
    """Return the only column of values beside signals' names, or None."""
    found = [n for n in names if n != key and words(n) and words(n) <= _VALUE]
    return found[0] if len(found) == 1 else None


def _names_rows(cells: Sequence[str]) -> bool:
    """Return whether cells are names, or numbers, that are repeated."""
    each = set(cells)
    if not 1 <= len(each) <= min(_MOST, len(cells) / 2) or "" in each:
        return False
    numbers = [is_number(cell) for cell in each]
    return not any(numbers) or all(cell.isdigit() for cell in each)


def long_order(keys: Sequence[str], time: Vector | None) -> LongOrder | None:
    """Return the rows for each instant; None if the table has no such order.

    Parameters
    ----------
    keys : sequence of str, shape (rows,)
        Joint of each row.
    time : ndarray, shape (rows,), optional
        Stamps.
    """
    first, places = np.unique(np.array(keys), return_index=True)
    names = first[np.argsort(places)]
    if all(name.isdigit() for name in names):
        names = np.array(sorted(names, key=int))
    keys_of = np.array(keys)
    rows = [np.flatnonzero(keys_of == name) for name in names]
    joints = tuple(map(str, names))
    if time is None:
        together = len({len(each) for each in rows}) == 1
        return _exact(joints, np.column_stack(rows)) if together else None
    stamps = [time[each] for each in rows]
    if all(np.array_equal(each, stamps[0]) for each in stamps):
        return _exact(joints, np.column_stack(rows))
    order = [np.argsort(each, kind="stable") for each in stamps]
    rows = [each[o] for each, o in zip(rows, order, strict=True)]
    stamps = [each[o] for each, o in zip(stamps, order, strict=True)]
    return _common(joints, rows, stamps) or _between(joints, rows, stamps)


def _exact(joints: tuple[str, ...], rows: IntArray, left_out: int = 0) -> LongOrder:
    return LongOrder(joints, rows, rows, np.zeros(rows.shape), left_out=left_out)


def _common(
    joints: tuple[str, ...], rows: Sequence[IntArray], stamps: Sequence[Vector]
) -> LongOrder | None:
    """Return the instants that all joints have; None if these are few."""
    every = np.unique(np.concatenate(stamps))
    shared = every
    for each in stamps:
        shared = np.intersect1d(shared, each)
    if len(shared) < _COMMON * len(every):
        return None
    chosen = [
        own[np.searchsorted(each, shared)]
        for own, each in zip(rows, stamps, strict=True)
    ]
    return _exact(joints, np.column_stack(chosen), len(every) - len(shared))


def _between(
    joints: tuple[str, ...], rows: Sequence[IntArray], stamps: Sequence[Vector]
) -> LongOrder | None:
    """Return rows before and after the stamps of the joint that has the fewest."""
    begin = max(each[0] for each in stamps)
    end = min(each[-1] for each in stamps)
    longest = max(float(np.ptp(each)) for each in stamps)
    if min(map(len, stamps)) < 2 or not end - begin >= _OVERLAP * longest:
        return None
    own = int(np.argmin([len(each) for each in stamps]))
    at = np.unique(stamps[own])
    usable = (at >= begin) & (at <= end)
    found = [_around(at, each) for each in stamps]
    for _, _, near in found:
        usable &= near
    before, after = (
        np.column_stack([r[f[k]] for r, f in zip(rows, found, strict=True)])
        for k in (0, 1)
    )
    times = np.column_stack([each[f[0]] for each, f in zip(stamps, found, strict=True)])
    later = np.column_stack([s[f[1]] for s, f in zip(stamps, found, strict=True)])
    span = np.where(later > times, later - times, 1.0)
    weight = np.clip((at[:, None] - times) / span, 0.0, 1.0)
    lost = len(at) - int(usable.sum())
    return LongOrder(
        joints, before[usable], after[usable], weight[usable], own, left_out=lost
    )


def _around(at: Vector, stamps: Vector) -> tuple[IntArray, IntArray, BoolArray]:
    """Return the samples around each time, and whether they are near each other."""
    last = np.clip(np.searchsorted(stamps, at, side="right") - 1, 0, len(stamps) - 1)
    following = np.where(
        stamps[last] >= at, last, np.minimum(last + 1, len(stamps) - 1)
    )
    steps = np.diff(stamps)
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else np.inf
    return last, following, stamps[following] - stamps[last] <= _GAP * usual


def wide_columns(
    names: Sequence[str], columns: Mapping[str, NDArray[Any]], key: str
) -> tuple[dict[str, NDArray[Any]], LongOrder] | None:
    """Return the columns of a table with a row for each instant, and its order.

    Columns that are equal for all joints, such as the clock, keep their names; others
    are called ``JOINT.COLUMN``, and values of a signal by its name.

    Parameters
    ----------
    columns : mapping of str to ndarray, shape (rows,)
        Numbers, or cells as text.
    key : str
        See `joint_column`.
    """
    clock = _clock_of(names)
    time = _stamps(clock, columns)
    if time is not None and not (known := np.isfinite(time)).all():
        columns = {name: cells[known] for name, cells in columns.items()}
        time = time[known]
    order = long_order(columns[key].tolist(), time)
    if order is None:
        return None
    value, wide = _value_column(names, key), dict[str, NDArray[Any]]()
    for name in names:
        if name == key:
            continue
        cells = columns[name][order.before]
        if name in clock or (cells == cells[:, :1]).all():
            wide[name] = cells[:, order.own]
            continue
        if order.moved:
            cells = _interpolated(cells, columns[name][order.after], order.weight)
        for j, joint in enumerate(order.joints):
            wide[joint if name == value else f"{joint}.{name}"] = cells[:, j]
    return wide, order


def side_by_side(
    columns: Mapping[str, NDArray[Any]],
) -> tuple[dict[str, NDArray[Any]], LongOrder] | None:
    """Return a long table with a row for each instant, and its order; None of others.

    Parameters
    ----------
    columns : mapping of str to ndarray, shape (rows,)
        Numbers, or texts as objects; of the texts, only joints or signals are used.
    """
    names = tuple(columns)
    if not (likely := [name for name in names if may_name(name, names)]):
        return None
    cells = {
        name: ["" if value is None else str(value) for value in columns[name].tolist()]
        for name in (*likely, *_clock_of(names))
    }
    if not (key := joint_column(names, cells)):
        return None
    used = {
        name: values
        for name, values in columns.items()
        if values.dtype.kind not in "OSU"
    }
    used[key] = np.array(cells[key], dtype=object)
    return wide_columns(tuple(used), used, key)


def _clock_of(names: Sequence[str]) -> tuple[str, ...]:
    """Return the clock's columns: one by its name, or two; none if there is none."""
    split = split_clock(names)
    found = [name for name in names if is_time(name)]
    if split is not None and not any(n not in clock_columns(split) for n in found):
        return clock_columns(split)
    return (min(found, key=len),) if found else ()


def _stamps(clock: Sequence[str], columns: Mapping[str, NDArray[Any]]) -> Vector | None:
    if not clock:
        return None
    time, *fraction = (_numbers(columns[name]) for name in clock)
    for name, values in zip(clock[1:], fraction, strict=True):
        time = time + fraction_unit(name, name) * values
    return time


def _numbers(cells: NDArray[Any]) -> Matrix:
    """Return cells as numbers; NaN for what is none."""
    if cells.dtype != object:
        return cells.astype(np.float64)
    flat = cells.ravel().tolist()
    mark = decimal_mark(flat)
    day_first = date_order(",".join(flat)).day_first
    values = [number(cell, mark, day_first) for cell in flat]
    whole = [np.nan if value is None else value for value in values]
    return np.array(whole).reshape(cells.shape)


def _interpolated(
    before: NDArray[Any], after: NDArray[Any], weight: Matrix
) -> NDArray[Any]:
    """Return cells between two others; those that are no numbers as they are."""
    one, other = _numbers(before), _numbers(after)
    # A weight of zero takes nothing from a missing value.
    values = np.where(weight > 0.0, one + weight * (other - one), one)
    if before.dtype != object:
        return values
    comma = decimal_mark(before[:_HEAD].ravel().tolist()) == ","
    text = np.vectorize(repr, otypes=[object])(values)
    if comma:
        text = np.vectorize(lambda t: t.replace(".", ","), otypes=[object])(text)
    known = np.isfinite(values)
    return np.where(known, text, before)


def may_be_long(text: str) -> bool:
    """Return whether a text may be a long table, by its header and first rows."""
    table = _split(text)
    likely = [name for name in table.names if may_name(name, table.names)]
    if not likely or len(set(table.names)) < len(table.names):
        return False
    rows = [row for row, _ in zip(table.rows, range(_HEAD), strict=False)]
    columns = _columns_of(table.names, rows)
    return any(_names_rows(columns[name]) for name in likely)


def as_wide(text: str) -> str:
    """Return a long table as a text with a row for each instant; others as they are."""
    return _wide(text)[0] if may_be_long(text) else text


def order_of(text: str) -> LongOrder | None:
    """Return the order of a text that is a long table; None of others."""
    return _wide(text)[1] if may_be_long(text) else None


class _SplitText(NamedTuple):
    """Names and rows of a text, their separator, and the comments above."""

    names: tuple[str, ...]
    rows: Iterator[list[str]]
    mark: str
    comments: str


def _split(text: str) -> _SplitText:
    start = 0
    while text.startswith("#", start):
        start = text.find("\n", start) + 1 or len(text)
    head = text[start:].partition("\n")[0]
    mark = separator_of(head)
    lines = io.StringIO(text[start:], newline="")
    read = csv.reader(lines, delimiter=mark, skipinitialspace=True)
    rows = ([cell.strip() for cell in row if cell or mark != SPACE] for row in read)
    return _SplitText(tuple(next(rows, [])), rows, mark, text[:start])


def _columns_of(
    names: Sequence[str], rows: Iterable[Sequence[str]]
) -> dict[str, list[str]]:
    """Return the cells of each column, without rows of other lengths."""
    whole = [row for row in rows if len(row) == len(names)]
    return {name: [row[k] for row in whole] for k, name in enumerate(names)}


# A text is asked for its names, its notes and its values.
@lru_cache(maxsize=1)
def _wide(text: str) -> tuple[str, LongOrder | None]:
    table = _split(text)
    cells = _columns_of(table.names, table.rows)
    if not (key := joint_column(table.names, cells)):
        return text, None
    columns = {name: np.array(column, dtype=object) for name, column in cells.items()}
    found = wide_columns(table.names, columns, key)
    if found is None:
        return text, None
    wide, order = found
    out = io.StringIO()
    writer = csv.writer(out, delimiter=table.mark, lineterminator="\n")
    writer.writerow(wide)
    writer.writerows(zip(*wide.values(), strict=True))
    return table.comments + out.getvalue(), order
