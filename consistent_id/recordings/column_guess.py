"""A guess of a log's columns for a robot's positions, velocities and torques.

A name counts as a joint's channel if it contains the joint's name or number and a word
for the channel, such as ``q``, ``pos`` or ``effort``; an array of all joints has the
word alone.  Six names that differ by a number are one pattern, ``q{1..6}``.  Commands
are used if they are requested instead of torque, motor currents only with a gain,
because no log contains the torque per ampere.

A log whose torque has another clock than its position is refused.  Such a clock has a
part of its channel's name, as ``tau_time`` beside ``tau1`` or ``drive/time`` beside
``drive/torque``.  Its samples are not those of the positions, even if they are as many.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from consistent_id.errors import RecordingError
from consistent_id.recordings.column_marks import ordered_patterns
from consistent_id.recordings.column_names import (
    DOUBTFUL,
    NamePattern,
    doubt,
    is_of_another_only,
    shown,
)
from consistent_id.recordings.column_proposals import (
    WITHOUT_TORQUE,
    KnownColumns,
    candidates,
    not_found,
    require_width,
)
from consistent_id.recordings.column_words import (
    CHANNELS,
    channel_of,
    is_bare,
    is_lone_command,
    says_unit_of,
    unit_of,
)
from consistent_id.recordings.commented_order import require_commented_order
from consistent_id.recordings.log_formats import TABLES, has_no_arrays, log_format
from consistent_id.recordings.mixed_columns import (
    require_one_torque,
    rivals,
)
from consistent_id.recordings.own_names import mapping_advice, mapping_option
from consistent_id.recordings.readers.columns import JOINT_STATE, Columns
from consistent_id.recordings.readers.csv_header import lacks_names
from consistent_id.recordings.readers.data_frames import ColumnTable
from consistent_id.recordings.readers.recording_file import (
    column_names,
    read_whole,
    reader_of,
)
from consistent_id.recordings.readers.table_folder import require_one_run
from consistent_id.recordings.readers.units import KNOWN, SI, is_time, listed_names
from consistent_id.recordings.recording import COMMANDS
from consistent_id.recordings.unknown_columns import (
    unread_array,
    unread_speed,
    unread_velocity,
)
from consistent_id.recordings.unnamed_columns import (
    array_order,
    clock_column,
    listed_joints,
    readable,
    rises,
    without_names,
)

_WORD = r"(?:time|timestamps?|stamp|clock|t|ts|zeit)"
_BEFORE = re.compile(rf"{_WORD}[_./ ]+(?P<stem>.+)", re.IGNORECASE)
_AFTER = re.compile(rf"(?P<stem>.+)[_./ ]+{_WORD}", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class ColumnGuess:
    """The columns of a log that were found.

    Parameters
    ----------
    joints : tuple of str
        The robot's joints that the log has positions of.
    notes : tuple of str
        The choices that were made, in words.
    topic : str, optional
        The topic with joint states of the robot, if a ROS bag has several.
    """

    columns: Columns
    joints: tuple[str, ...]
    notes: tuple[str, ...] = ()
    topic: str | None = None


def guess_columns(log: Path, known: KnownColumns) -> ColumnGuess:
    """Find a log's columns and their units.

    Raises
    ------
    RecordingError
        If positions or torques cannot be found; with the log's columns.
    """
    bag = known.names is None and log_format(log).holds == "joint states"
    usual = replace(
        JOINT_STATE if bag else known.arrays or Columns(),
        torque_joints=known.torque_joints,
        units=known.units or {},
    )
    found = replace(usual, **cast(dict[str, Any], dict(known.channels)))
    if not bag and known.names is None:
        found = _with_arrays(log, found, known)
    if bag:
        return _of_messages(log, found, known)
    if {"time", "position", known.effort} <= set(known.channels):
        return _in_units(ColumnGuess(found, known.joints))
    if known.arrays is not None:
        given = ((c, getattr(known.arrays, c)) for c in CHANNELS)
        of_arrays = {c: name for c, name in given if name is not None}
        known = replace(known, channels=of_arrays | dict(known.channels))
    return _in_units(_searched(log, found, known))


def _with_arrays(log: Path, found: Columns, known: KnownColumns) -> Columns:
    """Add the joints of arrays, if a stated channel is one and not a pattern."""
    stated = [known.channels[c] for c in known.channels if c != "time"]
    arrays = [name for name in stated if "{" not in name]
    if found.array_joints or len(known.joints) < 2 or not arrays:
        return found
    names = column_names(log)
    if has_no_arrays(log, names):
        return found
    return replace(found, array_joints=array_order(log, names, known.joints))


def _searched(log: Path, found: Columns, known: KnownColumns) -> ColumnGuess:
    """Find the channels that are not known among a log's columns."""
    notes, in_file = list[str](), known.names is None
    names = column_names(log) if known.names is None else known.names
    if in_file and lacks_names(names):
        raise without_names(log, names, known.joints, known.channels, known.rows)
    flat = _is_flat(log, names, known)
    known = replace(known, flat=flat)
    names = [name for name in names if name not in known.taken]
    if "time" not in known.channels:
        found = replace(found, time=clock_column(log, names, in_file=in_file))
    ordered = in_file and known.arrays is None
    listed: tuple[str, ...] = ()
    if ordered and not flat and "position" not in known.channels:
        known, listed = _with_listed_joints(log, names, known)
    moved = known.joints
    chosen: dict[str, NamePattern] = {}
    for channel in ("position", "velocity", known.effort):
        if channel in known.channels:
            continue
        search = partial(
            ordered_patterns, channel, moved=moved, found=found, known=known
        )
        patterns = search(names)
        if in_file:
            patterns, more = _in_file(log, channel, names, search, len(listed or moved))
            notes += more
        if not patterns and channel == "velocity":
            notes += unread_velocity(names, moved)
            continue
        if not patterns:
            raise not_found(log, channel, names, moved, known)
        best, *others = patterns
        if channel == "velocity" and is_of_another_only(best.text, found.position):
            notes.append(unread_speed(best.text))
            continue
        if in_file and best.is_array and channel == "position":
            require_width(log, best.text, listed or moved, names, known)
        found, chosen[channel] = _with(found, channel, best), best
        if channel == "position":
            moved = best.joints
        elif channel == "torque" and best.joints != moved and not known.torque_joints:
            require_one_torque(log, best, others, moved, names)
            found = replace(found, torque_joints=best.joints)
        notes += _choice_notes(channel, best, others)
    if in_file:
        _require_one_recording(log, chosen, moved, found, known)
    if ordered and found.array_joints:
        order = listed or array_order(log, names, tuple(found.array_joints))
        found = replace(found, array_joints=order)
    return ColumnGuess(found, moved, tuple(notes))


