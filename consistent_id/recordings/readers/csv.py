"""Columns of a text file: encoding, separators and decimal commas are found in it.

PyArrow reads the numbers if it is installed, several times as fast as the csv module.
Where it refuses them the csv module reads the file again, row by row: it knows the row
and the column of each fault.
"""

import csv
import io
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from importlib.util import find_spec
from math import nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.csv_header import (
    SI_WORDS,
    CsvHeader,
    header_note,
    header_of,
    headers_of,
    lacks_names,
    with_one_header,
)
from consistent_id.recordings.readers.long_tables import (
    may_be_long,
    order_of,
)
from consistent_id.recordings.readers.named_arrays import Arrays
from consistent_id.recordings.readers.parquet import numbers_of
from consistent_id.recordings.readers.table_text import (
    PIECE,
    pieces_of_lines,
    readable,
    table_text,
    text_head,
)
from consistent_id.recordings.readers.text_files import (
    SPACE,
    encoding_notes,
    encoding_of,
)
from consistent_id.recordings.readers.text_numbers import (
    DateOrder,
    columns_of_flags,
    date_order,
    decimal_mark,
    flag,
    number,
)
from consistent_id.recordings.readers.used_rows import (
    MISSING_ADVICE,
    OMIT_MISSING,
    EmptyTableError,
    FaultyRowsError,
    Missing,
    UsedRows,
    omit_advice,
)

_HEAD = 2**14  # characters that show whether there are dates
_SI = {*SI_WORDS, "", "-", "1"}
_OF_SI = ": values are read in s, rad, m, N m and N"
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,(?:\d{1,2}|\d{4,})(?:[eE][-+]?\d+)?")
_FLAG = re.compile(r"\b(?:true|false)\b", re.IGNORECASE)
_NOTHING = {"", "NA", "N/A", "NULL", "null", "None"}  # fields of missing values


class _Values(NamedTuple):
    """Columns of a table.

    Parameters
    ----------
    numbers : ndarray, shape (rows, columns)
    flags : sequence of int
        Places of the columns that are flags, 1 and 0.
    """

    numbers: Matrix
    flags: Sequence[int] = ()

    def arrays(self, names: Sequence[str], first: int = 0) -> Arrays:
        """Return the columns from a row on; flags are boolean if none is missing."""
        columns: dict[str, Array] = dict(
            zip(names, self.numbers[first:].T, strict=True)
        )
        for name in (names[place] for place in self.flags):
            if not np.isnan(columns[name]).any():
                columns[name] = columns[name].astype(np.bool_)
        return columns


def read_arrays(
    path: Path,
    names: Sequence[str],
    omit: Collection[int] = (),
    missing: Missing = "refuse",
) -> Arrays:
    """Return the named columns.

    The separator is the one of comma, semicolon and tab by which the header has all
    names, or any number of spaces if the header has none of these.  Lines before the
    header that begin with ``#`` are ignored; the last of them may be the header.

    Parameters
    ----------
    omit : collection of int
        Rows below the header, counted from 1, that may hold anything: NaN stands for
        what is no number.
    missing : {"refuse", "omit"}
        Whether NaN stands for empty fields of all rows.

    Raises
    ------
    RecordingError
        If the file is not such a text; with the row and the column of the first fault.
    """
    with readable(path):
        text, rewritten = table_text(path)
        header = replace(header_of(path, text, names), rewritten=rewritten)
        if date_order(text[:_HEAD]) != DateOrder():
            header = replace(header, day_first=date_order(text).day_first)
        rows = UsedRows(omit, missing=missing)
        values = _values(path, text[header.end :], header, names, rows)
    return values.arrays(names)


def read_batches(
    path: Path, names: Sequence[str], first: int, omit: Collection[int] = ()
) -> Iterator[Arrays]:
    """Yield the named columns from a row on, in pieces.

    Raises
    ------
    RecordingError
        As `read_arrays`.
    """
    header = None
    with readable(path):
        for text in pieces_of_lines(path):
            if header is None:
                header = header_of(path, text, names)
                if date_order(text[:_HEAD]) != DateOrder():
                    whole = date_order(table_text(path).text)
                    header = replace(header, day_first=whole.day_first)
                text = text[header.end :]
            lines = text.count("\n")
            rows = lines + (not text.endswith("\n"))
            if not text.strip():
                rows = 0
            elif rows > first or _has_other_lines(text):
                values = _values(path, text, header, names, UsedRows(omit))
                rows = len(values.numbers)
                if first < rows:
                    yield values.arrays(names, first)
            first = max(first - rows, 0)
            header = replace(header, line=header.line + lines, rows=header.rows + rows)


