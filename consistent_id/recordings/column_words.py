"""The meaning of words in a column's name: a joint's channel, a base, a wrench.

The words are those of logs of MuJoCo, Drake, Isaac Gym and Isaac Lab, legged_gym,
LeRobot, ROS, KUKA, ABB, Universal Robots, Franka and Kinova, and of people who write
their own.  Scalar columns belong together if their names differ by x, y, z (and w), or
by three or four numbers; an array has only the name.  A wrench is six columns whose
names contain force or moment and an axis, and are equal otherwise, such as ``fx`` to
``tz`` or ``wrench.force.x`` (ROS), an array of six columns, or two of three.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from consistent_id.recordings.readers.units import is_unit_of, unit_of_a_name

CHANNELS = ("position", "velocity", "torque")

# A name belongs to a channel if it has all words of one of these phrases; "qpos",
# "qvel" and "qfrc actuator" are of MuJoCo, "observation state" of LeRobot, "axis act"
# of KUKA, "feedback joints" of ABB.
_WORDS = {
    channel: tuple(frozenset(phrase.split()) for phrase in phrases.split(", "))
    for channel, phrases in {
        "position": "q, pos, position, positions, ang, angle, angles, theta, th, phi, "
        "qpos, jpos, observation state, axis act, feedback joints, winkel",
        "velocity": "dq, qd, qdot, vel, velo, velocity, velocities, speed, speeds, "
        "spd, dtheta, thetadot, thd, dphi, phidot, qvel, jvel, geschwindigkeit",
        "torque": "tau, trq, tq, tor, torq, torque, torques, moment, moments, eff, "
        "effort, efforts, jts, qfrc actuator, actuator force, drehmoment",
    }.items()
}
_CURRENT = {"current", "currents", "cur", "curr", "amp", "amps", "ampere", "amperes"}
_CURRENT |= {"i", "iq"}
_COMMANDED = {"target", "desired", "des", "cmd", "command", "commanded", "ref"}
_COMMANDED |= {"reference", "setpoint", "goal", "soll"}
_COMMANDS = {f"{short}{word}" for short in ("q", "pos", "p") for word in _COMMANDED}
_COMMANDS |= {"aspos"}  # KUKA
_COMMANDED |= {"d"}
_OTHER = {"error", "err", "limit", "action", "ext", "external", "computed", "residual"}
_OTHER |= {"ddot", "acc", "accel", "acceleration", "accelerations", "jerk", "std"}
_OTHER |= {"gravity", "coriolis", "temperature", "voltage"}
_OTHER |= {"tcp", "tip", "ee", "eef", "cartesian"}  # the pose and wrench of a tool
_RATE = {"dot"}  # of a position: its velocity
_STATE = {"observation", "state"}  # LeRobot
_MEASURED = {"observation", "state", "actual"}
_DEGREES = ({"ai", "pos"}, {"axis", "act"}, {"feedback", "joints"})  # KUKA, ABB
_KORTEX = {"actuators"}  # Kinova's feedback, in degrees and degrees per second
_BARE = {"j", "jnt", "joint", "joints", "axis", "axes", "ax", "achse", "a", "dof"}
_BARE |= {"actual", "act", "measured", "deg", "degs", "degree", "degrees", "rad", "mm"}
_ANGULAR = {"ang", "angle", "angles", "angular"}  # of a velocity, they say of what

# Of a base and of contacts.
BaseRole = Literal["orientation", "angular_velocity", "acceleration", "position"]
Order = Literal["xyzw", "wxyz"]

_BASE = {"base", "root", "trunk", "torso", "pelvis", "body", "imu", "odom", "floating"}
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
_FLAG = {"contact", "contacts", "touch", "stance", "grounded", "footswitch"}
_COMPONENTS = {"force", "forces", "torque", "torques", "wrench", "moment", "x", "y"}

_FORCES = {"force", "forces", "frc"}  # of a sliding joint
_BESIDE_FORCES = {"n", "kn", "k", "newton", "newtons"}
_BESIDE_FORCES |= {"drive", "motor", "actuator", "state"}

# Of a wrench sensor.
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


_JOINT = re.compile(r"\{[^{},]*\}")
_LAST_UNIT = re.compile(  # in brackets, or a word of its own
    r"(?P<name>.*[^ _])[ _]*(?:[\[(](?P<unit>[^\[\](){}]+)[\])]|[ _](?P<word>[^\W_]+))"
)
_LETTERS = re.compile(r"[a-z]+")
_OTHER_LETTERS = re.compile(r"[^\W\d_a-zà-ÿµμ]+")  # Japanese, Cyrillic and the like
_GREEK = str.maketrans({"θ": "theta", "τ": "tau"})
HUMP = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
"""The place before a word that a capital letter begins: ``basePos``."""
# A word that another one follows without a mark: ``jointpos``, ``qmeas``.
_GLUED = re.compile(
    r"(?<![a-z])(joint(?=[a-z]{3})|(?:d?q|qd|tau|trq|pos|vel)"
    r"(?=(?:mes|meas|msr|act|actual|measured)(?![a-z])))"
)


def words(pattern: str) -> set[str]:
    """Return the words of a pattern without the joint, in lower case.

    Examples
    --------
    >>> sorted(words("axisQMsr_{joint}"))
    ['axis', 'axisqmsr', 'msr', 'q']
    >>> sorted(words("jointpos{number}"))
    ['joint', 'jointpos', 'pos']
    """
    rest = _JOINT.sub(" ", pattern).translate(_GREEK)
    lower = rest.lower()
    apart = _GLUED.sub(r"\1 ", HUMP.sub(" ", rest).lower())
    return {
        *_LETTERS.findall(lower),
        *_LETTERS.findall(apart),
        *_OTHER_LETTERS.findall(lower),
    }


def states(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names of observed states, which `channel_of` looks for in a log.

    Examples
    --------
    >>> states(["time", "observation.state", "action"])
    ('observation.state',)
    """
    return _states(tuple(names))


