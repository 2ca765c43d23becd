"""A log's names of columns as patterns: names that differ by a number or by a joint."""

import re
import shlex
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import count, takewhile, zip_longest

from consistent_id.recordings.column_words import (
    BASE,
    MEASURED,
    channel_of,
    is_bare,
    is_current,
    is_force,
    is_lone_command,
    says_reading,
    says_unit_of,
    states,
    unit_of,
    words,
)
from consistent_id.recordings.own_names import own_names
from consistent_id.recordings.readers.units import listed_names


@dataclass(frozen=True, slots=True)
class NumberedColumns:
    """Columns whose names differ only by a number.

    Parameters
    ----------
    before, after : str
        The text on either side of the number.
    digits : int
        Digits of each number, if they begin with zeros: ``q_01``.
    """

    before: str
    after: str
    first: int
    last: int
    digits: int = 0

    def __len__(self) -> int:
        return self.last - self.first + 1

    def __str__(self) -> str:
        first, last = (self.number(place) for place in (0, len(self) - 1))
        return f"{self.before}{{{first}..{last}}}{self.after}"

    @property
    def pattern(self) -> str:
        """The pattern of columns that count all joints from 1."""
        return f"{self.before}{{number{self._format}}}{self.after}"

    def option(self, channel: str) -> str:
        """Return the option that names these columns of a channel."""
        place = "number" if self.first else "index"
        text = f"{self.before}{{{place}{self._format}}}{self.after}"
        return f"--{channel} {shlex.quote(text)}"

    def option_of_part(self, channel: str, first: int, end: int) -> str:
        """Return the option that names the columns from a place up to an end."""
        numbers = f"{{{self.number(first)}..{self.number(end - 1)}}}"
        return f"--{channel} {shlex.quote(f'{self.before}{numbers}{self.after}')}"

    @property
    def _format(self) -> str:
        return f":0{self.digits}d" if self.digits else ""

    def number(self, place: int) -> str:
        """Return the number at an index, from 0, as the log spells it."""
        return f"{self.first + place:0{self.digits}d}"

    def name(self, place: int) -> str:
        """Return the name at an index, from 0."""
        return f"{self.before}{self.number(place)}{self.after}"


def numbered_columns(names: Sequence[str]) -> tuple[NumberedColumns, ...]:
    """Return runs of at least two names with consecutive numbers, in the log's order.

    Examples
    --------
    >>> [str(run) for run in numbered_columns(["t", "q1", "q2", "q3", "tau_0_Nm"])]
    ['q{1..3}']
    >>> [str(run) for run in numbered_columns(["tau_08", "tau_09", "tau_10"])]
    []
    >>> [str(run) for run in numbered_columns(["tau_00", "tau_01", "tau_02"])]
    ['tau_{00..02}']
    """
    return _numbered_columns(tuple(names))


# Called several times with the same names of a log.
@lru_cache(maxsize=4)
def _numbered_columns(names: tuple[str, ...]) -> tuple[NumberedColumns, ...]:
    known = frozenset(names)
    copies = {copy for same in repeated_columns(names) for copy in same[1:]}
    return tuple(
        dict.fromkeys(run for n in names for run in _runs(n, known, n in copies))
    )