def _is_flat(log: Path, names: Sequence[str], known: KnownColumns) -> bool:
    """Return whether a log of several joints has a column of each, and no arrays."""
    if len(known.joints) < 2:
        return False
    return known.flat or (known.names is None and has_no_arrays(log, names))


def _require_one_recording(
    log: Path,
    chosen: Mapping[str, NamePattern],
    joints: Sequence[str],
    found: Columns,
    known: KnownColumns,
) -> None:
    """Refuse another order of joints, several clocks, or several runs."""
    require_commented_order(log, chosen, joints)
    require_one_clock(log, column_names(log), found)
    if log_format(log) is TABLES and "position" not in known.channels:
        channels = (found.position, getattr(found, known.effort))
        require_one_run(log, [pattern for pattern in channels if pattern])


def _in_file(
    log: Path,
    channel: str,
    names: Sequence[str],
    search: Callable[[Sequence[str]], list[NamePattern]],
    joints: int,
) -> tuple[list[NamePattern], list[str]]:
    """Return the patterns whose arrays may be of the joints, by their numbers.

    A velocity or torque is no array of another width first, such as an angular velocity
    in space, or the torque of a tool.  Beside them, a note on a velocity that is left
    out; an only torque is refused where it is read.
    """
    if channel == "position":
        return _with_motion(log, search(names), joints), []
    left, first = list(names), search(names)
    found = first
    while found and found[0].is_array:
        array = np.asarray(readable(log, [found[0].text]).get(found[0].text, ()))
        if joints in array.shape or (array.ndim == 1 and joints == 1) or not array.size:
            break
        left.remove(found[0].text)
        found = search(left)
    if channel != "velocity":
        return _with_motion(log, found or first, joints), []
    notes = [unread_array(p.text) for p in first[:1] if not found]
    return _with_motion(log, found, joints), notes


