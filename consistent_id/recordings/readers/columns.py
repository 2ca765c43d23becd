"""A log's names of its channels, and the resulting names for given joints."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from string import Formatter

from consistent_id._support.arrays import freeze
from consistent_id._support.tables import brief
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.beside_columns import BesideColumns
from consistent_id.recordings.readers.units import (
    Units,
    checked_units,
    listed_names,
    refuse_units_of_a_name,
)
from consistent_id.recordings.recording import COMMANDS
from consistent_id.robot.parameters import did_you_mean, require_known

_RANGE = re.compile(r"\{(?P<first>\d+)\.\.(?P<last>\d+)\}")
CHANNELS = ("position", "velocity", "acceleration", "torque", *COMMANDS)


@brief
@dataclass(frozen=True, slots=True)
class Columns:
    """A log's names of its columns, arrays or fields.

    ``{joint}`` stands for a joint's name in the log, ``{number}`` for its number among
    the requested joints, counted from 1, and ``{index}`` for it from 0.  ``{8..13}``
    stands for these numbers, one for each joint in their order, ``{01..06}`` for those
    of two digits, ``{base,wrist}`` for these words, and ``{unit}`` for a joint's unit,
    if `units` states one for each joint.  None: the log has no such channel.

    Parameters
    ----------
    time, position, velocity, acceleration, torque : str, optional
        Names, in SI units unless `units` states others.  In files of arrays a name is
        a path: ``run/q_{joint}`` in HDF5, ``log.q`` in MATLAB.
    names : mapping of str to str
        The log's name of a joint -> the joint's name, where the two differ.
    array_joints : sequence of str
        Joints of the columns of two-dimensional arrays, in the arrays' order; a name
        without ``{joint}`` and ``{number}`` is then the name of such an array.
    position_command, velocity_command, torque_command : str, optional
        Commands of the drives, if these are PD-controlled.
    torque_joints : sequence of str
        Joints whose torque the log has; by default all.  The torque of the others is
        not read, but set to zero: a `TorqueModel` of the same `torque_joints` has no
        row for them.
    units : mapping of str to str or sequence of str
        Units that are not s, rad, m, N m or N, by channel: one for all joints or one
        each, such as ``{"time": "ms", "position": "deg", "velocity": "rpm"}``.  Torque
        in ``"%"`` or ``"permille"`` is relative to the rated torque, and ``"A"`` or
        ``"mA"`` are currents; a `torque_gain` in N m, or N m per ampere, converts both.
    beside : BesideColumns
        Measurements of a floating base, of contacts and of wrench sensors.

    Examples
    --------
    >>> Columns(position="q{number}").position.format(joint="elbow", number=3)
    'q3'
    >>> unnamed = Columns("column1", "column{2..7}", torque="column{14..19}")
    >>> renamed = Columns(position="{joint}.pos", names={"A1": "shoulder"})
    >>> arrays = Columns("log.t", "log.q", array_joints=("shoulder", "elbow"))
    """

    time: str = "time"
    position: str = "q_{joint}"
    velocity: str | None = None
    acceleration: str | None = None
    torque: str | None = None
    names: Mapping[str, str] = field(default_factory=dict, hash=False)
    array_joints: Sequence[str] = ()
    torque_joints: Sequence[str] = ()
    units: Units = field(default_factory=dict, hash=False)
    position_command: str | None = None
    velocity_command: str | None = None
    torque_command: str | None = None
    beside: BesideColumns = field(default_factory=BesideColumns, hash=False)

    def __post_init__(self) -> None:
        freeze(self, units=checked_units(self.units))
        freeze(self, torque_joints=tuple(self.torque_joints), names=dict(self.names))
        order = self.array_joints
        if isinstance(order, str) or len(set(order)) != len(order):
            raise RecordingError(f"array_joints are {order!r}, expected distinct names")
        freeze(self, array_joints=tuple(order))
        if len(set(self.names.values())) != len(self.names):
            raise RecordingError(
                f"names give one joint several names in the log: {self.names}"
            )

    def in_log(self, joints: Sequence[str]) -> tuple[str, ...]:
        """Return the log's names of the joints."""
        by_joint = {joint: name for name, joint in self.names.items()}
        for joint in joints:
            if joint in self.names and joint not in by_joint:
                raise RecordingError(
                    f"joint {joint!r}: according to names, {joint!r} of the log is "
                    f"joint {self.names[joint]!r}; state the log's name of {joint!r}"
                )
        return tuple(by_joint.get(joint, joint) for joint in joints)

    def without_torque(self, joints: Sequence[str]) -> tuple[int, ...]:
        """Return the indices of the joints whose torque the log does not have."""
        require_known(
            self.torque_joints, joints, "torque_joints: no joint", RecordingError
        )
        known = self.torque_joints or joints
        return tuple(i for i, joint in enumerate(joints) if joint not in known)


JOINT_STATE = Columns("header.stamp", "position", "velocity", torque="effort")
"""The fields of a ``sensor_msgs/JointState``; how ROS bags are read by default."""


@dataclass(frozen=True, slots=True)
class WantedChannels:
    """The data to read from a table or a file of arrays.

    Parameters
    ----------
    columns : dict of str to tuple of str
        One name per joint, by channel; empty for channels that are not read.
    arrays : dict of str to str
        Channels that are a two-dimensional array, and its name.
    width : int
        Number of columns of such an array.
    places : tuple of int
        Columns of the joints in such an array.
    without_torque : tuple of int
        Places of the joints whose torque the log does not have.
    """

    joints: tuple[str, ...]
    time: str
    columns: dict[str, tuple[str, ...]]
    arrays: dict[str, str]
    width: int
    places: tuple[int, ...]
    without_torque: tuple[int, ...] = ()
    units: Units = field(default_factory=dict, hash=False)
    beside: BesideColumns = field(default_factory=BesideColumns, hash=False)

    @property
    def names(self) -> list[str]:
        """Every name, once."""
        group = (name for names in self.columns.values() for name in names)
        every = (self.time, *self.arrays.values(), *group, *self.beside.names)
        return [name for name in dict.fromkeys(every) if name]


