"""Options that a message proposes where columns of a log are not found by names."""

import shlex
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from consistent_id.errors import ProblemError, RecordingError
from consistent_id.recordings.column_names import (
    DOUBTFUL,
    NamePattern,
    NumberedColumns,
    columns_of_pattern,
    doubt,
    name_patterns,
    numbered_columns,
    shown,
)
from consistent_id.recordings.column_words import (
    CHANNELS,
    channel_of,
    words,
)
from consistent_id.recordings.mixed_columns import mixed_patterns
from consistent_id.recordings.own_names import mapping_advice, mapping_option, own_names
from consistent_id.recordings.readers.columns import Columns
from consistent_id.recordings.readers.named_arrays import upright
from consistent_id.recordings.readers.recording_file import read_whole
from consistent_id.recordings.readers.units import Units
from consistent_id.recordings.recording import COMMANDS
from consistent_id.recordings.unknown_columns import (
    UnknownColumns,
    arrays_of_a_group,
    joints_of_wide,
    moving_part,
    of_unit,
    torque_if,
    unknown_columns,
)
from consistent_id.robot.parameters import did_you_mean

WITHOUT_TORQUE = (
    "Parameters cannot be found without torque or current: record the effort too."
)

GAINS = "KP,KD"  # in place of values that no log contains


@dataclass(frozen=True, slots=True, eq=False)
class KnownColumns:
    """The facts about a log that are known before its columns are searched.

    Parameters
    ----------
    joints : tuple of str
        The robot's joints that move.
    channels : mapping of str to str
        Columns by channel, as in `Columns`; the others are found in the log.
    names : sequence of str, optional
        Names of the log's columns, if it is a table in memory and no file.
    torque_joints : sequence of str
        Joints whose torque the log has, if that is known.
    units : mapping of str to str or sequence of str, optional
        Units by channel, as in `Columns`; the others are found in the columns' names.
    currents : bool
        Whether motor currents may be used if there is no torque: with a gain.
    commands : bool
        Whether commands of position are required instead of torque.
    all_joints : tuple of str
        All joints in their order, if some are locked and not among `joints`: numbered
        columns may include them.
    rows : mapping of int to sequence of sequence of str, optional
        For each number of joints, the rows of joints that a log with so many columns
        may have, the likeliest first: the message proposes to lock the others.  By
        default the first joints.
    taken : collection of str
        Names that belong to no joint, such as those of a floating base.
    arrays : Columns, optional
        Known arrays of all joints, such as parts of ``qpos``.
    topic : str, optional
        Topic of a ROS bag, whose fields are those of joint states; by default the topic
        that names most of the joints.
    sliding : frozenset of str
        Joints that slide: columns of force are their torque.
    flat : bool
        Whether each column belongs to one joint, and none is an array of all.
    """

    joints: tuple[str, ...]
    channels: Mapping[str, str] = field(default_factory=dict)
    names: Sequence[str] | None = None
    torque_joints: Sequence[str] = ()
    units: Units | None = None
    currents: bool = False
    commands: bool = False
    all_joints: tuple[str, ...] = ()
    rows: Mapping[int, Sequence[Sequence[str]]] | None = None
    taken: Collection[str] = ()
    arrays: Columns | None = None
    topic: str | None = None
    sliding: frozenset[str] = frozenset()
    flat: bool = False

    def __post_init__(self) -> None:
        known = ("time", "position", "velocity", "torque", *COMMANDS)
        for name in self.channels:
            if name not in known:
                raise ProblemError(
                    f"columns: no channel {name!r}; {did_you_mean(name, known)}"
                )

    @property
    def effort(self) -> str:
        """The channel that the drives' effort is read from."""
        return "position_command" if self.commands else "torque"

    def renamed(self, names: Mapping[str, str]) -> "KnownColumns":
        """Return the same with other names of joints, such as those in the log."""

        def others(joints: Iterable[str]) -> tuple[str, ...]:
            return tuple(names.get(joint, joint) for joint in joints)

        return replace(
            self,
            joints=others(self.joints),
            torque_joints=others(self.torque_joints),
            all_joints=others(self.all_joints),
            sliding=frozenset(others(self.sliding)),
        )


