"""The header of a text file: its names, their separator, and where the rows begin.

Columns of a file without a header are called ``column1``, ``column2`` and so on.
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
from consistent_id.recordings.readers.text_files import SEPARATORS, SPACE
from consistent_id.recordings.readers.text_numbers import is_number

_WITHOUT_NAMES = "column"
_NUMBERS_OF_R = re.compile(r'"1"[^\n]*\n"2"')  # rows that begin with their numbers
_LOOKED_AT = 100  # rows that end with a separator, if their programme writes it
_NUMBERED = 3  # columns from which on 1, 2, 3 or 0, 1, 2 is a header, not a row


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