def wanted(columns: Columns, joints: Sequence[str], where: str) -> WantedChannels:
    """Return the names of the patterns for the joints.

    Raises
    ------
    RecordingError
        If a pattern is faulty, gives two joints the same name, or contains a unit.
    """
    joints = at_least_one(joints, where)
    for channel in ("time", *CHANNELS):
        pattern = getattr(columns, channel)
        if pattern is None or channel in columns.units:
            continue
        if channel != "time" or " + " not in pattern:  # whose parts have units
            refuse_units_of_a_name(where, channel, pattern)
    in_log = columns.in_log(joints)
    single, arrays = _by_channel(columns, in_log)
    silent = columns.without_torque(joints)
    if "torque" in single:
        named = enumerate(single["torque"])
        single["torque"] = tuple("" if i in silent else name for i, name in named)
    return WantedChannels(
        joints,
        columns.time,
        single,
        arrays,
        len(columns.array_joints),
        _places(columns, in_log) if arrays else (),
        silent,
        columns.units,
        columns.beside,
    )


def _by_channel(
    columns: Columns, in_log: Sequence[str]
) -> tuple[dict[str, tuple[str, ...]], dict[str, str]]:
    """Return the names of each channel, one per joint or that of an array."""
    single, arrays = {}, {}
    for channel in CHANNELS:
        pattern = getattr(columns, channel)
        if pattern is None:
            continue
        names = _expanded(pattern, in_log, columns.units.get(channel, ()))
        if columns.array_joints and not _placeholders(pattern):
            arrays[channel] = names[0]
        elif len(set(names)) == len(names):
            single[channel] = names
        else:
            raise RecordingError(
                f"column pattern {pattern!r} gives one name for several "
                "joints; put {joint} or {number} in it or, if it names a "
                "two-dimensional array, list the joints of its columns in array_joints"
            )
    return single, arrays


def at_least_one(joints: Sequence[str], where: str) -> tuple[str, ...]:
    """Return the joints as a tuple; refuse none."""
    if not joints:
        raise RecordingError(f"{where}: no joint to read; name at least one")
    return tuple(joints)


def require(where: str, names: Sequence[str], known: Sequence[str]) -> None:
    """Refuse a name that does not occur exactly once."""
    for name in names:
        if name not in known:
            near = did_you_mean(name, map(str, known))
            raise RecordingError(f"{where}: no column {name!r}; {near}")
        if list(known).count(name) > 1:
            raise RecordingError(f"{where}: column {name!r} occurs twice")


def _places(columns: Columns, in_log: Sequence[str]) -> tuple[int, ...]:
    order = columns.in_log(columns.array_joints)
    require_known(in_log, order, "array_joints have no joint", RecordingError)
    return tuple(order.index(name) for name in in_log)


def _placeholders(pattern: str) -> set[str]:
    if len(listed_names(pattern)) > 1:
        return {"index"}
    pattern = _RANGE.sub("{index}", pattern)
    try:
        return {
            field for _, field, _, _ in Formatter().parse(pattern) if field is not None
        }
    except ValueError:
        return {pattern}


def _expanded(
    pattern: str, joints: Sequence[str], units: str | Sequence[str] = ()
) -> tuple[str, ...]:
    refusal = (
        f"column pattern {pattern!r}: only {{joint}}, {{number}}, {{index}} and a "
        "range such as {8..13} or a list such as {base,wrist} can stand in it, and "
        "{unit} with a unit stated for each joint"
    )
    each = units if not isinstance(units, str) and len(units) == len(joints) else None
    if each is not None and "{unit}" in pattern:
        return tuple(
            name.replace("{unit}", unit)
            for name, unit in zip(
                _expanded(pattern.replace("{unit}", "{{unit}}"), joints),
                each,
                strict=True,
            )
        )
    if (numbers := _RANGE.search(pattern)) is not None:
        first, last = int(numbers["first"]), int(numbers["last"])
        if last - first + 1 != len(joints):
            raise RecordingError(
                f"column pattern {pattern!r} has {max(last - first + 1, 0)} numbers, "
                f"expected one for each of the {len(joints)} joints"
            )
        digits = len(numbers["first"])  # with zeros before them, as in {01..06}
        spelt = (f"{k:0{digits}d}" for k in range(first, last + 1))
        singles = (_RANGE.sub(number, pattern, count=1) for number in spelt)
        return tuple(
            _expanded(single, [joint])[0]
            for single, joint in zip(singles, joints, strict=True)
        )
    if len(each_name := listed_names(pattern)) > 1:
        if len(each_name) != len(joints):
            raise RecordingError(
                f"column pattern {pattern!r} lists {len(each_name)} names, expected "
                f"one for each of the {len(joints)} joints"
            )
        return each_name
    if not _placeholders(pattern) <= {"joint", "number", "index"}:
        raise RecordingError(refusal)
    try:
        return tuple(
            pattern.format(joint=j, number=i + 1, index=i) for i, j in enumerate(joints)
        )
    except ValueError as cause:
        raise RecordingError(f"{refusal} ({cause})") from None