# Called several times with the same names of a log.
@lru_cache(maxsize=4)
def _states(names: tuple[str, ...]) -> tuple[str, ...]:
    likely = (name for name in names if "state" in name.lower())
    return tuple(name for name in likely if _STATE <= words(name))


@lru_cache
def _fitting(said: frozenset[str]) -> list[str]:
    """Return the channels that have a phrase of the words; many names have the same.

    An angular velocity is a velocity, and so is the rate of a position, ``q_dot``.
    """
    fits = [c for c in CHANNELS if any(phrase <= said for phrase in _WORDS[c])]
    rate = fits == ["position"] and _RATE & said
    angular = fits == ["position", "velocity"] and _ANGULAR & said
    return ["velocity"] if rate or angular else fits


def channel_of(pattern: str, names: Iterable[str] = ()) -> str:
    """Return the channel of a pattern; empty for none.

    Among commands, only those of position are a channel.  A plain ``action`` beside
    ``observation.state`` (LeRobot) is its target; elsewhere it is the output of a
    policy, in other units.

    Parameters
    ----------
    names : iterable of str
        All columns of the log.

    Examples
    --------
    >>> channel_of("actual_qd_{number}"), channel_of("q_des_{joint}")
    ('velocity', 'position_command')
    >>> channel_of("dq_des_{joint}"), channel_of("q_error_{joint}")
    ('', '')
    >>> channel_of("action"), channel_of("action", ["observation.state", "action"])
    ('', 'position_command')
    """
    said = words(pattern)
    if said == {"action"} and any(_STATE <= words(name) for name in names):
        return "position_command"
    if "action" in said and not said & _MEASURED:  # LeRobot, of its followers
        fits = _fitting(frozenset(said))
        return "position_command" if fits == ["position"] else ""
    if said & _OTHER:
        return ""
    fits = _fitting(frozenset(said))
    if said & _COMMANDS or (said & _COMMANDED and fits == ["position"]):
        return "position_command"
    if said & _COMMANDED:
        return ""
    # torque_axis_act is a torque, vel_axis_act a share of the limit.
    if "torque" in fits:
        return "torque"
    if not fits and pattern.endswith("{joint}_w"):  # Drake
        return "velocity"
    if {"vel", "axis", "act"} <= said or len(fits) != 1:
        return ""
    return fits[0]


