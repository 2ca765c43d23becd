"""Columns of a wrench sensor, by words in their names.

A wrench is six columns whose names contain force or moment and an axis, and are equal
otherwise, such as ``fx`` to ``tz`` or ``wrench.force.x`` (ROS), an array of six
columns, or two of three.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from consistent_id.recordings.column_words import words

_FORCE = r"(?P<force>f|force|forces)"
_MOMENT = r"(?P<moment>m|n|t|tau|torque|torques|moment|moments)"
# A word for force or moment, perhaps something between, and an axis as its last letter.
_SCALAR = re.compile(
    rf"(?P<stem>|.*[^a-zA-Z])(?:{_FORCE}|{_MOMENT})[._/ \[]*(?P<axis>[xyz])"
    r"(?P<end>|[^a-zA-Z].*)",
    re.IGNORECASE,
)
_UNIT = re.compile(r"[^a-z0-9]*(?:n[ .*_]?m|n|newton|newtons)[\])]?$")
_NUMBERED = re.compile(r"(?P<stem>.*?)[._\[]*(?P<number>[0-6])\]?")
_WHOLE = ({"wrench"}, {"ft"}, {"tcp", "force"}, {"force", "torque"}, {"forcetorque"})
_HALVES = {"force": "force", "forces": "force"}
_HALVES |= dict.fromkeys(("torque", "torques", "moment", "moments"), "moment")
_NOT_OF_A_SENSOR = {"target", "desired", "des", "cmd", "command", "ref"}
_NOT_OF_A_SENSOR |= {"joint", "contact"}


@dataclass(frozen=True, slots=True)
class WrenchNames:
    """Names of a measured wrench, force first: arrays, or a name for each column."""

    names: tuple[str, ...]

    def __str__(self) -> str:
        return ", ".join(self.names)


def wrench_names(
    names: Sequence[str], widths: Mapping[str, int] | None = None
) -> tuple[WrenchNames, ...]:
    """Return the columns that may belong to a wrench sensor.

    Parameters
    ----------
    names : sequence of str
    widths : mapping of str to int, optional
        Columns of the names that are arrays of several.

    Examples
    --------
    >>> log = ["time", "q1", "fx", "fy", "fz", "tx", "ty", "tz"]
    >>> str(wrench_names(log)[0])
    'fx, fy, fz, tx, ty, tz'
    >>> str(wrench_names(["ft/force", "ft/torque"], {"ft/force": 3, "ft/torque": 3})[0])
    'ft/force, ft/torque'
    """
    wide = widths or {}
    # Most of many columns have no such form, which is cheaper to see than their words.
    likely = [name for name in names if wide.get(name, 1) > 1 or _may_be_scalar(name)]
    free = [name for name in likely if not _words(name) & _NOT_OF_A_SENSOR]
    scalars = [name for name in free if wide.get(name, 1) == 1]
    found = [*_wrench_arrays(free, wide), *_by_axis(scalars), *_by_number(scalars)]
    return tuple(WrenchNames(tuple(one)) for one in found)


def _may_be_scalar(name: str) -> bool:
    return bool(_SCALAR.fullmatch(name) or _NUMBERED.fullmatch(name))


def may_be_wrench(name: str) -> bool:
    """Return whether an array of this name may be a wrench, or half of one."""
    return bool(_words(name) & _HALVES.keys()) or _is_whole(name)


def _is_whole(name: str) -> bool:
    said = _words(name)
    return any(one <= said for one in _WHOLE)


def _words(name: str) -> set[str]:
    return set(words(name)) | set(re.findall("[a-z]+", name.lower()))


def _wrench_arrays(names: Sequence[str], widths: Mapping[str, int]) -> list[list[str]]:
    found = [[name] for name in names if widths.get(name) == 6 and _is_whole(name)]
    halves: dict[str, dict[str, str]] = {}
    for name in names:
        if widths.get(name) != 3:
            continue
        for word in re.findall("[a-z]+", name.lower())[-1:]:
            if word in _HALVES:
                stem = name[: len(name) - len(word)]
                halves.setdefault(stem, {})[_HALVES[word]] = name
    both = ({"force", "moment"} == set(pair) for pair in halves.values())
    return found + [
        [pair["force"], pair["moment"]]
        for pair, whole in zip(halves.values(), both, strict=True)
        if whole
    ]


def _by_axis(names: Sequence[str]) -> list[list[str]]:
    groups: dict[tuple[str, str], dict[str, str]] = {}
    for name in names:
        match = _SCALAR.fullmatch(name)
        if match is not None:
            kind = "f" if match["force"] else "m"
            end = match["end"].lower()
            key = match["stem"].lower(), _UNIT.sub("", end)
            groups.setdefault(key, {})[kind + match["axis"].lower()] = name
    order = [kind + axis for kind in "fm" for axis in "xyz"]
    return [[g[k] for k in order] for g in groups.values() if set(g) == set(order)]


def _by_number(names: Sequence[str]) -> list[list[str]]:
    """Return six numbered columns named like a wrench, such as UR's TCP force."""
    groups: dict[str, dict[int, str]] = {}
    for name in names:
        match = _NUMBERED.fullmatch(name)
        if match is not None and _is_whole(match["stem"]):
            groups.setdefault(match["stem"], {})[int(match["number"])] = name
    return [
        [group[k] for k in sorted(group)]
        for group in groups.values()
        if sorted(group) in (list(range(6)), list(range(1, 7)))
    ]