def _choice_notes(
    channel: str, best: NamePattern, others: Sequence[NamePattern]
) -> list[str]:
    """Return notes on what a pattern is, and on others that are not read."""
    notes = []
    if best.units:
        each = map(" in ".join, zip(best.joints, best.units, strict=True))
        notes.append(f"{channel} is read from {best.text}: {', '.join(each)}")
    if len(each_name := listed_names(best.text)) > 1:
        notes.append(f"{channel} is read from {', '.join(each_name)}")
    is_doubtful = doubt(channel, best.text) >= DOUBTFUL
    only_bare = is_bare(best.text) and not channel_of(best.text)
    lone = channel == "position_command" and is_lone_command(best.text)
    if is_doubtful or only_bare or lone or says_unit_of(channel, best.text):
        notes.append(f"{best.text} is taken as the {channel}: no other column is")
    if also := rivals(best, others):
        notes.append(f"{channel} is read from {best.text}, not from {also}")
    return notes


def _with_listed_joints(
    log: Path, names: Sequence[str], known: KnownColumns
) -> tuple[KnownColumns, tuple[str, ...]]:
    """Return the joints that arrays have, and their order, if a list beside names them.

    The list may lack some of the robot's joints, and have others, such as a gripper's.
    """
    patterns = candidates("position", names, known.joints, known)
    arrays = [p.text for p in patterns if p.is_array]
    listed = listed_joints(log, names, known.joints) if arrays else ()
    read = read_whole(log, arrays) if listed else {}
    if not any(len(listed) in np.shape(values) for values in read.values()):
        return known, ()
    here = tuple(joint for joint in known.joints if joint in listed)
    return replace(known, joints=here), listed


def _of_messages(log: Path, found: Columns, known: KnownColumns) -> ColumnGuess:
    """Return the fields and joints that a topic of joint states has."""
    joints = known.joints
    chosen = reader_of(log).chosen_topic(log, known.topic, joints)
    named = tuple(joint for joint in joints if joint in chosen.joints)
    if not named:
        raise RecordingError(
            f"{log}: topic {chosen.name} names no joint of {shown(joints)}."
            f"{mapping_advice(chosen.joints, joints)}",
            options=mapping_option(chosen.joints, joints),
        )
    notes = []
    if chosen.others:
        others = ", ".join(chosen.others)
        notes.append(f"joint states are read from {chosen.name}, not from {others}")
    has_torque = "torque" in known.channels or "effort" in chosen.fields
    if not has_torque and not known.torque_joints:
        if chosen.with_effort:
            option = f"--topic {chosen.with_effort[0]}"
            raise RecordingError(
                f"{log}: topic {chosen.name} has no effort of {shown(named)}, but "
                f"{', '.join(chosen.with_effort)} has: {option}",
                options=option,
            )
        raise RecordingError(
            f"{log}: topic {chosen.name} has no effort of {shown(named)}. "
            f"{WITHOUT_TORQUE} --torque-joints JOINT ... if it has that of some joints"
        )
    if "velocity" not in known.channels and "velocity" not in chosen.fields:
        found = replace(found, velocity=None)
        notes.append(f"{chosen.name} has no velocity of every joint: it is not read")
    topic = chosen.name if chosen.others else known.topic
    return ColumnGuess(found, named, tuple(notes), topic)


def _in_units(guess: ColumnGuess) -> ColumnGuess:
    """Add the units that the columns' names state, where none was given."""
    columns, notes = guess.columns, list(guess.notes)
    for channel in ("time", *CHANNELS, *COMMANDS):
        name = getattr(columns, channel)
        if name is None or channel in columns.units:
            continue
        units = [unit_of(channel, one) for one in listed_names(name)]
        if len(set(units)) > 1:
            each = tuple(unit or SI[channel] for unit in units)
            columns = replace(columns, units={**columns.units, channel: each})
        elif (unit := units[0]) in KNOWN[channel]:
            columns = replace(columns, units={**columns.units, channel: unit})
            notes.append(f"{channel} is in {unit}, according to {name}")
    return replace(guess, columns=columns, notes=tuple(notes))


def _with(columns: Columns, channel: str, pattern: NamePattern) -> Columns:
    given: dict[str, Any] = {channel: pattern.text}
    if pattern.names:
        given["names"] = dict(pattern.names)
    if pattern.is_array:
        given["array_joints"] = pattern.joints
    if pattern.units:
        given["units"] = {**columns.units, channel: pattern.units}
    return replace(columns, **given)


def _with_motion(
    log: Path, patterns: Sequence[NamePattern], joints: int
) -> list[NamePattern]:
    """Return the arrays that are of all joints, and in which most joints are not zero.

    All patterns, if some are no arrays.
    """
    arrays = [p.text for p in patterns if p.is_array]
    if len(arrays) < 2 or len(arrays) < len(patterns):
        return list(patterns)
    read = read_whole(log, arrays)
    empty = {name: _empty_joints(read[name], joints) for name in arrays}
    return [p for p in patterns if empty[p.text] == min(empty.values())]


