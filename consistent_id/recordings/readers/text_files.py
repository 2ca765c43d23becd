"""The encoding of a text file, and the separator of a table in it."""

import codecs
import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from pathlib import Path

from consistent_id.recordings.column_words import JOINED

_UTF_16, _WINDOWS = "utf-16", "cp1252"
_EAST_ASIAN = {"cp932": "Shift-JIS", "gb18030": "GB 18030", "euc_kr": "EUC-KR"}
_CONTROLS = re.compile(r"[\x00-\x08\x0e-\x1f\x7f]")
_HEAD = 2**22  # bytes that show the encoding

_DECIMAL_COMMA = re.compile(r"\s*(?:[-+]?\d*(?:,\d+)?(?:[eE][-+]?\d+)?)?\s*")
SEPARATORS = (",", ";", "\t")
SPACE = " "
"""It separates where no other mark does: names may contain spaces."""


def separator_of(line: str) -> str:
    """Return the separator that stands in a line most often; else a space.

    Commas are decimal if all fields between other marks are numbers with them.

    Examples
    --------
    >>> separator_of("0,5;1,5"), separator_of("q (rad, deg);tau"), separator_of("0,1;2")
    (';', ',', ';')
    """
    for mark in SEPARATORS[1:]:
        if mark in line and all(map(_DECIMAL_COMMA.fullmatch, line.split(mark))):
            return mark
    mark = max(SEPARATORS, key=line.count)
    return mark if mark in line else SPACE


def encoding_of(path: Path) -> str:
    """Return the encoding of a text file.

    UTF-16 begins with a mark.  Other text is Japanese, Chinese or Korean if it then has
    known words, else Windows-1252, of which Latin-1 is a part: only names and comments
    can differ, as numbers are ASCII.
    """
    with path.open("rb") as file:
        first = file.read(_HEAD)
    if first.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        return _UTF_16
    if _words_in(first, "utf-8") is None:
        found = {name: _words_in(first, name) or 0 for name in _EAST_ASIAN}
        likely = max(found, key=found.__getitem__)
        text = first.decode(_WINDOWS, errors="replace")
        if not _CONTROLS.search(text):
            if found[likely]:
                return likely
            if "\ufffd" not in text:
                return _WINDOWS
    return "utf-8-sig"


def _words_in(text: bytes, encoding: str) -> int | None:
    """Return the number of known words in letters of East Asia; None if not readable.

    The text may be cut within a letter.  A single letter may be two of Latin-1.
    """
    decoder = codecs.getincrementaldecoder(encoding)()
    try:
        return sum(len(word) > 1 for word in JOINED.findall(decoder.decode(text)))
    except UnicodeDecodeError:
        return None


def encoding_notes(path: Path) -> list[str]:
    """Return a sentence on the encoding if it is not UTF-8."""
    encoding = encoding_of(path)
    if encoding == _UTF_16:
        return [f"{path.name} is UTF-16 text"]
    if encoding == _WINDOWS:
        return [
            f"{path.name} is not UTF-8, it is read as Latin-1 (Windows-1252): check "
            "letters such as \N{DEGREE SIGN} in the names of columns"
        ]
    if encoding in _EAST_ASIAN:
        return [f"{path.name} is not UTF-8, it is read as {_EAST_ASIAN[encoding]}"]
    return []
