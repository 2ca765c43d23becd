"""What fits a terminal: the first lines of an answer, none too wide."""

from textwrap import wrap

LINES = 25
"""Lines of an answer by default."""

COLUMNS = 100
"""Columns of an answer by default."""


_KEPT = ("written: ", "next: ", "my result is bad")  # lines that are never left out


def shortened(text: str) -> str:
    r"""Return the first lines of a text, and how to see all of it.

    Wide lines are wrapped.  Lines that name files, the next step or the page of help
    are kept as they are.

    Examples
    --------
    >>> print(shortened("\n".join(str(i) for i in range(30))).splitlines()[-1])
    (6 more lines: --verbose prints them, --json has all figures)
    """
    lines = [short for line in text.splitlines() for short in _wrapped(line)]
    kept = [line for line in lines if line.startswith(_KEPT)]
    others = [line for line in lines if line not in kept]
    while others and not others[-1]:
        others.pop()
    room = LINES - len(kept)
    if len(others) > room:
        left = len(others) - (room - 1)
        rest = f"({left} more lines: --verbose prints them, --json has all figures)"
        others = [*others[: room - 1], rest]
    return "\n".join([*others, *kept])


def _wrapped(line: str) -> list[str]:
    if len(line) <= COLUMNS or line.startswith(_KEPT):
        return [line]
    indent = " " * (len(line) - len(line.lstrip()) + 2)
    return wrap(
        line,
        COLUMNS,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
        drop_whitespace=True,
    )
