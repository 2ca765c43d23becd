"""The text of a file as one table: printed messages and long tables are rewritten."""

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from consistent_id.errors import RecordingError
from consistent_id.recordings.log_formats import MESSAGES
from consistent_id.recordings.readers.csv_header import with_one_header
from consistent_id.recordings.readers.long_tables import as_wide, may_be_long
from consistent_id.recordings.readers.printed_messages import as_table, is_printed
from consistent_id.recordings.readers.text_files import encoding_of
from consistent_id.recordings.readers.yaml_messages import MessageError

PIECE = 2**22
"""Characters of text that are read at a time."""


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Refuse what is no text of rows."""
    try:
        yield
    except UnicodeDecodeError as cause:
        raise RecordingError(
            f"{path}: not readable as CSV: {cause}. Save the file as UTF-8"
        ) from None
    except csv.Error as cause:
        raise RecordingError(f"{path}: not readable as CSV: {cause}") from None
    except MessageError as cause:
        raise RecordingError(f"{path}: not readable as messages: {cause}") from None


class TableText(NamedTuple):
    """A text as a table.

    Parameters
    ----------
    text : str
    rewritten : bool
        Whether it was written anew, so that its rows are not the file's lines.
    """

    text: str
    rewritten: bool


def table_text(path: Path) -> TableText:
    """Return the whole text of a file as a table."""
    text = path.read_bytes().decode(encoding_of(path))
    if printed := _is_printed(path, text):
        text = as_table(text)
    one = with_one_header(text)
    wide = as_wide(one)
    return TableText(wide, printed or wide is not one)


def _is_printed(path: Path, text: str) -> bool:
    """Return whether a text has messages; refuse other files that end as these do."""
    printed = is_printed(text)
    if not printed and path.suffix.lower() in MESSAGES:
        raise RecordingError(
            f"{path}: no messages as ros2 topic echo (YAML) or KUKA's interface (XML) "
            "prints them, which begin with a header or <Rob; other logs are read as "
            ".csv, .json and so on"
        )
    return printed


def text_head(path: Path) -> str:
    """Return the first piece of a text as it is written."""
    with path.open(encoding=encoding_of(path), newline="") as file:
        return file.read(PIECE)


def pieces_of_lines(path: Path) -> Iterator[str]:
    """Yield a file's text in pieces of whole lines; others as `table_text`."""
    rest, first = "", True
    with path.open(encoding=encoding_of(path), newline="") as file:
        while piece := file.read(PIECE):
            if first:
                piece = with_one_header(piece)
            if first and (_is_printed(path, piece) or may_be_long(piece)):
                yield table_text(path).text
                return
            first = False
            whole, newline, end = (rest + piece).rpartition("\n")
            rest = end
            if newline:
                yield whole + newline
    if rest:
        yield rest
