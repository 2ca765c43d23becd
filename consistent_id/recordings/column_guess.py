"""Which columns of a log are a robot's positions, velocities and torques: a guess.

A name is taken for a joint's channel if it holds the joint's name or number and a word
for the channel, such as ``q``, ``pos`` or ``effort``.  Commands are never taken, motor
currents neither: how much torque an ampere is, no log says.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from consistent_id.errors import ProblemError, RecordingError
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers.columns import JOINT_STATE, Columns
from consistent_id.recordings.readers.recording_file import column_names
from consistent_id.recordings.recording import COMMANDS
from consistent_id.robot.parameters import did_you_mean

_WORDS = {
    "position": {"q", "pos", "position", "positions", "angle", "angles"},
    "velocity": {"dq", "qd", "qdot", "vel", "velocity", "velocities"},
    "torque": {"tau", "trq", "torque", "torques", "effort", "efforts"},
}
_CURRENT = {"current", "currents", "amp", "amps", "ampere", "amperes", "i", "iq"}
_TIME = ("time", "t", "timestamp", "stamp", "time_s", "t_s", "seconds", "sec")
_NOT_MEASURED = {"target", "desired", "des", "cmd", "command", "commanded", "ref"}
_NOT_MEASURED |= {"reference", "setpoint", "goal"}
_COMMANDS = frozenset(_NOT_MEASURED)
_TOLD = {f"{short}{word}" for short in ("q", "pos", "p") for word in _COMMANDS}
_NOT_MEASURED |= {"error", "limit"}


@dataclass(frozen=True, slots=True)
class ColumnGuess:
    """A log's columns, as far as they could be found.

    Parameters
    ----------
    columns : Columns
    joints : tuple of str
        The robot's joints that the log has positions of.
    notes : tuple of str
        What was chosen between.
    """

    columns: Columns
    joints: tuple[str, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _Pattern:
    text: str
    joints: tuple[str, ...]  # of the robot, that the log has such a column of
    names: tuple[tuple[str, str], ...] = ()  # the log's name of a joint, the robot's


def guess_columns(
    log: Path,
    joints: Sequence[str],
    known: Mapping[str, str] | None = None,
    *,
    torque_joints: Sequence[str] = (),
    commands: bool = False,
) -> ColumnGuess:
    """Find a log's columns.

    Parameters
    ----------
    log : Path
    joints : sequence of str
        The robot's.
    known : mapping of str to str, optional
        Columns by channel, as in `Columns`; the others are found in the log.
    torque_joints : sequence of str
        Joints whose torque the log has, if that is known.
    commands : bool
        Whether commands of position are wanted in place of torque.

    Raises
    ------
    RecordingError
        If positions or torques cannot be found; with what the log has instead.
    """
    joints, known = tuple(joints), dict(known or {})
    _require_channels(known)
    bag = log_format(log).holds == "joint states"
    usual = replace(JOINT_STATE if bag else Columns(), torque_joints=torque_joints)
    found, notes = replace(usual, **cast(dict[str, Any], known)), list[str]()
    effort = "position_command" if commands else "torque"
    if bag or {"time", "position", effort} <= set(known):
        return ColumnGuess(found, joints)
    names = column_names(log)
    if "time" not in known:
        found = replace(found, time=_time(log, names))
    moved = joints
    for channel in ("position", "velocity", effort):
        if channel in known:
            continue
        patterns = _patterns(channel, names, moved)
        if channel == "velocity":
            patterns = [p for p in patterns if p.joints == moved]
            if not patterns:
                continue
        if not patterns:
            raise _not_found(log, channel, names, joints)
        best, *others = patterns
        found = _with(found, channel, best)
        if channel == "position":
            moved = best.joints
        elif channel == "torque" and best.joints != moved and not torque_joints:
            found = replace(found, torque_joints=best.joints)
        if also := [p.text for p in others if len(p.joints) == len(best.joints)]:
            notes.append(
                f"{channel} is taken from {best.text}, not from {', '.join(also)}"
            )
    return ColumnGuess(found, moved, tuple(notes))


def require_torque(pattern: str | None, torque_gain: Sequence[float]) -> None:
    """Refuse motor currents as torque, if no gain makes torque of them.

    Parameters
    ----------
    pattern : str, optional
        Name of the torque's columns.
    torque_gain : sequence of float
        As it was given; empty if it was not.

    Raises
    ------
    RecordingError
        If the name says current and not torque, and there is no gain.
    """
    words = _words(pattern or "")
    if words & _CURRENT and not words & _WORDS["torque"] and not len(torque_gain):
        raise RecordingError(
            f"torque is taken from {pattern}, which is named as a current, without a "
            "gain. Give the N m per ampere of each joint, gear ratio included: "
            "--torque-gain (torque_gain); 1 if these columns are torques in N m"
        )


def _require_channels(known: Mapping[str, str]) -> None:
    channels = ("time", "position", "velocity", "torque", *COMMANDS)
    for name in known:
        if name not in channels:
            raise ProblemError(
                f"columns: no channel {name!r}; {did_you_mean(name, channels)}"
            )


def _with(columns: Columns, channel: str, pattern: _Pattern) -> Columns:
    given: dict[str, Any] = {channel: pattern.text}
    if pattern.names:
        given["names"] = dict(pattern.names)
    return replace(columns, **given)


def _time(log: Path, names: Sequence[str]) -> str:
    for word in _TIME:
        for name in names:
            if name.lower() == word:
                return name
    raise RecordingError(
        f"{log}: no column is named {' or '.join(_TIME[:3])}; the log has "
        f"{_shown(names)}. Say which it is: --time"
    )


def _patterns(
    channel: str, names: Sequence[str], joints: Sequence[str]
) -> list[_Pattern]:
    """Return all patterns of a channel's columns, the most fitting first."""
    found: dict[str, _Pattern] = {}
    for name in names:
        for pattern in _by_name(name, names, joints) + _by_number(name, names, joints):
            if _means(pattern.text, channel):
                found.setdefault(pattern.text, pattern)
    return sorted(
        found.values(),
        key=lambda p: (-len(p.joints), "{joint}" not in p.text, len(p.text)),
    )