def _empty_joints(values: np.ndarray, joints: int) -> int:
    """Return the number of an array's joints that are zero throughout, or missing."""
    numbers = np.asarray(values)
    if (
        numbers.dtype.kind not in "iuf"
        or numbers.ndim != 2
        or joints not in numbers.shape
    ):
        return joints + 1
    upright = numbers if numbers.shape[1] == joints else numbers.T
    return int((upright == 0.0).all(axis=0).sum())


def stem_of_clock(name: str) -> str:
    """Return the channel or group in the name of a clock; empty of none.

    Examples
    --------
    >>> stem_of_clock("t_tau"), stem_of_clock("drive/time"), stem_of_clock("time")
    ('tau', 'drive', '')
    """
    found = _AFTER.fullmatch(name) or _BEFORE.fullmatch(name)
    return "" if found is None or is_time(found["stem"]) else found["stem"]


def own_clock(column: str, clocks: Sequence[str]) -> str | None:
    """Return the clock whose name has the beginning of a column's, if one has.

    Examples
    --------
    >>> own_clock("q{number}", ["time", "t_q", "t_tau"])
    't_q'
    """
    owned = [
        name
        for name in clocks
        if (stem := stem_of_clock(name))
        and re.match(rf"{re.escape(stem)}(?![a-zA-Z])", column, re.IGNORECASE)
    ]
    return max(owned, key=len, default=None)


def require_one_clock(
    log: Path,
    names: Sequence[str],
    found: Columns,
    table: ColumnTable | None = None,
) -> None:
    """Refuse a log whose torques or velocities have another clock than its positions.

    Two clocks are compared only where one of them is the time of the recording.

    Parameters
    ----------
    names : sequence of str
        All columns of the log.
    found : Columns
        Those that are read.
    table : ColumnTable, optional
        The log, if it is in memory; the path stands for it.

    Raises
    ------
    RecordingError
        With a form of the log that is read.
    """
    clocks = [name for name in names if stem_of_clock(name)]
    position, time = found.position, found.time
    if len(clocks) < 2 or position is None:
        return
    first = own_clock(position, clocks)
    for channel in ("velocity", "torque"):
        column = getattr(found, channel)
        other = None if column is None else own_clock(column, clocks)
        if first is None or other in (None, first) or time not in (first, other):
            continue
        rows = {
            clock: next((n for n in names if own_clock(n, clocks) == clock != n), clock)
            for clock in (first, other)
        }
        if _differ(log, rows, table):
            raise RecordingError(
                f"{log}: the position has the clock {first}, the {channel} {other}, "
                "and their times differ. A table has one clock: write each of these "
                "channels with its clock into a table of its own, and give their "
                "folder, which is read as one recording on the slower clock. If all "
                f"rows are of {time} nevertheless, state the columns, too: --time "
                f"{time} --position {position} --{channel} {column}"
            )


def _differ(log: Path, arrays: Mapping[str, str], table: ColumnTable | None) -> bool:
    """Return whether two columns are clocks with other times.

    Parameters
    ----------
    arrays : mapping of str to str
        An array that has a row for each value of a clock.
    table : ColumnTable, optional
        As of `require_one_clock`.
    """
    names = list(dict.fromkeys([*arrays, *arrays.values()]))
    try:
        read = {name: np.asarray(values) for name, values in _read(log, names, table)}
    except RecordingError:  # texts, or faults that are found when the log is read
        return False
    clocks = [read[name].reshape(-1) for name in arrays]
    shapes = [read[name].shape for name in arrays.values()]
    for clock, shape in zip(clocks, shapes, strict=True):
        if clock.dtype.kind not in "iuf" or len(clock) not in shape:
            return False
    if len(clocks[0]) != len(clocks[1]):
        return all(map(rises, clocks))
    both = np.isfinite(clocks[0]) & np.isfinite(clocks[1])
    one, two = (clock[both] for clock in clocks)
    return rises(one) and rises(two) and not np.array_equal(one, two)


def _read(
    log: Path, names: Sequence[str], table: ColumnTable | None
) -> Iterator[tuple[str, object]]:
    if table is not None:
        return ((name, table[name]) for name in names)
    lenient = {"missing": "omit"} if log_format(log).is_text else {}
    return iter(reader_of(log).read_arrays(log, names, **lenient).items())
