"""Columns of a wrench sensor, of a base's motion and of contacts, by words in names.

Scalar columns belong together if their names differ by x, y, z (and w), or by three or
four numbers; an array has only the name.

A wrench is six columns whose names contain force or moment and an axis, and are equal
otherwise, such as ``fx`` to ``tz`` or ``wrench.force.x`` (ROS), an array of six
columns, or two of three.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from consistent_id.recordings.column_words import BASE, CONTACTS, words

BaseRole = Literal["orientation", "angular_velocity", "acceleration", "position"]
Order = Literal["xyzw", "wxyz"]

_NOT_OF_A_BASE = {"target", "desired", "des", "cmd", "command", "commanded", "ref"}
_NOT_OF_A_BASE |= {"error", "reference", "setpoint", "projected", "gravity", "mag"}
_NOT_OF_A_BASE |= {"bias", "cov"}
_LIMBS = {"foot", "feet", "leg", "sole", "hand", "wrist", "tool", "dof", "joint"}
# A name has a role if it has all words of one of these.
_ROLES: dict[BaseRole, tuple[str, ...]] = {
    "orientation": ("quat", "quaternion", "orientation", "rotation", "rot", "q"),
    "angular_velocity": (
        "gyro",
        "gyroscope",
        "omega",
        "angvel",
        "ang vel",
        "angular velocity",
        "angular vel",
        "gyr",
    ),
    "acceleration": (
        "acc",
        "accel",
        "accelerometer",
        "acceleration",
        "specific force",
    ),
    "position": ("pos", "position", "place", "p", "xyz", "translation"),
}
_NEEDS_BASE = ("position",)  # else they are a joint's, or a foot's
_AXIS = re.compile(r"(?P<stem>.*?)(?P<axis>[wxyzWXYZ]|\d)(?P<end>\]?)")
_COMPONENTS = {"force", "forces", "torque", "torques", "wrench", "moment", "x", "y"}
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
class BaseNames:
    """Names of one quantity of the base: an array, or one name for each column.

    `order` is that of a quaternion, if the names state it.
    """

    role: BaseRole
    names: str | tuple[str, ...]
    order: Order | None = None

    def __str__(self) -> str:
        return self.names if isinstance(self.names, str) else ", ".join(self.names)


def base_names(
    names: Sequence[str], widths: Mapping[str, int], known: Sequence[str] = ()
) -> tuple[BaseNames, ...]:
    """Return the columns that may describe the base, in the log's order.

    Parameters
    ----------
    widths : mapping of str to int
        Columns of the names that are arrays of several.
    known : sequence of str
        Names with another meaning, such as joints' columns.

    Examples
    --------
    >>> log = ["time", "q_hip", "imu_gyro_x", "imu_gyro_y", "imu_gyro_z"]
    >>> base_names(log, {})[0].names
    ('imu_gyro_x', 'imu_gyro_y', 'imu_gyro_z')
    >>> [found.order for found in base_names(["qw", "qx", "qy", "qz"], {})]
    ['wxyz']
    """
    free = [name for name in names if name not in known]
    found = [
        *_base_arrays(free, widths),
        *_groups([n for n in free if n not in widths]),
    ]
    return tuple(found)


def _base_arrays(names: Sequence[str], widths: Mapping[str, int]) -> list[BaseNames]:
    found = []
    for name in names:
        width = widths.get(name, 1)
        said = words(name)
        if width == 13 and {"root", "base"} & said:  # Isaac: pose, then velocities
            found.append(BaseNames("position", f"{name}[0:3]"))
            found.append(BaseNames("orientation", f"{name}[3:7]"))
        elif width in (3, 4) and (role := _role(said, width)) is not None:
            found.append(BaseNames(role, name))
    return found


def _groups(names: Sequence[str]) -> list[BaseNames]:
    """Return scalar columns that differ only by their axis."""
    groups: dict[tuple[str, str], dict[str, str]] = {}
    for name in names:
        match = _AXIS.fullmatch(name)
        if match is not None:
            key = match["stem"], match["end"]
            groups.setdefault(key, {})[match["axis"].lower()] = name
    found = []
    for (stem, _), columns in groups.items():
        axes = "".join(columns)
        kind = "".join(sorted(axes))
        if kind not in ("xyz", "wxyz", "012", "123", "0123", "1234"):
            continue
        role = _role(words(stem), len(axes))
        # q1 to q4 are usually joints: after a bare q, only letters denote a quaternion.
        if role is None or (words(stem) == {"q"} and kind != "wxyz"):
            continue
        order: Order | None = None
        if kind == "wxyz":
            order = "wxyz" if axes.startswith("w") else "xyzw"
            kind = order
        found.append(BaseNames(role, tuple(columns[a] for a in kind), order))
    return found


def _role(said: frozenset[str], width: int) -> BaseRole | None:
    if said & _NOT_OF_A_BASE or said & _LIMBS or said & CONTACTS:
        return None
    for role, phrases in _ROLES.items():
        if (width == 4) != (role == "orientation"):
            continue
        if role in _NEEDS_BASE and not said & BASE:
            continue
        if any(set(phrase.split()) <= said for phrase in phrases):
            return role
    return None


def contact_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the columns that may be contact flags, or contact forces.

    Examples
    --------
    >>> contact_names(["time", "contact_FL", "FR_foot_contact", "contact_force_x"])
    ('contact_FL', 'FR_foot_contact')
    """
    others = _COMPONENTS | _NOT_OF_A_BASE
    said = ((name, words(name)) for name in names)
    return tuple(name for name, of in said if of & CONTACTS and not of & others)


def matched_frame(column: str, feet: Mapping[str, Sequence[str]]) -> str | None:
    """Return the foot whose name, or part of it, a column contains; None if not unique.

    Parameters
    ----------
    feet : mapping of str to sequence of str
        Other names of each, such as those of the links that end in it.

    Examples
    --------
    >>> feet = {"FL_foot": ["FL_calf"], "FR_foot": ["FR_calf"]}
    >>> matched_frame("contact_FL", feet), matched_frame("contact_rear", feet)
    ('FL_foot', None)
    """
    said = [w for w in re.split(r"[^a-z0-9]+", column.lower()) if w not in CONTACTS]
    rest = "".join(word for word in said if word not in ("foot", "feet", "state", ""))
    if not rest:
        return None
    for fits in (str.__eq__, str.startswith, str.__contains__):
        hits = {
            foot
            for foot, others in feet.items()
            if any(fits(_plain(name), rest) for name in (foot, *others))
        }
        if len(hits) == 1:
            return hits.pop()
    return None


def _plain(name: str) -> str:
    """Return a frame's name in lower case, without the common words of feet."""
    parts = re.split(r"[^a-z0-9]+", name.lower())
    return "".join(part for part in parts if part not in ("foot", "feet", "link"))


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