def notes(path: Path) -> tuple[str, ...]:
    """Return sentences on the encoding if it is not UTF-8, and on a missing header."""
    head = text_head(path)
    said = [*encoding_notes(path), *header_note(head, path.name)]
    if date_order(head[:_HEAD]) != DateOrder():
        said += filter(None, [date_order(table_text(path).text).said])
    if may_be_long(one := with_one_header(head)):
        whole = one if len(head) < PIECE else path.read_text(encoding_of(path))
        if (order := order_of(with_one_header(whole))) is not None:
            said.append(order.sentence(path.name))
    if lacks_names(names := array_names(path)):
        said.append(
            f"{path.name} has no header: its {len(names)} columns are called "
            f"{names[0]} to {names[-1]}"
        )
    return tuple(said)


def _has_other_lines(text: str) -> bool:
    """Return whether there may be lines that are not rows, or rows of several lines."""
    return text[:1] in "\r\n" or any(t in text for t in ("\n\n", "\n\r", '"'))


def array_names(path: Path) -> tuple[str, ...]:
    """Return the header: the first line, or the last comment above numbers.

    Its separator is the one that gives the most fields.  Without a header, columns are
    numbered from 1.
    """
    try:
        with readable(path):
            first, above = headers_of(next(pieces_of_lines(path), ""))
    except OSError as cause:
        raise RecordingError(f"{path}: not readable as CSV: {cause}") from None
    names, comment = (
        max((h.names for h in headers), key=len, default=())
        for headers in (first, above)
    )
    return comment if len(comment) == len(names) and lacks_names(names) else names


def _values(
    path: Path,
    body: str,
    header: CsvHeader,
    names: Sequence[str],
    used: UsedRows,
) -> _Values:
    """Return the named columns of the rows below a header."""
    lines = body.rstrip().count("\n") + 1
    if header.repeated and body.count(header.repeated) < lines:
        raise RecordingError(
            f"{path}: not all rows are of the joints {header.repeated}, which the "
            "first row names: write the messages of one topic"
        )
    at = {name: k for k, name in reversed(list(enumerate(header.names)))}
    places = [at[name] for name in names]
    if header.separator == SPACE:
        rows = body.replace("\r\n", "\n").replace("\r", "\n").split("\n")
        body = "\n".join(" ".join(line.split()) for line in rows)
    values = _fast(body, header, places, used.missing)
    if values is None:
        return _exact(path, body, header, places, used)
    return _Values(values)


def _fast(
    body: str, header: CsvHeader, places: Sequence[int], missing: Missing = "refuse"
) -> Matrix | None:
    """Return the columns as PyArrow reads them; None if it refuses them or is missing.

    Decimal commas are tried where commas do not separate.  Lines of a single column, of
    which empty ones are no rows, are left to the exact way.
    """
    width, separator = len(header.names), header.separator
    if width < 2 or find_spec("pyarrow") is None:
        return None
    import pyarrow as pa
    from pyarrow import csv as arrow

    text = pa.py_buffer(body.encode())
    wanted = [str(place) for place in places]
    for mark in ".," if separator != "," else ".":
        try:
            table = arrow.read_csv(
                text,
                arrow.ReadOptions(
                    use_threads=False, column_names=[str(k) for k in range(width)]
                ),
                arrow.ParseOptions(delimiter=separator),
                arrow.ConvertOptions(
                    include_columns=wanted,
                    column_types=dict.fromkeys(wanted, pa.float64()),
                    null_values=sorted(_NOTHING) if missing == "omit" else [],
                    decimal_point=mark,
                ),
            )
        except pa.ArrowInvalid:
            continue
        values = np.empty((len(table), len(places)), order="F")
        for k, column in enumerate(wanted):
            values[:, k] = numbers_of(table[column], column)
        return values
    return None


