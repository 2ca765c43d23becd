"""Numbers in text: decimal points or commas, durations, dates and times."""

import re
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from typing import NamedTuple

_DATE = re.compile(r"\d{4}([-/])\d\d\1\d\d[T ]\d\d:\d\d|\d{8}T\d{6}")
# 2026-12-31_10-00-00.5, as in names of files.
_DASHED = re.compile(r"(\d{4}-\d\d-\d\d)[_T ](\d\d)-(\d\d)-(\d\d(?:\.\d+)?)")
# 31-Dec-2026 10:00:00 of MATLAB.
_WORDED = re.compile(r"(\d\d?)-([A-Za-z]{3})-(\d{4})[T ](\d\d:\d\d:\d\d(?:\.\d+)?)")
_NAMES_OF_MONTHS = "Jan Feb Mar Apr May Jun Jul Aug Sep Oct Nov Dec".split()
# 31.12.2026 in Germany, 12/31/2026 in America, perhaps with AM or PM.
_LOCAL = re.compile(
    r"(?P<first>\d\d?)(?P<mark>[./])(?P<second>\d\d?)(?P=mark)(?P<year>\d{4})[T ]+"
    r"(?P<hour>\d\d?):(?P<minute>\d\d)(?::(?P<seconds>\d\d(?:[.,]\d+)?))?"
    r"(?: ?(?P<half>[APap])[Mm])?"
)
_SLASHED = re.compile(r"(?<![\d/])(\d\d?)/(\d\d?)/(\d{4})(?=[T ])")
_FLAGS = {"true": 1.0, "false": 0.0}
_MONTHS = 12
_SECONDS_OF = {"sec": 1.0, "s": 1.0, "ms": 1e-3, "min": 60.0, "hr": 3600.0}
_DURATION = re.compile(
    rf"(?P<number>[-+]?\d+\.?\d*(?:e[-+]?\d+)?) ?(?P<unit>{'|'.join(_SECONDS_OF)})"
    r"|(?:(?P<days>\d+) days? \+?)?(?:(?P<hours>\d+):)?(?P<minutes>\d\d?):"
    r"(?P<seconds>\d\d?(?:\.\d+)?)(?: ?(?P<half>[APap])[Mm])?"
)


def is_number(cell: str) -> bool:
    """Return whether a cell is a flag or a number, with a decimal point or a comma."""
    if flag(cell) is not None:
        return True
    return number(cell, ".") is not None or number(cell, ",") is not None


def flag(cell: str) -> float | None:
    """Return 1 or 0 for a flag as pandas and MATLAB write it; None of other cells.

    Examples
    --------
    >>> flag("True"), flag("false"), flag("1")
    (1.0, 0.0, None)
    """
    return _FLAGS.get(cell.lower())


def columns_of_flags(rows: Iterable[Sequence[str]]) -> list[int]:
    """Return the columns that have flags, and no numbers.

    A single flag in a column of numbers is a fault.

    Examples
    --------
    >>> columns_of_flags([["0.5", "True", "1"], ["0.6", "", "false"]])
    [1]
    """
    flags, numbers = set[int](), set[int]()
    for row in rows:
        for place, cell in enumerate(row):
            if flag(cell) is not None:
                flags.add(place)
            elif is_number(cell):
                numbers.add(place)
    return sorted(flags - numbers)


def decimal_mark(cells: Iterable[str]) -> str | None:
    """Return the mark of the first number that has one."""
    for cell in cells:
        if _is_date(cell):
            continue
        if number(cell, None) is None and number(cell, ",") is not None:
            return ","
        if "." in cell:
            return "."
    return None


class DateOrder(NamedTuple):
    """Whether the day comes first in dates with slashes, and how that is known.

    Parameters
    ----------
    day_first : bool
    said : str
        A sentence if no date of the text says it; else nothing.
    """

    day_first: bool = False
    said: str = ""


def date_order(text: str) -> DateOrder:
    """Return the order of a text's dates with slashes, which all have the same.

    If none has a day above 12, the order is the one in which the text spans less time;
    the month is first if both span the same.

    Examples
    --------
    >>> date_order("3/4/2026 10:00, 13/4/2026 9:00").day_first
    True
    >>> date_order("3/31/2026 10:00").day_first
    False
    >>> date_order("03/04/2026 23:59, 04/04/2026 00:00").said
    'dates such as 03/04/2026 are read with the day first: none shows the order'
    """
    if _SLASHED.search(text) is None:
        return DateOrder()
    dates = {found.groups(): found[0] for found in _SLASHED.finditer(text)}
    pairs = [(int(one), int(other), int(year)) for one, other, year in dates]
    if any(max(one, other) > _MONTHS for one, other, _ in pairs):
        return DateOrder(any(one > _MONTHS for one, _, _ in pairs))
    by_month = [31 * (12 * year + one) + other for one, other, year in pairs]
    by_day = [31 * (12 * year + other) + one for one, other, year in pairs]
    spans = [max(days) - min(days) for days in (by_month, by_day)]
    first = "day" if spans[1] < spans[0] else "month"
    said = (
        f"dates such as {min(dates.values())} are read with the {first} first: none "
        "shows the order"
    )
    return DateOrder(first == "day", said)


