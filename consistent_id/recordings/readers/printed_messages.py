"""Messages printed as text, and lists in cells, as tables.

``rostopic echo -p`` and ``ros2 topic echo --csv`` write rows in which the joints' names
are fields, so that numbered columns would not say which joint they are of.  ``echo``
alone writes a block of YAML for each message, KUKA's interface an element of XML.
pandas writes a column of arrays as lists in its cells, such as ``"[0.1, 0.2]"``.
Programmes print lines in which each value has its name, ``t=0.01, q1=0.5, tau1=2.0``
or ``[INFO] [1732876800.0] q: [0.1, 0.2] tau: [1, 2]``.  Lists become a column for each
item; lines of other names are left out.
"""

import csv
import io
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

from consistent_id.recordings.readers.units import is_any_unit, is_time
from consistent_id.recordings.readers.yaml_messages import (
    MessageError,
    fields_of,
    is_float,
)

_CHANNELS = ("position", "velocity", "effort")
_STAMP = ("header.stamp.sec", "header.stamp.nanosec")
_BEFORE_NAMES = 3  # fields of a header: seconds, nanoseconds, frame
_NAMED = re.compile(r".*?names?[._\[]*\d+\]?$")
_PLACE = re.compile(r"(?P<stem>.*?)(?P<mark>[._\[]*)(?P<number>\d+)\]?$")
_COUNTED = re.compile(r"[._\[]?\d+\]?$")  # the number that ends a name
_INTEGER = re.compile(r"\d+")

_YAML = re.compile(r"^header:\s*\n\s+(?:seq|stamp):", re.MULTILINE)
_MESSAGE = re.compile(r"^header:", re.MULTILINE)
_NOTICES = 2_000  # characters of warnings above the first message, at most
_XML = re.compile(r"\A\s*<(?P<root>Rob|Sen)\b[^>]*>")
_LIST = re.compile(r"[\[(](?P<items>(?:[-+.,\deE\s]|nan|null|none|inf)*)[\])]", re.I)
_LISTS = re.compile(r"[\[(]\s*[-+.\dni][^\[\]()]*[,\s][^\[\]()]*[\])]", re.I)
_QUOTED = re.compile(r"['\"]([^'\"]+)['\"]")
_HEAD = 20_000  # characters in which the first row ends
_DECIMAL_COMMA, _SPACE = re.compile(r"\d,\d"), re.compile(r"\d\s+[-+.\d]")
_ELEMENT = re.compile(r"<(\w+)((?:\s+[\w.]+=\"[^\"]*\")+)\s*/>")
_ATTRIBUTE = re.compile(r"([\w.]+)=\"([^\"]*)\"")
_VALUE = re.compile(r"<(\w+)>\s*([-+.\deE]+)\s*</\1>")
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
_ROS_STAMP = re.compile(r"\[(\d{6,}\.\d+)\]")  # seconds, of ROS
_FEWEST = 3  # values in a line
_LOOKED_AT = 20  # lines
_MOST = 0.5  # of these
_HEAD_OF_LINES = 50_000  # characters in which they are


@dataclass(frozen=True, slots=True)
class NamedColumns:
    """Columns whose joints are named in the rows.

    Parameters
    ----------
    names : tuple of str
        Of all columns, with the joints' names.
    repeated : tuple of str
        Successive fields that each row has to have, the joints' names.
    is_row : bool
        Whether the first line is a row, and no header.
    """

    names: tuple[str, ...]
    repeated: tuple[str, ...]
    is_row: bool


