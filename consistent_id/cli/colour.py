"""Colours for verdicts, where somebody looks who wants them."""

import os
import re
from typing import TextIO

_GREEN, _YELLOW, _RED, _BOLD, _PLAIN = (f"\x1b[{n}m" for n in (32, 33, 31, 1, 0))
_COLOURS = {
    "do not use": _RED,
    "use with care": _YELLOW,
    "use": _GREEN,
    "certified": _GREEN,
    "uncertified": _YELLOW,
    "warning": _YELLOW,
    "refused": _RED,
    "impossible": _RED,
    "fault": _RED,
}
# The word "use" is a verdict where it begins a line or stands alone in a cell.
_WORDS = "|".join(word for word in _COLOURS if word != "use")
_WORD = re.compile(rf"\b(?:{_WORDS})\b|(?m:^use(?=:))|(?<=  )use(?=  )")
_TITLE = re.compile(r"^(?=\S)(.+)$", re.MULTILINE)


def wants_colour(stream: TextIO) -> bool:
    """Return whether a stream is a terminal whose user has not asked for plain text."""
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    return stream.isatty() and not plain


def coloured(text: str) -> str:
    r"""Return text with its verdicts in colour and its titles, not indented, bold.

    Examples
    --------
    >>> coloured("  certified")
    '  \x1b[32mcertified\x1b[0m'
    """

    def bold(title: re.Match[str]) -> str:
        return _BOLD + title[0].replace(_PLAIN, _PLAIN + _BOLD) + _PLAIN

    shown = _WORD.sub(lambda word: _COLOURS[word[0]] + word[0] + _PLAIN, text)
    return _TITLE.sub(bold, shown)