def candidates(
    channel: str,
    names: Sequence[str],
    moved: tuple[str, ...],
    known: KnownColumns,
) -> list[NamePattern]:
    """Return candidates for a channel of the moving joints, the best first."""
    patterns = name_patterns(channel, names, moved, known.all_joints)
    usable = [p for p in patterns if not (known.flat and p.is_array)]
    if channel == "torque" and not usable and known.currents:
        if currents := name_patterns("current", names, moved, known.all_joints):
            return currents
    wanted = {*((channel == "torque" and known.torque_joints) or moved)}
    if not patterns or not wanted <= {*patterns[0].joints}:
        patterns = mixed_patterns(
            channel, names, patterns, moved, known.all_joints, known.sliding
        )
    if channel in ("velocity", "position_command"):
        patterns = [pattern for pattern in patterns if pattern.joints == moved]
    if channel == "position_command" and known.commands and not patterns:
        lone = _lone_commands(names, moved, known)
        return lone if len(lone) == 1 else []
    return patterns


def _lone_commands(
    names: Sequence[str], moved: tuple[str, ...], known: KnownColumns
) -> list[NamePattern]:
    """Return commands of the moving joints that do not say of what, each once.

    Gains make torque of commands of position, so these are meant, if there is one.
    """
    patterns = name_patterns("command", names, moved, known.all_joints)
    every = [
        p for p in patterns if p.joints == moved and not (known.flat and p.is_array)
    ]
    each: dict[frozenset[str], NamePattern] = {}
    for pattern in every:
        here = [pattern.text] if pattern.is_array else columns_of_pattern(pattern)
        each.setdefault(frozenset(here), pattern)
    return list(each.values())


def not_found(
    log: Path,
    channel: str,
    names: Sequence[str],
    joints: tuple[str, ...],
    known: KnownColumns,
) -> RecordingError:
    """Return the error of a channel without columns, with advice."""
    if channel == "torque" and _is_motion(names):
        return RecordingError(
            f"{log}: a motion as excite writes it, and no log: it has time, q_, dq_ "
            f"and ddq_ of {shown(joints)}, and no torque. Play it on the robot, record "
            "positions and torques or motor currents meanwhile, and name that log"
        )
    more, options = _advice(log, channel, names, joints, known)
    flag = channel.replace("_", "-")
    return RecordingError(
        f"{log}: found no column that is the {channel} of {shown(joints)}; the "
        f"log has {shown(names, joints)}. Name it: --{flag} NAME, with {{joint}} for "
        "the joint's name, {number} for its place from 1, {index} from 0." + more,
        options=options,
    )


def _is_motion(names: Sequence[str]) -> bool:
    """Return whether columns are those of a trajectory's samples, and no others."""
    joints = [n.removeprefix("ddq_") for n in names if n.startswith("ddq_")]
    of_them = {f"{d}q_{joint}" for d in ("", "d", "dd") for joint in joints}
    return bool(joints) and {*names} == {"time", *of_them}


def _advice(
    log: Path,
    channel: str,
    names: Sequence[str],
    joints: tuple[str, ...],
    known: KnownColumns,
) -> tuple[str, str]:
    """Return what else may be the channel, and options; empty where nothing may."""
    runs = numbered_columns(names)
    others = [run for run in runs if channel_of(run.pattern) == channel]
    others.sort(key=lambda run: doubt(channel, run.pattern))
    own = own_names(names) if channel == "position" else ()
    if channel == "position_command":
        lone = [p.text for p in _lone_commands(names, joints, known)]
        if len(lone) > 1:
            each = " or ".join(f"--position-command {shlex.quote(t)}" for t in lone)
            return f" Several may be it: {each}", ""
    in_groups = _by_numbers(log, names, joints, known, arrays_of_a_group)
    if in_groups is not None:
        return in_groups
    if channel == "position" and (named := _advice_by_unit(channel, names, joints)):
        return named
    as_many = len(own) >= max(map(len, others), default=0)
    if len(own) > 1 and as_many and not set(own) <= set(joints):
        return mapping_advice(own, joints), mapping_option(own, joints)
    if others and len(others[0]) > len(joints) and known.names is None:
        return _of_more_columns(log, runs, others[0], channel, joints, known)
    if others:
        number, rows = len(others[0]), known.rows
        more = _of_another_number(f"{others[0]} are", number, joints, rows)
        return more, _locked(number, joints, rows)
    if channel == "torque":
        torque = _advice_on_torque(names, joints, known)
        if torque is not None:
            return torque
    if found := _by_numbers(log, names, joints, known, unknown_columns):
        return found
    if channel == "torque":
        return f" {WITHOUT_TORQUE}", ""
    if not any(joint in name for joint in joints for name in names):
        return " If the log has other names of joints: --names NAME=JOINT ...", ""
    return "", ""