def named_columns(first: Sequence[str], second: Sequence[str]) -> NamedColumns | None:
    """Return the columns of joint states whose first two lines these are, or None.

    Examples
    --------
    >>> line = ["5", "0", "", "hip", "knee", "0.1", "0.2", "3.0", "4.0"]
    >>> named_columns(line, line).names[3:7]
    ('name0', 'name1', 'position.hip', 'position.knee')
    >>> named_columns(["%time", "name0", "effort0"], ["17", "hip", "0.1"]).names
    ('%time', 'name0', 'effort.hip')
    >>> named_columns(["t", "name", "q_0", "q_1"], ["17", "['b', 'a']", "1", "2"]).names
    ('t', 'name', 'q.b', 'q.a')
    >>> named_columns(["joint_names0", "actual.positions0"], ["hip", "0.1"]).names
    ('joint_names0', 'actual.positions.hip')
    """
    found = _without_header(first) or _with_header(first, second)
    return found or _with_list(first, second)


def _without_header(line: Sequence[str]) -> NamedColumns | None:
    """Read seconds, nanoseconds, a frame, and the arrays of joint states."""
    stamp, rest = line[:2], list(line[_BEFORE_NAMES:])
    if not all(map(_INTEGER.fullmatch, stamp)) or is_float("".join(line[2:3])):
        return None
    joints = _leading_names(rest)
    arrays, left = divmod(len(rest), len(joints)) if joints else (0, 1)
    if left or not 1 < arrays <= len(_CHANNELS) + 1 or len(set(joints)) < len(joints):
        return None
    numbers = [f"name{k}" for k in range(len(joints))]
    values = [f"{c}.{j}" for c in _CHANNELS[: arrays - 1] for j in joints]
    names = (*_STAMP, "header.frame_id", *numbers, *values)
    return NamedColumns(names, tuple(joints), is_row=True)


def _leading_names(fields: Sequence[str]) -> list[str]:
    found = list[str]()
    for text in fields:
        if not text or is_float(text):
            break
        found.append(text)
    return found


def _with_header(first: Sequence[str], second: Sequence[str]) -> NamedColumns | None:
    """Replace the numbers of columns by the names in the row below."""
    if len(first) != len(second):
        return None
    places = [k for k, name in enumerate(first) if _NAMED.fullmatch(name)]
    joints = tuple(second[k] for k in places)
    if not joints or any(not j or is_float(j) for j in joints):
        return None
    places_of: dict[str, dict[str, str]] = defaultdict(dict)
    for k in places:
        if (match := _PLACE.fullmatch(first[k])) is not None:
            places_of[match["stem"]][match["number"]] = second[k]
    # Other messages' columns are of others: of one list, all of its message are named.
    ends = r"[^./]*$" if len(places_of) == 1 else r"(?:joint_?)?names?$"
    messages = {re.sub(ends, "", stem): named for stem, named in places_of.items()}
    groups: dict[tuple[str, str], dict[str, int]] = defaultdict(dict)
    for k, name in enumerate(first):
        if (match := _PLACE.fullmatch(name)) is not None and k not in places:
            groups[match["stem"], match["mark"]][match["number"]] = k
    names = list(first)
    for (stem, _), numbers in groups.items():
        message = max(filter(stem.startswith, messages), key=len, default=None)
        if message is not None and numbers.keys() == messages[message].keys():
            for number, k in numbers.items():  # one of each joint
                names[k] = f"{stem}.{messages[message][number]}"
    if names == list(first):
        return None
    return NamedColumns(tuple(names), joints, is_row=False)


def _with_list(first: Sequence[str], second: Sequence[str]) -> NamedColumns | None:
    """Replace the numbers of columns by the names in a list below, as of bagpy.

    Columns count the list's names from 0, as ``position_0``.
    """
    if len(first) != len(second):
        return None
    joints, place = _joints(second)
    if len(joints) < 2:  # a list of one says nothing of an order
        return None
    said = {
        f"{before}{mark}{k}{end}": f"{before}.{joint}"
        for before in {_COUNTED.sub("", name) for name in first}
        for mark, end in (("_", ""), (".", ""), ("", ""), ("[", "]"))
        for k, joint in enumerate(joints)
        if all(f"{before}{mark}{n}{end}" in first for n in range(len(joints)))
    }
    names = tuple(said.get(name, name) for name in first)
    return NamedColumns(names, (second[place],), is_row=False) if said else None