def number(cell: str, mark: str | None, day_first: bool = False) -> float | None:
    """Return the number in a cell, None if it is not one with this decimal mark.

    Parameters
    ----------
    day_first : bool
        Whether the day is first in dates with slashes.
    """
    if not cell.isascii():  # Python's float() would accept some
        return None
    if "_" in cell and not _DASHED.fullmatch(cell):
        return None
    if mark == "," and not _is_date(cell):
        if "." in cell:
            return None
        cell = cell.replace(",", ".")
    try:
        return float(cell)
    except ValueError:
        if cell[:4].isdigit():
            return _seconds_of_date(cell)
        if worded := _WORDED.fullmatch(cell):
            return _seconds_of_worded(*worded.groups())
        if _LOCAL.match(cell):
            return _seconds_of_local(cell, day_first)
        return _duration(cell)


def _is_date(cell: str) -> bool:
    forms = (_DATE, _LOCAL, _DASHED, _WORDED)
    return any(form.match(cell) is not None for form in forms)


def _duration(cell: str) -> float | None:
    """Return the seconds of a duration, as MATLAB and pandas write them, or of a day.

    Examples
    --------
    >>> _duration("0.25 sec"), _duration("01:00:02.5"), _duration("0 days 00:00:01")
    (0.25, 3602.5, 1.0)
    >>> _duration("12:00:01 AM"), _duration("1:00:00 pm")  # a time of the day
    (1.0, 46800.0)
    """
    found = _DURATION.fullmatch(cell)
    if found is None:
        return None
    if found["number"] is not None:
        return float(found["number"]) * _SECONDS_OF[found["unit"]]
    days, hours = (float(found[part] or 0.0) for part in ("days", "hours"))
    if found["half"]:
        hours = hours % 12 + 12 * (found["half"] in "Pp")
    minutes, seconds = float(found["minutes"]), float(found["seconds"])
    return 86400.0 * days + 3600.0 * hours + 60.0 * minutes + seconds


def _seconds_of_date(cell: str) -> float | None:
    """Return the seconds from 1970 to a date and time of ISO 8601, in UTC if no zone.

    Examples
    --------
    >>> _seconds_of_date("1970-01-02T00:00:00.25"), _seconds_of_date("1970-01-02")
    (86400.25, None)
    >>> _seconds_of_date("19700102T000000"), _seconds_of_date("1970-01-02_00-00-00.5")
    (86400.0, 86400.5)
    """
    if dashed := _DASHED.fullmatch(cell):
        day, *time = dashed.groups()
        cell = f"{day}T{':'.join(time)}"
    if _DATE.match(cell) is None:
        return None
    try:
        date = datetime.fromisoformat(cell.replace("/", "-"))
    except ValueError:
        return None
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()


def _seconds_of_worded(day: str, month: str, year: str, time: str) -> float | None:
    """Return the seconds from 1970 to a date with the English name of its month.

    Examples
    --------
    >>> _seconds_of_worded("02", "Jan", "1970", "00:00:01.5")
    86401.5
    """
    if month.title() not in _NAMES_OF_MONTHS:
        return None
    number = _NAMES_OF_MONTHS.index(month.title()) + 1
    return _seconds_of_date(f"{year}-{number:02d}-{int(day):02d}T{time}")


def _seconds_of_local(cell: str, day_first: bool = False) -> float | None:
    """Return the seconds from 1970 to a date as a country writes it, in UTC.

    The day comes first beside points, and beside slashes if it is stated.

    Examples
    --------
    >>> [_seconds_of_local(d) for d in ("02.01.1970 00:00:01,5", "1/2/1970 1:00 AM")]
    [86401.5, 90000.0]
    """
    found = _LOCAL.fullmatch(cell)
    if found is None:
        return None
    first, second = int(found["first"]), int(found["second"])
    day_first = day_first or found["mark"] == "."
    day, month = (first, second) if day_first else (second, first)
    hour = int(found["hour"])
    if found["half"]:
        hour = hour % 12 + 12 * (found["half"] in "Pp")
    try:
        date = datetime(int(found["year"]), month, day, hour, int(found["minute"]))
    except ValueError:
        return None
    seconds = float((found["seconds"] or "0").replace(",", "."))
    return date.replace(tzinfo=UTC).timestamp() + seconds