def _exact(
    path: Path,
    body: str,
    header: CsvHeader,
    places: Sequence[int],
    used: UsedRows,
) -> _Values:
    """Return the columns as the csv module reads them, NaN in rows to omit."""
    mark = _mark_of(body, header, places)
    lenient, day_first = used.missing == "omit", header.day_first
    flags = _flags(body, header, places, used)
    reader = _reader(body, header)
    rows: list[list[float | None]] = []
    first, broken, lacking = "", list[int](), True
    for fields in filter(None, reader):
        place, row = header.rows + len(rows) + 1, list[float | None]()
        if place in used.omit:
            rows.append([nan] * len(places))
            continue
        fault, cells = _miscounted(fields, header), list[str]()
        if not fault:
            cells = [fields[k] for k in places]
            mark = mark or decimal_mark(cells)
            row = [
                nan
                if lenient and cell in _NOTHING
                else (flag(cell) if k in flags else number(cell, mark, day_first))
                for k, cell in enumerate(cells)
            ]
            if None in row:
                column = header.names[places[row.index(None)]]
                fault = f", column {column!r}" + _fault(cells, row, mark, not rows)
        if fault:
            line = f"line {header.line + reader.line_num}"
            if header.rewritten:
                line = "of the table with a row for each instant, not of the file"
            first = first or f"{path}, row {place} ({line}){fault}"
            lacking = lacking and "" in cells
            broken.append(place)
        rows.append(row)
    if broken:
        raise _faulty(first, broken, len(rows), lacking)
    if not rows:
        raise EmptyTableError(f"{path}: no row below the header")
    return _Values(np.array(rows, dtype=np.float64), flags)


def _mark_of(body: str, header: CsvHeader, places: Sequence[int]) -> str | None:
    """Return the decimal mark that separators leave open; None if any may be it.

    Beside commas, quoted numbers may have decimal commas.  Three digits behind one may
    be thousands.
    """
    if header.separator != ",":
        return None
    first: Sequence[str] = next(_reader(body, header), [])
    quoted = any(map(_DECIMAL_COMMA.fullmatch, first)) and not _miscounted(
        first, header
    )
    return "," if quoted and not any("." in first[k] for k in places) else "."


def _reader(body: str, header: CsvHeader) -> Any:
    """Return a reader of the csv module, which yields the fields of each line."""
    lines = io.StringIO(body, newline="")
    return csv.reader(lines, delimiter=header.separator, skipinitialspace=True)


def _flags(
    body: str, header: CsvHeader, places: Sequence[int], used: UsedRows
) -> list[int]:
    """Return the places of those of some columns that are flags."""
    if _FLAG.search(body) is None:
        return []
    return columns_of_flags(
        [fields[place] for place in places]
        for row, fields in enumerate(
            filter(None, _reader(body, header)), header.rows + 1
        )
        if row not in used.omit and len(fields) == len(header.names)
    )


def _faulty(
    first: str, broken: Sequence[int], rows: int, lacking: bool
) -> FaultyRowsError:
    """Return the error of the first faulty row, with the way to leave all out."""
    advice = omit_advice(broken, rows)
    options = OMIT_MISSING * lacking
    if advice and not lacking and (1 not in broken or first.endswith(_OF_SI)):
        options = f"--omit {','.join(map(str, broken))}"
    said = f"{advice}{MISSING_ADVICE * lacking}"
    return FaultyRowsError(first, said, options, every=len(broken) == rows)


def _miscounted(fields: Sequence[str], header: CsvHeader) -> str:
    """Return the fault of a row with too many or too few fields, or nothing."""
    if len(fields) == len(header.names):
        return ""
    fault = f": {len(fields)} fields, the header has {len(header.names)}"
    more = len(fields) > len(header.names)
    if header.separator == "," and more and not any("." in cell for cell in fields):
        fault += (
            ". If commas mark decimals, another separator is needed: export with "
            "semicolons or tabs"
        )
    return fault


def _fault(
    cells: Sequence[str], row: Sequence[float | None], mark: str | None, first: bool
) -> str:
    """Return the fault of the first cell of a row that is not a number."""
    cell = cells[row.index(None)]
    if not cell:
        return " is empty. Fill it in"
    fault = f": {cell!r} is not a number"
    if first and all(cells) and set(row) == {None}:
        units = ", ".join(map(repr, dict.fromkeys(cells)))
        usual = {cell.strip("[]() ").lower().replace(" ", "") for cell in cells} <= _SI
        rest = _OF_SI if usual else ", and others only if --units states them"
        return f"{fault}. The row seems to contain units ({units}){rest}"
    if not any(map(str.isdigit, cell)):
        fault += (
            ". If it stands for a missing value, leave its cells empty: "
            f"{OMIT_MISSING} leaves such rows out"
        )
    return (
        f"{fault}. Only one header row is allowed, and {mark or '.'!r} marks decimals"
    )
