"""Lines of names and values, as programmes print them, as a table.

``t=0.01, q1=0.5, tau1=2.0``, or ``[INFO] [1732876800.0] q: [0.1, 0.2] tau: [1, 2]``.
Lists become a column for each item; lines of other names are left out.
"""

import re
from collections import Counter
from collections.abc import Iterator

from consistent_id.recordings.readers.units import is_any_unit, is_time

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf)\b"
_PAIR = re.compile(
    r"(?P<quote>[\"']?)(?<![\w.\[])(?P<name>[^\W\d][\w./]*(?:\[\d+\])?)(?P=quote)"
    rf"\s*[=:]\s*(?:(?P<number>{_NUMBER})|[\[(](?P<items>[^\[\]()=:]*)[\])])",
    re.IGNORECASE,
)
_MORE = re.compile(  # numbers of a list without brackets
    rf"(?:(?:[ \t]*[,;][ \t]+|[ \t]+)(?:{_NUMBER})(?![\w.:=,-]))+", re.IGNORECASE
)
_UNIT = re.compile(
    r"[ ]?(?P<unit>[mk]?N m|(?:[^\W\d_]|[%°])[\w/.*·^°]*)(?![\w/.*·^°\[]|\s*[=:])"
)
_END = re.compile(r"$|\s|[,;](?!\d)|[)\]}\"'|]")  # behind a number
_ITEM = re.compile(rf"(?:{_NUMBER})", re.IGNORECASE)
_STAMP = re.compile(r"\[(\d{6,}\.\d+)\]")  # seconds, of ROS
_FEWEST = 3  # values in a line
_LOOKED_AT = 20  # lines
_MOST = 0.5  # of these
_HEAD = 50_000  # characters in which they are


def are_named(text: str) -> bool:
    r"""Return whether most of the first lines of a text name the same values.

    Examples
    --------
    >>> are_named("t=0 q=[1, 2] tau=3\n" * 3), are_named("t,q,tau\n0,1,2\n")
    (True, False)
    """
    lines = [line for line in text[:_HEAD].splitlines()[:_LOOKED_AT] if line]
    rows = Counter(tuple(_row(line)) for line in lines)
    names, number = rows.most_common(1)[0] if rows else ((), 0)
    return len(names) >= _FEWEST and number > max(_MOST * len(lines), 1)


def table_of(text: str) -> str:
    r"""Return lines of names and values as a table with commas and a header.

    Examples
    --------
    >>> print(table_of("t=0.1, q=[1 2]\nnothing\nt=0.2, q=[3 4]\n"), end="")
    t,q[0],q[1]
    0.1,1,2
    0.2,3,4
    """
    lines = text.splitlines()
    whole = lines if text.endswith("\n") else lines[:-1]  # its last number may be cut
    rows = [row for line in whole if (row := _row(line))]
    most = Counter(map(tuple, rows)).most_common(1)[0][0]
    values = [",".join(row.values()) for row in rows if tuple(row) == most]
    return "\n".join([",".join(most), *values, ""])


def _row(line: str) -> dict[str, str]:
    """Return the values of a line by their names; none of a comment.

    None either where a name stands twice: then another word says of which thing it is.
    """
    if line.startswith("#"):
        return {}
    pairs = list(_values(line))
    row = dict(pairs)
    if len(row) < len(pairs):
        return {}
    stamp = _STAMP.search(line)
    if row and stamp is not None and not any(map(is_time, row)):
        row = {"time": stamp[1], **row}
    return row


def _values(line: str) -> Iterator[tuple[str, str]]:
    """Yield values with their names, to which their units are added.

    Examples
    --------
    >>> list(_values("t=10ms q1=30 deg, load: 1 2")), list(_values("q=0,5 day=1-2"))
    ([('t [ms]', '10'), ('q1 [deg]', '30'), ('load[0]', '1'), ('load[1]', '2')], [])
    """
    for found in _PAIR.finditer(line):
        items, end = found["items"], found.end()
        more = _MORE.match(line, end) if items is None else None
        if more is not None:
            items, end = f"{found['number']} {more[0]}", more.end()
        last = _UNIT.match(line, end)
        unit = f" [{last['unit']}]" if last and is_any_unit(last["unit"]) else ""
        if not unit and not _END.match(line, end):
            continue  # such as a date, a decimal comma or 0x1F
        if items is None:
            yield f"{found['name']}{unit}", found["number"]
            continue
        for place, item in enumerate(_ITEM.findall(items)):
            yield f"{found['name']}[{place}]{unit}", item