def _by_name(name: str, names: Sequence[str], joints: Sequence[str]) -> list[_Pattern]:
    # Of joint_1 and joint_10, the longer name is the one that is meant.
    inside = max((j for j in joints if j in name), key=len, default=None)
    if inside is None or "{" in name:
        return []
    text = name.replace(inside, "{joint}")
    present = tuple(j for j in joints if text.replace("{joint}", j) in names)
    return [_Pattern(text, present)] if present else []


def _by_number(
    name: str, names: Sequence[str], joints: Sequence[str]
) -> list[_Pattern]:
    patterns = []
    for found in re.finditer(r"\d+", name):
        before, after = name[: found.start()], name[found.end() :]
        if found[0] not in ("0", "1") or "{" in name:
            continue
        numbers = [str(i + int(found[0])) for i in range(len(joints))]
        if not all(before + number + after in names for number in numbers):
            continue
        if found[0] == "1":
            if before + "0" + after not in names:
                patterns.append(_Pattern(f"{before}{{number}}{after}", tuple(joints)))
        elif before + str(len(joints)) + after not in names:
            text = f"{before}{{joint}}{after}"
            pairs = tuple(zip(numbers, joints, strict=True))
            patterns.append(_Pattern(text, tuple(joints), pairs))
    return patterns


def _means(pattern: str, channel: str) -> bool:
    """Return whether a pattern has a word for the channel beside the joint."""
    words = _words(pattern)
    if channel == "position_command":
        return bool(words & _TOLD or (words & _COMMANDS and words & _WORDS["position"]))
    return bool(words & _WORDS[channel]) and not words & _NOT_MEASURED


def _words(pattern: str) -> set[str]:
    """Return the words of a pattern beside the joint, in lower case."""
    rest = re.sub(r"\{\w+\}", " ", pattern)
    return set(re.findall(r"[a-z]+", rest.lower()))


def _not_found(
    log: Path, channel: str, names: Sequence[str], joints: Sequence[str]
) -> RecordingError:
    examples = {"position": "q_{joint}", "torque": "tau_{joint}"}
    example = examples.get(channel, "qdes_{joint}")
    more = ""
    if channel == "torque" and any("current" in n.lower() for n in names):
        more = (
            " Motor currents become torque by a factor: name them with --torque, and "
            "give the N m per ampere with --torque-gain."
        )
    flag = channel.replace("_", "-")
    return RecordingError(
        f"{log}: found no column that is the {channel} of {_shown(joints)}; the "
        f"log has {_shown(names)}. Say which: --{flag} {example}, or with "
        f"{{number}} for the joint's place from 1.{more}"
    )


def _shown(names: Sequence[str], most: int = 12) -> str:
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")