def repeated_columns(names: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Return columns of one name, of which pandas numbers all but the first.

    None, if a name has such a number without a first: then numbers are the log's own.

    Examples
    --------
    >>> repeated_columns(["t", "tau", "tau.1", "tau.2"])
    (('tau', 'tau.1', 'tau.2'),)
    >>> repeated_columns(["q.1", "q.2", "tau", "tau.1", "tau.2"])
    ()
    """
    known = frozenset(names)
    stems = dict.fromkeys(n.removesuffix(".1") for n in names if n.endswith(".1"))
    firsts = [stem for stem in stems if f"{stem}.0" not in known]
    if not known.issuperset(firsts):
        return ()
    found = []
    for first in firsts:
        copies = (f"{first}.{k}" for k in count(1))
        found.append((first, *takewhile(known.__contains__, copies)))
    return tuple(found)


_DIGITS = re.compile(r"\d+")


def _runs(name: str, known: frozenset[str], is_copy: bool) -> Iterator[NumberedColumns]:
    """Yield runs that begin with a name; not those of the last number of a copy."""
    for found in _DIGITS.finditer(name):
        if is_copy and found.end() == len(name):
            continue
        if (first := int(found[0])) > 1:
            continue
        digits = len(found[0]) if len(found[0]) > 1 else 0
        run = NumberedColumns(
            name[: found.start()], name[found.end() :], first, first, digits
        )
        if run.name(-1) in known:
            continue
        more = takewhile(known.__contains__, map(run.name, count(1)))
        if further := sum(1 for _ in more):
            yield replace(run, last=first + further)


def with_joint(name: str, joints: Sequence[str]) -> str:
    """Return a name with ``{joint}`` in place of a joint's name, if it has one.

    Whole words are preferred, then longer names: joint_10 to joint_1.
    """
    within = [j for j in joints if j in name]
    whole = [j for j in within if _is_whole(j, name)] if len(within) > 1 else within
    inside = max(whole or within, key=len, default=None)
    if inside is None or "{" in name:
        return name
    if _is_whole(inside, name):  # of y_velocity, not the last letter
        return _in_words(inside).sub("{joint}", name)
    return name.replace(inside, "{joint}")


def _is_whole(joint: str, name: str) -> bool:
    """Return whether a name has a joint's in whole words: of b.tau, b and not a."""
    return _in_words(joint).search(name) is not None


def _in_words(joint: str) -> re.Pattern[str]:
    return re.compile(rf"(?<![^\W_]){re.escape(joint)}(?![^\W_])")


def shown(names: Sequence[str], joints: Sequence[str] = (), most: int = 12) -> str:
    """Return names for a message: as patterns if they have numbers or joints' names.

    Examples
    --------
    >>> shown(["time", "q1", "q2", "current1", "current2"])
    'time, q{1..2}, current{1..2}'
    >>> shown(["time", "q_hip", "q_knee"], ["hip", "knee"])
    'time, q_{joint}'
    """
    names = list(dict.fromkeys(with_joint(name, joints) for name in names))
    lines: list[str] = []
    gone: set[str] = set()
    runs = numbered_columns(names)
    for name in names:
        if name in gone:
            continue
        run = next((r for r in runs if name == r.name(0)), None)
        lines.append(name if run is None else str(run))
        if run is not None:
            gone |= {run.name(place) for place in range(len(run))}
    more = len(lines) - most
    return ", ".join(lines[:most]) + (f" and {more} more" if more > 0 else "")


@dataclass(frozen=True, slots=True)
class NamePattern:
    """A pattern of the names of a channel's columns.

    Parameters
    ----------
    text : str
        With ``{joint}`` or ``{number}``, or the name of an array.
    joints : tuple of str
        Joints of the robot that have such a column in the log.
    names : tuple of (str, str)
        The log's name of a joint, and the robot's.
    is_array : bool
        Whether it is an array of all joints.
    units : tuple of str
        The unit of each joint, if ``{unit}`` stands for it in the text.
    """

    text: str
    joints: tuple[str, ...]
    names: tuple[tuple[str, str], ...] = ()
    is_array: bool = False
    units: tuple[str, ...] = ()


_ANOTHER = set(
    "sim simulated model nominal ff feedforward set rated max min est estimated "
    "offset bias friction fric prev output frottement estime estimee "
    "摩擦 估计 推定 最大 最小 마찰 추정 최대 최소".split()
)
_ESTIMATED = set("est estimated estime estimee output 估计 推定 추정".split())
_OF_A_MOTOR = {
    "motor",
    "rotor",
    "motorside",
    "moteur",
    "电机",
    "モータ",
    "모터",
}  # before the gear
_OF_ANOTHER_BODY = BASE | {"gripper", "finger", "fingers", "greifer", "pince"}
_OF_JOINTS = {"joint", "joints", "jnt", "state", "states"}  # and of no other body


_BEFORE_A_JOINT = re.compile(
    r"(?:joint|jnt|axis|achse|axe|motor|servo|actuator|dof|(?<![a-z])[ja])[ _.\[(]*",
    re.IGNORECASE,
)
_AXIS = re.compile(r"(?<![^\W_])[xyzXYZ](?![^\W_])")
_LAST_WORD = re.compile(r"[^\W\d_]+[ _.\[(]*")

DOUBTFUL = 2
"""Rank of a pattern of something else, such as a simulation."""


def doubt(channel: str, pattern: str) -> int:
    """Return a rank of patterns of one channel: measured, plain, of something else.

    Examples
    --------
    >>> [doubt("torque", f"tau_{word}") for word in ("meas", "{joint}", "sim")]
    [0, 1, 2]
    >>> doubt("velocity", "dq_{joint} [rev/min]")  # no minimum
    1
    """
    said = words(pattern) - words(unit_of(channel, pattern))
    moved = channel != "torque" and said & _OF_A_MOTOR
    return DOUBTFUL if moved or said & _ANOTHER else 0 if said & MEASURED else 1


def is_of_another_only(velocity: str, position: str) -> bool:
    """Return whether a velocity is of something else, and the position is not.

    Velocities are often estimates.

    Examples
    --------
    >>> is_of_another_only("motor_dq{number}", "q{number}")
    True
    >>> is_of_another_only("motor_dq{number}", "motor_q{number}")
    False
    """
    kinds = [_ANOTHER - _ESTIMATED, _OF_A_MOTOR, _OF_ANOTHER_BODY]
    speed = words(velocity) - words(unit_of("velocity", velocity))
    place = words(position)
    return any(speed & kind and not place & kind for kind in kinds)


def name_patterns(
    channel: str,
    names: Sequence[str],
    joints: Sequence[str],
    all_joints: tuple[str, ...] = (),
) -> list[NamePattern]:
    """Return all patterns of a channel's columns, the best first."""
    return list(_name_patterns(channel, tuple(names), tuple(joints), all_joints))


# Called several times with the same names of a log.
@lru_cache(maxsize=8)
def _name_patterns(
    channel: str,
    names: tuple[str, ...],
    joints: tuple[str, ...],
    all_joints: tuple[str, ...],
) -> tuple[NamePattern, ...]:
    """Return the patterns that are of a channel, or only by their unit; best first."""
    observed = states(names)

    def fits(text: str) -> bool:
        if channel == "command":
            return is_lone_command(text)
        if stated := {"current": is_current, "force": is_force}.get(channel):
            return stated(text) and not channel_of(text)
        return channel_of(text, observed) == channel

    found = _every_pattern(names, joints, all_joints)
    fitting = [p for p in found if fits(p.text)]
    if not fitting and channel == "position":
        bare = [p for p in found if is_bare(p.text)]
        fitting = [p for p in bare if not says_reading(p.text)]
        if not any(_may_be_position(name, observed) for name in names):
            fitting = fitting or bare
    if not fitting:
        fitting = [p for p in found if says_unit_of(channel, p.text)]
    # Names beside a single torque are those of arrays, not of joints.
    own = own_names(names, channel)
    torques = sum(channel_of(name, observed) == "torque" for name in names)
    if not fitting and (len(own) != max(len(joints), 2) or torques == 1):
        fitting = [
            NamePattern(name, tuple(joints), is_array=True)
            for name in names
            if fits(name)
            and not any(c.isdigit() for c in name)
            and not _is_component(name, names)
        ]
    return tuple(
        sorted(
            fitting,
            key=lambda p: (*rank(channel, p), len(p.text)),
        )
    )


def _may_be_position(name: str, observed: Sequence[str]) -> bool:
    plain = words(name) and is_bare(name) and not says_reading(name)
    return bool(plain) or channel_of(name, observed) == "position"


def _is_component(name: str, names: Collection[str]) -> bool:
    """Return whether a name is one of three that differ by an axis in space.

    Examples
    --------
    >>> _is_component("omega_x", ["omega_x", "omega_y", "omega_z"])
    True
    >>> _is_component("omega_x", ["omega_x"])
    False
    """
    found = _AXIS.search(name)
    if found is None:
        return False
    axes = "xyz" if found[0].islower() else "XYZ"
    start, end = found.span()
    return all(f"{name[:start]}{axis}{name[end:]}" in names for axis in axes)


def rank(channel: str, pattern: NamePattern) -> tuple[int, ...]:
    """Return the rank of a pattern of a channel: the lower, the better."""
    return (
        -len(pattern.joints),
        int(bool(words(pattern.text) & _OF_ANOTHER_BODY)),
        doubt(channel, pattern.text),
        int(bool(words(pattern.text) & _OF_A_MOTOR)),  # torques of motors, last
        int("{joint}" not in pattern.text or bool(pattern.names)),  # exact names first
        int(not words(pattern.text) & _OF_JOINTS),
        int(_counts_another_thing(pattern.text)),
    )


def _counts_another_thing(text: str) -> bool:
    """Return whether a number behind that of a pattern is rather the joint's.

    A number behind a word of a joint or of a channel is the joint's.

    Examples
    --------
    >>> _counts_another_thing("robot{number}.q_1"), _counts_another_thing("q{number}")
    (True, False)
    >>> _counts_another_thing("joint{number}.encoder_1")
    False
    >>> _counts_another_thing("q{number}_encoder1")
    False
    """
    before, mark, after = text.rpartition("}")
    if not mark or not any(c.isdigit() for c in after):
        return False
    stem = before.rpartition("{")[0]
    last = [found[0] for found in _LAST_WORD.finditer(stem) if found.end() == len(stem)]
    of_a_joint = any(_BEFORE_A_JOINT.fullmatch(w) or channel_of(w) for w in last)
    return not of_a_joint


@lru_cache(maxsize=4)
def _every_pattern(
    names: tuple[str, ...], joints: tuple[str, ...], all_joints: tuple[str, ...]
) -> tuple[NamePattern, ...]:
    """Return all patterns of columns, one for each joint, whatever their meaning."""
    found: dict[str, NamePattern] = {}
    known = frozenset(names)
    runs = numbered_columns(names)
    numbered = {run.name(place) for run in runs for place in range(len(run))}
    for same in repeated_columns(names):
        for every in (joints, all_joints):
            if len(same) == len(every) and same[0] not in numbered:
                each = ",".join(same[every.index(joint)] for joint in joints)
                found.setdefault(each, NamePattern(f"{{{each}}}", joints))
    for name in names:
        for pattern in _pattern_by_name(name, known, joints):
            found.setdefault(pattern.text, pattern)
    for pattern in _of_several_units(list(found.values()), joints):
        found.setdefault(pattern.text, pattern)
    for run in runs:
        for every in (joints, all_joints):
            if len(run) == len(every) and not _names_others(run, joints, all_joints):
                pattern = _pattern_by_number(run, joints, every)
                found.setdefault(pattern.text, pattern)
    return tuple(found.values())


def columns_of_pattern(pattern: NamePattern) -> list[str]:
    """Return the log's names of a pattern."""
    if len(each := listed_names(pattern.text)) > 1:
        return list(each)
    own = {joint: name for name, joint in pattern.names}
    return [
        pattern.text.format(joint=own.get(joint, joint), number=number, unit=unit)
        for number, (joint, unit) in enumerate(
            zip_longest(pattern.joints, pattern.units, fillvalue=""), 1
        )
    ]


_LAST_UNIT = re.compile(r"(?<=[\[(_ ])(deg|rad|rev|mm|cm|m)(?:/s)?(?=\s*[\])]?$)")


def _of_several_units(
    patterns: Sequence[NamePattern], joints: Sequence[str]
) -> Iterator[NamePattern]:
    """Return patterns of names that differ by the joint and its unit alone.

    Some joints of many robots slide: ``j1_pos [deg]``, ``j3_pos [mm]``.
    """
    groups: dict[str, dict[str, str]] = defaultdict(dict)
    for pattern in patterns:
        if found := _LAST_UNIT.search(pattern.text):
            text = (
                pattern.text[: found.start()] + "{unit}" + pattern.text[found.end() :]
            )
            for joint in pattern.joints:
                groups[text].setdefault(joint, found[0])
    for text, units in groups.items():
        if len(set(units.values())) > 1:
            named = tuple(joint for joint in joints if joint in units)
            yield NamePattern(text, named, units=tuple(units[j] for j in named))


def _pattern_by_name(
    name: str, known: frozenset[str], joints: Sequence[str]
) -> list[NamePattern]:
    text = with_joint(name, joints)
    if text == name:
        return []
    present = tuple(j for j in joints if text.replace("{joint}", j) in known)
    return [NamePattern(text, present)] if present else []


def _names_others(
    run: NumberedColumns, joints: Sequence[str], all_joints: Sequence[str]
) -> bool:
    """Return whether columns have joints' names, a locked one's among them.

    Then their numbers are part of the names, and count no joints.
    """
    columns = [run.name(place) for place in range(len(run) if all_joints else 0)]
    named = [{j for j in all_joints if _is_whole(j, name)} for name in columns]
    return all(named) and any(each.isdisjoint(joints) for each in named)


def _pattern_by_number(
    run: NumberedColumns, joints: Sequence[str], every: Sequence[str]
) -> NamePattern:
    """Return a pattern of columns that count every joint, for some of them."""
    if run.first == 1 and tuple(every[: len(joints)]) == tuple(joints):
        return NamePattern(run.pattern, tuple(joints))
    pairs = tuple((run.number(every.index(joint)), joint) for joint in joints)
    return NamePattern(f"{run.before}{{joint}}{run.after}", tuple(joints), pairs)