def is_element(text: str) -> bool:
    """Return whether a text begins with an element of KUKA's interface."""
    return _XML.match(text) is not None


def _is_message(text: str) -> bool:
    return bool(_YAML.search(text, 0, _NOTICES) or _XML.match(text))


def is_printed(text: str) -> bool:
    """Return whether a text begins with a message, or has lists in its first row."""
    if _is_message(text) or _are_named(text):
        return True
    return _LISTS.search(text, 0, _HEAD) is not None and bool(_widths(text))


# A text is asked for its names, its notes and its values.
@lru_cache(maxsize=1)
def as_table(text: str) -> str:
    """Return messages of YAML or XML as a table with commas and a header.

    Messages with other fields than most have are left out, such as a gripper's, and a
    last one that is cut off.  Lists in cells become columns.

    Raises
    ------
    MessageError
        If a line is not understood.
    """
    if not _is_message(text):
        return _named_table(text) if _are_named(text) else _without_lists(text)
    if (found := _XML.match(text)) is not None:
        parts = text.split(f"</{found['root']}>")
        rows = [_of_xml(part) for part in parts if "<" in part]
    else:
        parts = re.split(r"^---\s*$", text, flags=re.MULTILINE)
        if len(parts) > 1 and not text.endswith("\n"):
            parts.pop()  # its last number may be cut off
        # Between messages, ``echo`` prints that one was lost, and warnings.
        begins = [(_MESSAGE.search(part), part) for part in parts]
        parts = [part[begin.start() :] for begin, part in begins if begin]
        rows = [row for part in parts for row in _of_yaml(part)]
        rows = rows or _of_fields(parts)
    sizes = Counter({frozenset(row): 0 for row in rows})
    for row in rows:
        sizes[frozenset(row)] += len(row)
    most = max(sizes, key=sizes.__getitem__, default=frozenset())
    used = [row for row in rows if frozenset(row) == most]
    names = list(used[0]) if used else []  # their order may differ from row to row
    lines = [",".join(row[name] for name in names) for row in used]
    return "\n".join([",".join(names), *lines, ""])


def _rows(text: str) -> tuple[str, Iterator[list[str]], str]:
    """Return the comments above a table, its rows, header first, and their mark."""
    start = 0
    while text.startswith("#", start):
        start = text.find("\n", start) + 1 or len(text)
    head = text[start:].partition("\n")[0]
    mark = max(",;\t", key=head.count)
    lines = io.StringIO(text[start:], newline="")
    return text[:start], csv.reader(lines, delimiter=mark), mark


def _widths(text: str) -> list[int]:
    """Return the items of each cell of the first row, if some are lists; else none."""
    _, rows, _ = _rows(text)
    names, first = next(rows, []), next(rows, [])
    items = [_items(cell) for cell in first]
    found = any(one is not None and len(one) > 1 for one in items)
    if not found or len(names) != len(first):
        return []
    return [0 if one is None else len(one) for one in items]


def _without_lists(text: str) -> str:
    """Return a table with a column for each item of the lists in its cells.

    Beside a list of names, items are called by these; rows of other names are left out.
    """
    comments, rows, mark = _rows(text)
    widths = _widths(text)
    head, first = next(rows), next(rows, [])
    joints, place = _joints(first)
    out = io.StringIO()
    table = csv.writer(out, delimiter=mark, lineterminator="\n")
    table.writerow(
        (f"{name}.{joints[k]}" if width == len(joints) else f"{name}[{k}]")
        if width
        else name
        for name, width in zip(head, widths, strict=True)
        for k in range(max(width, 1))
    )
    for row in (first, *rows):
        if not joints or len(row) != len(widths) or row[place] == first[place]:
            table.writerow(_flat(row, widths))
    return comments + out.getvalue()


def _joints(row: Sequence[str]) -> tuple[list[str], int]:
    """Return the names in the only cell with a list of distinct ones, and its place."""
    found = [(_QUOTED.findall(c), k) for k, c in enumerate(row) if c[:1] in "[("]
    names = [(each, k) for each, k in found if each and len(set(each)) == len(each)]
    return names[0] if len(names) == 1 else ([], 0)


