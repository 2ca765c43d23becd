"""Which columns of a log are of a floating base or of contacts: a guess by names.

The words are those of MuJoCo, Isaac Gym and Isaac Lab, legged_gym and ROS, and of
people who write their own.  Scalar columns belong together if their names differ by x,
y, z (and w), or by three or four numbers; an array has the name alone.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from consistent_id.recordings.column_words import words

BaseRole = Literal["orientation", "angular_velocity", "acceleration", "position"]
Order = Literal["xyzw", "wxyz"]

_BASE = {"base", "root", "trunk", "torso", "pelvis", "body", "imu", "odom", "floating"}
_OTHERS = {"target", "desired", "des", "cmd", "command", "commanded", "ref", "error"}
_OTHERS |= {"reference", "setpoint", "projected", "gravity", "mag", "bias", "cov"}
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
_FLAG = {"contact", "contacts", "touch", "stance", "grounded", "footswitch"}
_COMPONENTS = {"force", "forces", "torque", "torques", "wrench", "moment", "x", "y"}


@dataclass(frozen=True, slots=True)
class BaseNames:
    """Names of one quantity of the base: an array, or one name for each column.

    `order` is that of a quaternion, where the names say it.
    """

    role: BaseRole
    names: str | tuple[str, ...]
    order: Order | None = None

    def __str__(self) -> str:
        return self.names if isinstance(self.names, str) else ", ".join(self.names)


def base_names(
    names: Sequence[str], widths: Mapping[str, int], known: Sequence[str] = ()
) -> tuple[BaseNames, ...]:
    """Return what of a log may be of the base, in the log's order.

    Parameters
    ----------
    widths : mapping of str to int
        Columns of the names that are arrays of several.
    known : sequence of str
        Names that are something else, such as joints' columns.

    Examples
    --------
    >>> log = ["time", "q_hip", "imu_gyro_x", "imu_gyro_y", "imu_gyro_z"]
    >>> base_names(log, {})[0].names
    ('imu_gyro_x', 'imu_gyro_y', 'imu_gyro_z')
    >>> [found.order for found in base_names(["qw", "qx", "qy", "qz"], {})]
    ['wxyz']
    """
    free = [name for name in names if name not in known]
    found = [*_arrays(free, widths), *_groups([n for n in free if n not in widths])]
    return tuple(found)


def _arrays(names: Sequence[str], widths: Mapping[str, int]) -> list[BaseNames]:
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
    """Return scalar columns that differ by their axis alone."""
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
        # q1 to q4 are joints as a rule: of a bare q, letters alone say quaternion.
        if role is None or (words(stem) == {"q"} and kind != "wxyz"):
            continue
        order: Order | None = None
        if kind == "wxyz":
            order = "wxyz" if axes.startswith("w") else "xyzw"
            kind = order
        found.append(BaseNames(role, tuple(columns[a] for a in kind), order))
    return found


def _role(said: set[str], width: int) -> BaseRole | None:
    if said & _OTHERS or said & _LIMBS or said & _FLAG:
        return None
    for role, phrases in _ROLES.items():
        if (width == 4) != (role == "orientation"):
            continue
        if role in _NEEDS_BASE and not said & _BASE:
            continue
        if any(set(phrase.split()) <= said for phrase in phrases):
            return role
    return None


def contact_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the columns that may be contact flags, or forces that tell of contact.

    Examples
    --------
    >>> contact_names(["time", "contact_FL", "FR_foot_contact", "contact_force_x"])
    ('contact_FL', 'FR_foot_contact')
    """
    return tuple(
        name
        for name in names
        if (said := words(name)) & _FLAG and not said & (_COMPONENTS | _OTHERS)
    )


def matched_frame(column: str, feet: Mapping[str, Sequence[str]]) -> str | None:
    """Return the foot whose name a column holds, or part of it; None if it is not one.

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
    said = [w for w in re.split(r"[^a-z0-9]+", column.lower()) if w not in _FLAG]
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
    """Return a frame's name in lower case, without what all feet are called."""
    parts = re.split(r"[^a-z0-9]+", name.lower())
    return "".join(part for part in parts if part not in ("foot", "feet", "link"))
