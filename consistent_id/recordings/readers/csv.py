"""Columns of a text file: separators and decimal commas are found in the file.

Fields are read by NumPy where that cannot differ from the exact way, which is the only
one that knows rows and columns, and which therefore words every refusal.
"""

import csv
import io
from codecs import BOM_UTF8
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.columns import require
from consistent_id.recordings.readers.named_arrays import Arrays

_SEPARATORS = (",", ";", "\t")
_PIECE = 2**22  # bytes of text that are read at a time
_DELICATE = '"\0\x1c\x1d\x1e\x1f'  # quotes, and what is space to one way only


@dataclass(frozen=True, slots=True)
class _CsvHeader:
    """The names, how they are separated, and where the rows begin.

    Parameters
    ----------
    row : int
        Number of the header's last line, from 1.
    end : int
        Characters up to the end of that line.
    """

    names: tuple[str, ...]
    separator: str
    row: int
    end: int


def read_arrays(path: Path, names: Sequence[str]) -> Arrays:
    """Return the named columns.

    The separator is the one of comma, semicolon and tab by which the header has all
    names.  Lines before the header that begin with ``#`` are passed over; the last of
    them may be the header.

    Raises
    ------
    RecordingError
        If the file is not such a text; with the row and the column of the first fault.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
        header = _header(path, text, names)
        places = [header.names.index(name) for name in names]
        values = _fast(text[header.end :], header, places)
        if values is None:
            values = _exact(path, text, header, places)
    except UnicodeDecodeError as cause:
        raise RecordingError(
            f"{path}: not readable as CSV: {cause}. Save the file as UTF-8"
        ) from None
    except csv.Error as cause:
        raise RecordingError(f"{path}: not readable as CSV: {cause}") from None
    return dict(zip(names, values.T, strict=True))


def read_batches(path: Path, names: Sequence[str], first: int) -> Iterator[Arrays]:
    """Yield the named columns from a row on, some rows at a time.

    Raises
    ------
    RecordingError
        As `read_arrays`.
    """
    header, places = None, []
    try:
        for text in _pieces_of_lines(path):
            if header is None:
                header = _header(path, text, names)
                places = [header.names.index(name) for name in names]
                text, header = text[header.end :], replace(header, end=0)
            lines = text.count("\n")
            rows = lines + (not text.endswith("\n"))
            if 0 < rows <= first and not _has_other_lines(text):
                first -= rows
            elif text.strip():
                values = _fast(text, header, places)
                if values is None:
                    values = _exact(path, text, header, places)
                if first < len(values):
                    yield dict(zip(names, values[first:].T, strict=True))
                first = max(first - len(values), 0)
            header = replace(header, row=header.row + lines)
    except UnicodeDecodeError as cause:
        raise RecordingError(
            f"{path}: not readable as CSV: {cause}. Save the file as UTF-8"
        ) from None
    except csv.Error as cause:
        raise RecordingError(f"{path}: not readable as CSV: {cause}") from None


def _pieces_of_lines(path: Path) -> Iterator[str]:
    """Yield the text of a file, some whole lines at a time."""
    rest = b""
    with path.open("rb") as file:
        file.seek(len(BOM_UTF8) if file.read(len(BOM_UTF8)) == BOM_UTF8 else 0)
        while piece := file.read(_PIECE):
            whole, newline, end = (rest + piece).rpartition(b"\n")
            rest = end
            if newline:
                yield (whole + newline).decode()
    if rest:
        yield rest.decode()


def _has_other_lines(text: str) -> bool:
    """Return whether there may be lines that are not rows, or rows of several lines."""
    return text[:1] in "\r\n" or any(t in text for t in ("\n\n", "\n\r", '"'))


def array_names(path: Path) -> tuple[str, ...]:
    """Return the header: the first line, or above numbers the last comment.

    Its fields are separated by what makes the most of them.
    """
    comment = first = ""
    try:
        with path.open(encoding="utf-8-sig", newline="") as lines:
            for first in lines:
                if not first.startswith("#"):
                    break
                comment = first.lstrip("# ")
        names, above = _most_fields(first), _most_fields(comment)
    except (OSError, UnicodeDecodeError, csv.Error) as cause:
        raise RecordingError(f"{path}: not readable as CSV: {cause}") from None
    return above if comment and all(map(_is_number, names)) else names


def _most_fields(line: str) -> tuple[str, ...]:
    split = (_split(io.StringIO(line, newline=""), 0, mark) for mark in _SEPARATORS)
    return max((header.names for header in split), key=len)


def _header(path: Path, text: str, names: Sequence[str]) -> _CsvHeader:
    """Return the header by the one separator that makes it hold all names."""
    lines, skipped, comment = io.StringIO(text, newline=""), 0, None
    start = 0
    for line in lines:
        if not line.startswith("#"):
            break
        start, skipped, comment = lines.tell(), skipped + 1, line.lstrip("# ")
    found = [_split(lines, start, separator) for separator in _SEPARATORS]
    fitting = [header for header in found if set(names) <= set(header.names)]
    if not fitting and comment is not None:
        above = [_split(io.StringIO(comment), 0, mark) for mark in _SEPARATORS]
        fitting = [
            _CsvHeader(header.names, header.separator, 0, start)
            for header in above
            if set(names) <= set(header.names)
        ]
    if len(fitting) > 1:
        marks = " and ".join(repr(header.separator) for header in fitting)
        raise RecordingError(
            f"{path}: the header has all columns whether {marks} separates them; "
            "rename columns that contain a separator"
        )
    header = fitting[0] if fitting else max(found, key=lambda h: len(h.names))
    if not fitting and header.names and all(_is_number(n) for n in header.names):
        raise RecordingError(
            f"{path}: the first row holds numbers ({', '.join(header.names[:3])}), "
            "expected a header that names the columns. Add one: joints are matched by "
            "name"
        )
    require(str(path), names, header.names)
    return replace(header, row=skipped + header.row)


def _split(lines: io.StringIO, start: int, separator: str) -> _CsvHeader:
    lines.seek(start)
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    names = tuple(name.strip() for name in next(reader, []))
    return _CsvHeader(names, separator, reader.line_num, lines.tell())


def _fast(body: str, header: _CsvHeader, places: Sequence[int]) -> Matrix | None:
    """Return the columns, or None where only the exact way knows."""
    separator, width = header.separator, len(header.names)
    if width < 2 or not body.isascii() or any(c in body for c in _DELICATE):
        return None
    if separator != "," and "," in body:
        if "." in body:
            return None  # one of them may stand in text, or both mark decimals
        body = body.replace(",", ".")
    lines = body.replace("\r\n", "\n").replace("\r", "\n").rstrip("\n") + "\n"
    lengths, separators = _line_by_line(lines, separator)
    full = lengths > 0
    if (
        not full.any()
        or lengths.max() > csv.field_size_limit()
        or (separators[full] != width - 1).any()
    ):
        return None
    try:
        return np.loadtxt(
            io.StringIO(lines),
            delimiter=separator,
            usecols=places,
            comments=None,
            ndmin=2,
        )
    except ValueError:
        return None


def _line_by_line(lines: str, separator: str) -> tuple[IntArray, IntArray]:
    """Return the length of each line, and the number of separators in it."""
    characters = np.frombuffer(lines.encode("ascii"), np.uint8)
    ends = np.flatnonzero(characters == ord("\n"))
    marks = np.flatnonzero(characters == ord(separator))
    return np.diff(ends, prepend=-1) - 1, np.diff(
        np.searchsorted(marks, ends), prepend=0
    )


def _exact(path: Path, text: str, header: _CsvHeader, places: Sequence[int]) -> Matrix:
    lines = io.StringIO(text[header.end :], newline="")
    reader = csv.reader(lines, delimiter=header.separator, skipinitialspace=True)
    mark = "." if header.separator == "," else None
    rows: list[list[float | None]] = []
    for fields in filter(None, reader):
        place = f"{path}, row {header.row + reader.line_num}"
        if len(fields) != len(header.names):
            raise _miscounted(place, fields, header)
        cells = [fields[k] for k in places]
        mark = mark or _decimal_mark(cells)
        row = [_number(cell, mark) for cell in cells]
        if None in row:
            column = header.names[places[row.index(None)]]
            raise _fault(f"{place}, column {column!r}", cells, row, mark, not rows)
        rows.append(row)
    if not rows:
        raise RecordingError(f"{path}: no row below the header")
    return np.array(rows, dtype=np.float64)


def _miscounted(
    place: str, fields: Sequence[str], header: _CsvHeader
) -> RecordingError:
    fault = f"{place}: {len(fields)} fields, the header has {len(header.names)}"
    more = len(fields) > len(header.names)
    if header.separator == "," and more and not any("." in cell for cell in fields):
        fault += (
            ". If commas mark decimals, something else has to separate: export with "
            "semicolons or tabs"
        )
    return RecordingError(fault)


def _is_number(cell: str) -> bool:
    return _number(cell, ".") is not None or _number(cell, ",") is not None


def _decimal_mark(cells: Iterable[str]) -> str | None:
    """Return the mark of the first number that has one."""
    for cell in cells:
        if _number(cell, None) is None and _number(cell, ",") is not None:
            return ","
        if "." in cell:
            return "."
    return None


def _number(cell: str, mark: str | None) -> float | None:
    """Return the number in a cell, None if it is none with this decimal mark."""
    if "_" in cell or not cell.isascii():  # Python's float() would take them
        return None
    if mark == ",":
        if "." in cell:
            return None
        cell = cell.replace(",", ".")
    try:
        return float(cell)
    except ValueError:
        return None


def _fault(
    place: str,
    cells: Sequence[str],
    row: Sequence[float | None],
    mark: str | None,
    first: bool,
) -> RecordingError:
    fault = f"{place}: {cells[row.index(None)]!r} is not a number"
    if not cells[row.index(None)]:
        return RecordingError(f"{place} is empty. Fill it in or delete the row")
    if first and all(cells) and set(row) == {None}:
        units = ", ".join(map(repr, cells))
        return RecordingError(
            f"{fault}. The row seems to name units ({units}): delete it; values are "
            "read in s, rad, m, N m and N"
        )
    return RecordingError(
        f"{fault}. Only one header row is allowed, and {mark or '.'!r} marks decimals"
    )
