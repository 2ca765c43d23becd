"""The header of a text file: its names, their separator, and where the rows begin.

Columns of a file without a header are called ``column1``, ``column2`` and so on.

Programmes of measurement write settings above the names of the columns, and a row of
units below them; spreadsheets write the quantity above the names of the joints.  Such
headers become one line: what stands directly above the first rows of numbers and has as
many fields.
"""

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.columns import require
from consistent_id.recordings.readers.printed_messages import named_columns
from consistent_id.recordings.readers.text_files import SEPARATORS, SPACE, separator_of
from consistent_id.recordings.readers.text_numbers import is_number
from consistent_id.recordings.readers.units import is_any_unit

_WITHOUT_NAMES = "column"
_NUMBERS_OF_R = re.compile(r'"1"[^\n]*\n"2"')  # rows that begin with their numbers
_LOOKED_AT = 100  # rows that end with a separator, if their programme writes it
_NUMBERED = 3  # columns from which on 1, 2, 3 or 0, 1, 2 is a header, not a row
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


@dataclass(frozen=True, slots=True)
class CsvHeader:
    """The names, their separator, and the begin of the rows.

    Parameters
    ----------
    line : int
        Number of the header's last line, from 1.
    end : int
        Characters up to the end of that line.
    rows : int
        Number of rows between the header and the text that is read next.
    worded : CsvHeader, optional
        The same line as a header, if its numbers are taken as a row.
    repeated : str
        What each row has to contain: the names of the joints, of printed messages.
    day_first : bool
        Whether the day is first in dates with slashes.
    rewritten : bool
        Whether the text was written anew, so that its lines are not the file's.
    """

    names: tuple[str, ...]
    separator: str
    line: int
    end: int
    rows: int = 0
    worded: "CsvHeader | None" = None
    repeated: str = ""
    day_first: bool = False
    rewritten: bool = False


class TextHeaders(NamedTuple):
    """What may be the header of a text, by each separator.

    Parameters
    ----------
    first : list of CsvHeader
        The first line that is no comment.
    above : list of CsvHeader
        The last comment above it; empty without one.
    """

    first: list[CsvHeader]
    above: list[CsvHeader]


def lacks_names(names: Sequence[str]) -> bool:
    """Return whether columns have the names that replace a missing header.

    Examples
    --------
    >>> lacks_names(["column1", "column2"]), lacks_names(["time", "column2"])
    (True, False)
    """
    numbered = (f"{_WITHOUT_NAMES}{k}" for k in range(1, len(names) + 1))
    return len(names) > 1 and tuple(names) == tuple(numbered)


def header_of(path: Path, text: str, names: Sequence[str]) -> CsvHeader:
    """Return the header by the one separator with which it has all names."""
    first, above = headers_of(text)
    worded = [h.worded for h in first if h.worded is not None]
    # numpy.savetxt separates the words of a comment otherwise than the numbers below.
    titled = [
        replace(h, names=title.names)
        for h in first
        for title in above
        if lacks_names(h.names) and len(title.names) == len(h.names)
    ]
    if set(names) <= {name for h in above for name in h.names}:
        first = [h for h in first if not lacks_names(h.names)] or first
    fitting = [h for h in first if set(names) <= set(h.names)]
    for others in (titled, above, worded):
        fitting = fitting or [h for h in others if set(names) <= set(h.names)]
    if len(fitting) > 1:
        marks = " and ".join(repr(header.separator) for header in fitting)
        raise RecordingError(
            f"{path}: the header has all columns with each of {marks} as separator; "
            f"rename columns that contain a separator"
        )
    header = fitting[0] if fitting else max(first, key=lambda h: len(h.names))
    require(str(path), names, header.names)
    return header


def headers_of(text: str) -> TextHeaders:
    """Return what may be the header of a text."""
    lines, comments, comment = io.StringIO(text, newline=""), 0, ""
    start = 0
    while (line := lines.readline()).startswith("#"):
        start, comments, comment = lines.tell(), comments + 1, line.lstrip("# ")
    first = [_split(lines, start, mark) for mark in _marks(line)]
    above = [_split(io.StringIO(comment), 0, mark) for mark in _marks(comment)]
    return TextHeaders(
        [
            _as_wide_as_rows(
                _of_messages(
                    _named(replace(h, line=comments + h.line), start), text, start
                ),
                text,
            )
            for h in first
        ],
        [replace(h, line=comments, end=start) for h in above if comment],
    )


def _named(header: CsvHeader, start: int) -> CsvHeader:
    """Return a first line of numbers as a row; as a header if it counts the columns."""
    given = header.names
    if len(given) < 2 or not all(map(is_number, given)):
        return header
    counts = ([str(first + k) for k in range(len(given))] for first in (0, 1))
    names = tuple(f"{_WITHOUT_NAMES}{k}" for k in range(1, len(given) + 1))
    if len(given) >= _NUMBERED and list(given) in counts:
        return replace(header, names=names, worded=header)
    return replace(header, names=names, line=header.line - 1, end=start, worded=header)


def _of_messages(header: CsvHeader, text: str, start: int) -> CsvHeader:
    """Return a header with the joints' names, if the rows hold them."""
    lines = io.StringIO(text, newline="")
    below = _split(lines, header.end, header.separator).names
    found = named_columns(header.names, below)
    if found is None:
        return header
    line, end = (header.line - 1, start) if found.is_row else (header.line, header.end)
    repeated = header.separator.join(found.repeated)
    return replace(header, names=found.names, line=line, end=end, repeated=repeated)


def _as_wide_as_rows(header: CsvHeader, text: str) -> CsvHeader:
    """Return a header with the names of its row, one of which may end with a separator.

    Programmes that write a separator after each value write none after the last name,
    and the reverse.  R writes the number of each row, quoted, and no name for it.
    """
    names = header.names
    lines = io.StringIO(text, newline="")
    below = _split(lines, header.end, header.separator).names
    if len(below) == len(names) + 1 and _NUMBERS_OF_R.match(text, header.end):
        return replace(header, names=("", *names))
    if below[:-1] and not below[-1] and len(below) == len(names) + 1:
        lines.seek(header.end)
        whole = [row for row in islice(lines, _LOOKED_AT) if row.endswith("\n")]
        rows = [row.rstrip("\r\n ") for row in whole if row.strip()]
        # One row may lack its last value, behind numbers of rows without a name.
        if all(row.endswith(header.separator) for row in rows):
            return replace(header, names=(*names, ""))
    if names[:-1] and not names[-1] and len(names) == len(below) + 1:
        return replace(header, names=names[:-1])
    return header


def _marks(line: str) -> tuple[str, ...]:
    """Return the separators that a header may have."""
    if any(mark in line for mark in SEPARATORS) or SPACE not in line.strip():
        return SEPARATORS
    return (SPACE,)


def _split(lines: io.StringIO, start: int, separator: str) -> CsvHeader:
    lines.seek(start)
    line = lines.readline()
    if len(line) > csv.field_size_limit() and separator not in line:
        # Of a header as wide as that, the csv module refuses the whole line as a field.
        return CsvHeader((line.strip(),), separator, 1, lines.tell())
    lines.seek(start)
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    names = tuple(name.strip() for name in next(reader, []))
    if separator == SPACE:
        names = tuple(filter(None, names))
    return CsvHeader(names, separator, reader.line_num, lines.tell())


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
