"""Headers of several lines, and lines above a table, as a header of one line.

Programmes of measurement write settings above the names of the columns, and a row of
units below them; spreadsheets write the quantity above the names of the joints.  The
header is what stands directly above the first rows of numbers and has as many fields.
"""

import csv
import io
import re
from collections.abc import Sequence
from typing import NamedTuple

from consistent_id.recordings.readers.text_files import SPACE, separator_of
from consistent_id.recordings.readers.text_numbers import is_number
from consistent_id.recordings.readers.units import is_any_unit

_HEAD = 2**18  # characters in which a table begins
_MOST = 200  # lines above a table
_FEWEST = 3  # fields of a table whose header may have several lines
SI_WORDS = {
    "s",
    "sec",
    "rad",
    "m",
    "rad/s",
    "m/s",
    "rad/s^2",
    "m/s^2",
    "nm",
    "n*m",
    "n",
}
"""Units that change nothing, in lower case and without spaces."""

_END = "***End_of_Header***"  # of LabVIEW; the last one stands above the names
_MARK = re.compile(r"\s*(?://+|%+|!)\s+")  # of a comment, before names
_NOTHING = {"", "-", "1", "NA", "N/A", "NULL", "null", "None"}


class _HeaderLines(NamedTuple):
    """Names of the columns, and the lines that state them, counted from 0.

    Parameters
    ----------
    names : tuple of str
        With units that are not SI in brackets.
    first, rows : int
        The first line of the header, and the first row.
    """

    names: tuple[str, ...]
    first: int
    rows: int
    mark: str


def with_one_header(text: str) -> str:
    """Return a text with one line of names directly above the rows.

    Lines above become empty comments, so that lines keep their numbers.  A text that
    begins with its only header, or in which none is found, is returned as it is.
    """
    found = _found(text)
    if found is None:
        return text
    line = io.StringIO()
    csv.writer(line, delimiter=found.mark, lineterminator="\n").writerow(found.names)
    rest = "".join(text.splitlines(keepends=True)[found.rows :])
    return "#\n" * (found.rows - 1) + line.getvalue() + rest


def header_note(text: str, name: str) -> list[str]:
    r"""Return a sentence on the lines that name the columns of a file, if it has such.

    Examples
    --------
    >>> header_note("time,q,tau\ns,deg,Nm\n0,1,2\n1,2,3\n", "log.csv")
    ['log.csv: lines 1 to 2 name the columns: time, q [deg], tau']
    """
    found = _found(text)
    if found is None:
        return []
    lines = f"line {found.rows} names"
    if found.rows > found.first + 1:
        lines = f"lines {found.first + 1} to {found.rows} name"
    shown = ", ".join(found.names[:4]) + ", ..." * (len(found.names) > 4)
    return [f"{name}: {lines} the columns: {shown}"]


def _found(text: str) -> _HeaderLines | None:
    lines = text[:_HEAD].splitlines()[: _MOST + 2]
    start = max((k + 1 for k, line in enumerate(lines) if _END in line), default=0)
    rows = next((k for k in range(start, len(lines) - 1) if _begins(lines, k)), 0)
    if not rows or any(line.count('"') % 2 for line in lines[: rows + 1]):
        return None
    mark = separator_of(lines[rows])
    width = len(_fields(lines[rows], mark))
    first, header = rows, list[list[str]]()
    while first > start and not lines[first - 1].startswith("#"):
        fields = _names_in(lines[first - 1], mark, width)
        if len(fields) != width:
            break
        first, header = first - 1, [fields, *header]
    above = [line for line in lines[:first] if not line.startswith("#")]
    marked = mark == SPACE and _MARK.match(lines[rows - 1]) is not None
    if not header or (len(header) == 1 and not above and not marked):
        return None
    names = _merged(header)
    return None if names is None else _HeaderLines(names, first, rows, mark)


def _names_in(line: str, mark: str, width: int) -> list[str]:
    """Return the fields of a line above the rows, without a mark of a comment.

    LabVIEW names a column of comments, which its rows need not have.
    """
    fields = _fields(line, mark)
    if len(fields) != width:
        fields = _fields(_MARK.sub("", line), mark)
    more = len(fields) == width + 1 and fields[-1] == "Comment"
    return fields[:-1] if more else fields


def _begins(lines: Sequence[str], k: int) -> bool:
    """Return whether two lines are rows of numbers with equally many fields."""
    one, other = (_fields(line, separator_of(lines[k])) for line in lines[k : k + 2])
    return len(one) == len(other) >= _FEWEST and all(map(_is_row, (one, other)))


def _is_row(fields: Sequence[str]) -> bool:
    """Return whether at least half of the fields that are not empty are numbers."""
    said = [field for field in fields if field not in _NOTHING]
    return bool(said) and 2 * sum(map(is_number, said)) >= len(said)


def _fields(line: str, mark: str) -> list[str]:
    if mark == SPACE:
        return line.split()
    reader = csv.reader([line], delimiter=mark, skipinitialspace=True)
    return [field.strip() for field in next(reader, [])]


def _merged(lines: Sequence[Sequence[str]]) -> tuple[str, ...] | None:
    """Return one name for each column; None if the lines do not distinguish them."""
    units: Sequence[str] = ()
    if len(lines) > 1 and _are_units(lines[-1]):
        *lines, units = lines
    if any(map(_has_value, (cell for line in lines for cell in line))):
        return None
    names = list(next((line for line in lines if _distinct(line)), lines[-1]))
    if names == list(lines[0]) and len(lines) > 1 and not units:
        return None  # what follows is a faulty row
    for line in reversed(lines[:-1]):
        if _distinct(names):
            break
        names = [
            f"{above} {name}".strip()
            for above, name in zip(_filled(line, names), names, strict=True)
        ]
    if not _distinct(names):
        return None
    return tuple(map(_with_unit, names, units)) if units else tuple(names)


def _has_value(cell: str) -> bool:
    return is_number(cell) or (cell in _NOTHING and cell not in ("", "-"))


def _distinct(names: Sequence[str]) -> bool:
    return all(names) and len(set(names)) == len(names)


def _filled(line: Sequence[str], below: Sequence[str]) -> list[str]:
    """Return a line with each word repeated over the columns that it stands above."""
    filled = list(line)
    for k in range(1, len(filled)):
        if not filled[k] and below[k]:
            filled[k] = filled[k - 1]
    return filled


def _bare(unit: str) -> str:
    return unit.strip("[]() ")


def _are_units(fields: Sequence[str]) -> bool:
    said = [_bare(field) for field in fields if _bare(field) not in _NOTHING]
    return bool(said) and all(map(is_any_unit, said))


def _with_unit(name: str, unit: str) -> str:
    said = _bare(unit)
    plain = said in _NOTHING or said.lower().replace(" ", "") in SI_WORDS
    return name if plain else f"{name} [{said}]"