def is_bare(pattern: str) -> bool:
    """Return whether a pattern names a joint or an axis, perhaps a unit, and no more.

    Robots' makers call positions so: ``J1``, ``A1``, ``Joint 1 [deg]``.

    Examples
    --------
    >>> is_bare("J{number}[deg]"), is_bare("{joint}"), is_bare("J{number} load")
    (True, True, False)
    """
    return words(pattern) <= _BARE


def says_nothing(pattern: str) -> bool:
    """Return whether no word of a pattern is known, of a channel or of another thing.

    Examples
    --------
    >>> says_nothing("Ist_{number}"), says_nothing("q_err_{number}")
    (True, False)
    """
    said = words(pattern)
    known = said & (_CURRENT | _COMMANDED | _COMMANDS | _OTHER | _BASE | _FLAG)
    return not (known or _fitting(frozenset(said)) or is_bare(pattern))


def says_unit_of(channel: str, pattern: str) -> bool:
    """Return whether a pattern is a joint's name or number and a unit of the channel.

    Any other word may say that it is something else: a limit, a fan, a load cell.

    Examples
    --------
    >>> says_unit_of("torque", "{joint} [Nm]"), says_unit_of("velocity", "J1 [rpm]")
    (True, True)
    >>> says_unit_of("torque", "{joint} brake [Nm]")
    False
    """
    rest = before_unit_of(channel, pattern)
    return rest is not None and is_bare(rest)


def may_be_of_unit(channel: str, pattern: str) -> bool:
    """Return whether a unit of the channel ends a pattern without a known word.

    Examples
    --------
    >>> may_be_of_unit("torque", "{joint} load [Nm]"), may_be_of_unit("torque", "x")
    (True, False)
    >>> may_be_of_unit("torque", "{joint} friction error [Nm]")
    False
    """
    rest = before_unit_of(channel, pattern)
    return rest is not None and says_nothing(rest)


def before_unit_of(channel: str, name: str) -> str | None:
    """Return a name without the unit of a channel that ends it; None without one.

    Examples
    --------
    >>> before_unit_of("torque", "elbow_Nm"), before_unit_of("position", "elbow [deg]")
    ('elbow', 'elbow')
    >>> before_unit_of("position", "elbow_Nm"), before_unit_of("position", "arm_m")
    (None, None)
    """
    found = _LAST_UNIT.fullmatch(name)
    if found is None or channel not in CHANNELS:
        return None
    unit = found["unit"] or found["word"]
    if len(unit) < 2 or not is_unit_of(channel, unit):  # m, N, A and the like
        return None
    return found["name"]


def is_current(pattern: str) -> bool:
    """Return whether a pattern denotes motor current, not torque."""
    said = words(pattern)
    torque = any(phrase <= said for phrase in _WORDS["torque"])
    return bool(said & _CURRENT) and not torque


def is_force(pattern: str) -> bool:
    """Return whether a pattern denotes the force of the drives of named joints.

    Numbered forces may as well be a sensor's, and other words say of what a force is.

    Examples
    --------
    >>> is_force("{joint}_force [N]"), is_force("F_{number}")
    (True, False)
    >>> is_force("{joint}_gripper_force"), is_force("{joint}_max_force")
    (False, False)
    """
    said = words(pattern)
    known = _FORCES | _BESIDE_FORCES | _MEASURED | _BARE
    return bool("{joint}" in pattern and said & _FORCES and said <= known)


def unit_of(channel: str, pattern: str) -> str:
    """Return the unit that a name states, or its maker's unit; empty for SI."""
    said = words(pattern)
    if channel == "position" and any(said >= some for some in _DEGREES):
        return "deg"
    if _KORTEX <= said and channel in ("position", "velocity"):
        return {"position": "deg", "velocity": "deg/s"}[channel]
    if channel == "position_command" and "aspos" in said:
        return "deg"
    return unit_of_a_name(channel, pattern)


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


def _role(said: set[str], width: int) -> BaseRole | None:
    if said & _NOT_OF_A_BASE or said & _LIMBS or said & _FLAG:
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
    """Return the columns that may be contact flags, or contact forces.

    Examples
    --------
    >>> contact_names(["time", "contact_FL", "FR_foot_contact", "contact_force_x"])
    ('contact_FL', 'FR_foot_contact')
    """
    return tuple(
        name
        for name in names
        if (said := words(name)) & _FLAG and not said & (_COMPONENTS | _NOT_OF_A_BASE)
    )


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