def _advice_by_unit(
    channel: str, names: Sequence[str], joints: Sequence[str]
) -> tuple[str, str] | None:
    """Return what may be a channel by its unit alone, and the option if it is one."""
    named = of_unit(channel, names, joints)
    if not named:
        return None
    said = f" Only the unit says that {' or '.join(named)} may be it"
    first = next(iter(named.values()))
    if channel == "position" and not name_patterns("velocity", names, joints):
        # Found later, it would be left out, as it may be a motor's or a fan's.
        speeds = [*of_unit("velocity", names, joints).values()]
        first = " ".join([first, *speeds[: len(speeds) == 1]])
    return f"{said}: if so: {first}", first if len(named) == 1 else ""


def _advice_on_torque(
    names: Sequence[str],
    joints: tuple[str, ...],
    known: KnownColumns,
) -> tuple[str, str] | None:
    """Return what may take the place of torque, and options; None where nothing may.

    Motor currents, a controller's state, commands of drives with known gains, or the
    only columns whose names say nothing known.
    """
    of_commands = f"--gains {GAINS} --bodies model"
    if currents := name_patterns("current", names, joints):
        more = (
            f" {currents[0].text} are motor currents: convert them to torque with "
            f"the N m per ampere of each joint, gear ratio included: --torque-gain "
            f"NUMBER ...{_of_controllers(names, joints)}"
        )
        return more, ""
    if of_controllers := _of_controllers(names, joints):
        return of_controllers, ""
    if named := _advice_by_unit("torque", names, joints):
        return named
    alone = KnownColumns(joints)
    if commands := candidates("position_command", names, joints, alone):
        more = (
            f" {WITHOUT_TORQUE} Or let the gains of the drives (N m/rad, N m s/rad) "
            f"make torque of the commands in {commands[0].text}: --gains KP,KD[,LIMIT] "
            "... --bodies model; consistent-id rollout ROBOT LOG with the same options "
            "then replays the log and fits the drives"
        )
        return more, of_commands
    if stated := known.channels.get("position_command"):
        more = (
            f" The gains of the drives make torque of the commands in {stated}: "
            "--gains KP,KD[,LIMIT] ..."
        )
        return more, of_commands
    return torque_if(names, joints, placed="position" in known.channels)


def _of_more_columns(
    log: Path,
    runs: Sequence[NumberedColumns],
    more: NumberedColumns,
    channel: str,
    joints: tuple[str, ...],
    known: KnownColumns,
) -> tuple[str, str]:
    """Return a sentence and options for numbered columns of more than the joints.

    Another channel with a column for each joint says which numbers are theirs.
    """
    said = _of_another_number(f"{more} are", len(more), joints, known.rows)
    of_channel = {c: [r for r in runs if channel_of(r.pattern) == c] for c in CHANNELS}
    likely = {channel: more}
    if channel == "position":
        for other in CHANNELS[1:]:
            as_many = [run for run in of_channel[other] if len(run) == len(more)]
            sure = [run for run in as_many if doubt(other, run.pattern) < DOUBTFUL]
            if sure:
                likely[other] = sure[0]
    every = [run for several in of_channel.values() for run in several]
    exact = [run for run in every if len(run) == len(joints)]
    numbers = {(run.first, run.last) for run in exact}
    if len(numbers) == 1:
        ((first, last),) = numbers
        part = first - more.first, last + 1 - more.first
        if part[0] < 0 or last > more.last:
            return said, ""
        as_in = f" {exact[0]} have the numbers of the joints"
    else:
        as_in = " If the joints are those of a part of them"
        try:
            part = moving_part(log, more, len(joints))
        except RecordingError:  # such as empty cells
            return said, ""
    number = part[1] - part[0]
    options = " ".join(run.option_of_part(c, *part) for c, run in likely.items())
    if number < len(joints):
        options = f"{_locked(number, joints, known.rows)} {options}".strip()
    return f"{said}{as_in}: {options}", options


def _by_numbers(
    log: Path,
    names: Sequence[str],
    joints: tuple[str, ...],
    known: KnownColumns,
    search: Callable[..., UnknownColumns | None],
) -> tuple[str, str] | None:
    """Return a sentence and options for columns that names alone do not show."""
    if known.names is not None:
        return None
    fewer = range(len(joints) - 1, 1, -1) if known.rows is None else sorted(known.rows)
    numbers = [len(joints), *(n for n in sorted(fewer)[::-1] if 1 < n < len(joints))]
    found = search(log, names, numbers, known.channels)
    if found is None:
        return None
    if found.joints == len(joints):
        return found.sentence, found.options
    lock = _locked(found.joints, joints, known.rows)
    return f"{found.sentence}, with {lock}", f"{lock} {found.options}"