def _flat(row: Sequence[str], widths: Sequence[int]) -> list[str]:
    """Return a row's cells with the items of its lists; others are left as they are."""
    if len(row) != len(widths):
        return list(row)
    flat = list[str]()
    for cell, width in zip(row, widths, strict=True):
        items = _items(cell) if width else None
        flat += [cell] if items is None else items
    return flat


def _items(cell: str) -> list[str] | None:
    """Return the items of a list in a cell; None of other cells."""
    found = _LIST.fullmatch(cell.strip())
    if found is None:
        return None
    text = found["items"]
    if _DECIMAL_COMMA.search(text) and _SPACE.search(text):
        return None  # [0,1 0,2] are two numbers, or four
    items = text.replace(",", " ").split()
    return ["nan" if item.lower() in ("null", "none") else item for item in items]


def _of_yaml(text: str) -> Iterator[dict[str, str]]:
    """Yield the fields of one joint state, if it is one."""
    stamp = [
        re.search(rf"^\s+{word}:\s*(\d+)", text, re.MULTILINE)
        for word in ("secs?", "n(?:ano)?secs?")
    ]
    joints = _list(text, "name")
    if None in stamp or not joints:
        return
    row = {n: found[1] for n, found in zip(_STAMP, stamp, strict=True) if found}
    for channel in _CHANNELS:
        values = _list(text, channel)
        if len(values) == len(joints):
            row |= {f"{channel}.{j}": v for j, v in zip(joints, values, strict=True)}
    yield row


def _of_fields(parts: Sequence[str]) -> list[dict[str, str]]:
    """Return the fields of each message; without the last one if it is cut off."""
    rows = list[dict[str, str]]()
    for place, part in enumerate(parts, start=1):
        try:
            rows.append(fields_of(part))
        except MessageError as cause:
            if place == len(parts) > 1:
                break
            raise MessageError(f"message {place}: {cause}") from None
    return [row for row in rows if row]


def _list(text: str, key: str) -> list[str]:
    """Return the items of a list of YAML, in one line or in several."""
    found = re.search(
        rf"^{key}:\s*(?:\[(?P<line>[^\]]*)\]|(?P<lines>(?:\n\s*- .*)+))",
        text,
        re.MULTILINE,
    )
    if found is None:
        return []
    if found["line"] is not None:
        items = found["line"].replace("\n", " ").split(",")
    else:
        items = [line.strip()[2:] for line in found["lines"].strip().splitlines()]
    bare = [item.strip().strip("'\"") for item in items if item.strip()]
    return ["nan" if item.lower() == ".nan" else item for item in bare]


def _of_xml(text: str) -> dict[str, str]:
    """Return attributes by ELEMENT.ATTRIBUTE, and values by their element."""
    row = {
        f"{element}.{name}": value
        for element, attributes in _ELEMENT.findall(text)
        for name, value in _ATTRIBUTE.findall(attributes)
    }
    return row | dict(_VALUE.findall(text))


def _are_named(text: str) -> bool:
    r"""Return whether most of the first lines of a text name the same values.

    Examples
    --------
    >>> _are_named("t=0 q=[1, 2] tau=3\n" * 3), _are_named("t,q,tau\n0,1,2\n")
    (True, False)
    """
    lines = [line for line in text[:_HEAD_OF_LINES].splitlines()[:_LOOKED_AT] if line]
    rows = Counter(tuple(_row(line)) for line in lines)
    names, number = rows.most_common(1)[0] if rows else ((), 0)
    return len(names) >= _FEWEST and number > max(_MOST * len(lines), 1)


def _named_table(text: str) -> str:
    r"""Return lines of names and values as a table with commas and a header.

    Examples
    --------
    >>> print(_named_table("t=0.1, q=[1 2]\nnothing\nt=0.2, q=[3 4]\n"), end="")
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
    stamp = _ROS_STAMP.search(line)
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