def _of_controllers(names: Sequence[str], joints: Sequence[str]) -> str:
    """Return a sentence on torques that a controller computes; empty of none."""
    for run in numbered_columns(names):
        said = words(run.pattern)
        if len(run) == len(joints) and {"target", "moment"} <= said:
            return (
                f" {run} are computed by the controller, not measured: they return the "
                f"maker's own model of the arm ({run.option('torque')})"
            )
    return ""


def require_width(
    log: Path,
    name: str,
    joints: Sequence[str],
    names: Sequence[str],
    known: KnownColumns,
) -> None:
    """Refuse an array that has columns of fewer or more joints."""
    array = np.asarray(read_whole(log, [name])[name])
    if array.ndim != 2 or not array.size or len(joints) in array.shape:
        return
    samples, number = upright(array).shape
    options = _locked(number, joints, known.rows)
    more = _of_another_number("These are", number, joints, known.rows)
    if number > len(joints):
        said, options = _part_of_wide(log, samples, names, tuple(joints), known)
        more += said
    raise RecordingError(
        f"{log}: array {name!r} has shape {array.shape}.{more}", options=options
    )


def _part_of_wide(
    log: Path,
    samples: int,
    names: Sequence[str],
    joints: tuple[str, ...],
    known: KnownColumns,
) -> tuple[str, str]:
    """Return a sentence and options for the robot's joints in arrays of more columns.

    No options if it is open which columns are theirs.
    """
    wide: dict[str, tuple[str, np.ndarray]] = {}
    for channel in ("position", "velocity", known.effort):
        arrays = [p.text for p in candidates(channel, names, joints, known)]
        read = read_whole(log, arrays) if arrays else {}
        for name in arrays[::-1]:
            if np.ndim(read[name]) == 2 and samples in np.shape(read[name]):
                rows = read[name] if len(read[name]) == samples else read[name].T
                wide[channel] = name, np.asarray(rows)
    values = {channel: rows for channel, (_, rows) in wide.items()}
    parts = joints_of_wide(values, len(joints))
    sure = [part for part in parts.values() if part is not None]
    number = sure[0][1] - sure[0][0] if sure else len(joints)

    def options_of(at_end: bool) -> str:
        said = [_locked(number, joints, known.rows)] * (number < len(joints))
        for channel, part in parts.items():
            name, rows = wide[channel]
            start = rows.shape[1] - number if at_end else 0
            first, end = part or (start, start + number)
            of_name = shlex.quote(f"{name}[{first}:{end}]")
            said.append(f"--{channel.replace('_', '-')} {of_name}")
        return " ".join(said)

    options = options_of(at_end=False)
    if len(sure) == len(parts):
        return f" If the joints are those of a part of them: {options}", options
    last = options_of(at_end=True)
    return f" If the joints are the first of them: {options}; if the last: {last}", ""


def _likely(
    number: int,
    joints: Sequence[str],
    rows: Mapping[int, Sequence[Sequence[str]]] | None,
) -> Sequence[Sequence[str]]:
    """Return the joints that a log of so many may have, the likeliest first."""
    return (joints[:number],) if rows is None else rows.get(number, ())


def _locked(
    number: int,
    joints: Sequence[str],
    rows: Mapping[int, Sequence[Sequence[str]]] | None,
) -> str:
    """Return the option that locks joints which a log does not have; empty if open."""
    if number > len(joints):
        return ""
    moved, *_ = _likely(number, joints, rows) or ((),)
    rest = [joint for joint in joints if joint not in moved]
    return f"--lock {shlex.join(rest)}" if moved else ""


def _of_another_number(
    what: str,
    number: int,
    joints: Sequence[str],
    rows: Mapping[int, Sequence[Sequence[str]]] | None,
) -> str:
    """Return advice if a log has columns of another number of joints."""
    said = f" {what} {number} columns, the robot has {len(joints)} joints that move"
    if number > len(joints):
        return f"{said}."
    ends = [f"{row[0]} to {row[-1]}" for row in _likely(number, joints, rows)]
    if not ends:
        return (
            f"{said}: name the joints at rest: --lock JOINT ... (or --base, --tip LINK)"
        )
    lock = _locked(number, joints, rows)
    also = ", ".join(f"those from {pair}" for pair in ends[1:])
    also = f" ({also} explain the torque as well)" if also else ""
    return f"{said}: if the log has those from {ends[0]}{also}, lock the others: {lock}"
