"""Columns of servos' logs, found by words in their names."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from consistent_id.errors import RecordingError
from consistent_id.recordings.column_words import words
from consistent_id.recordings.readers.recording_file import column_names
from consistent_id.recordings.readers.units import named_clocks

_GOAL = {"goal", "target", "command", "commanded", "cmd", "action", "desired"}
_GOAL |= {"reference", "ref", "setpoint"}
_POSITION = {"position", "pos", "q", "angle", "state"}
_OTHER = {"velocity", "vel", "speed", "current", "acceleration", "error", "limit"}
_ROLES: Mapping[str, set[str]] = {
    "duty": {"duty", "pwm", "load"},
    "volts": {"volt", "volts", "voltage"},
    "temperature": {"temp", "temperature"},
    "enabled": {"enable", "enabled"},
    "time": {"time", "timestamp", "stamp", "t"},
}
ROLES = ("time", "position", "goal", "duty", "volts", "temperature", "enabled")
"""What the columns of a log may be."""

_SHARED = ("volts", "temperature", "enabled")  # one column may be that of all joints


def logged_joints(
    paths: Sequence[str | Path],
    joints: Sequence[str],
    columns: Mapping[str, str] | None = None,
) -> tuple[str, ...]:
    """Return the joints whose names the position columns of the first log have.

    All of them, if columns are numbered, or there is one joint.
    """
    stated = (columns or {}).get("position")
    if len(joints) == 1 or not paths:
        return tuple(joints)
    names = column_names(Path(paths[0]))
    if stated is not None:
        found = [j for j in joints if stated.replace("{joint}", j) in names]
        return tuple(found or joints)
    fitting = [name for name in names if _fits("position", words(name))]
    found = [j for j in joints if _columns_of(j, fitting, joints)]
    return tuple(found or joints)


def role_columns(
    file: Path, joints: Sequence[str], stated: Mapping[str, str]
) -> dict[str, list[str]]:
    """Return the columns of each role: one for each joint, or one time; none if open.

    Parameters
    ----------
    stated : mapping of str to str
        Columns by role; ``{joint}`` stands for a joint's name.

    Raises
    ------
    RecordingError
        If there is no time, position or goal, or a column has two meanings.
    """
    names = column_names(file)
    found: dict[str, list[str]] = {}
    for role in ROLES:
        if role in stated:
            given = [stated[role].replace("{joint}", joint) for joint in joints]
            found[role] = given[:1] if role == "time" else given
        else:
            found[role] = _found(role, names, joints)
        if not found[role] and role in ("time", "position", "goal"):
            raise RecordingError(
                f"{file}: no column is the {role} of {', '.join(joints)}; its columns "
                f"are {', '.join(names)}; name it with --columns {role}=COLUMN"
            )
    _require_own_columns(file, found)
    return found


def _found(role: str, names: Sequence[str], joints: Sequence[str]) -> list[str]:
    """Return a column for each joint, or one for all; none if there are none."""
    fitting = [name for name in names if _fits(role, words(name))]
    if role == "time":
        return (named_clocks(names) or fitting)[:1]
    own = [_columns_of(joint, fitting, joints) for joint in joints]
    if len(joints) == 1:
        return (own[0] or fitting)[:1]
    if not all(own):
        own = [
            [name for name in fitting if _ends_with(name, number)]
            for number in range(1, len(joints) + 1)
        ]
    if all(own):
        return [of_joint[0] for of_joint in own]
    shared = role in _SHARED and len(fitting) == 1
    return fitting * len(joints) if shared else []


def _columns_of(joint: str, columns: Sequence[str], joints: Sequence[str]) -> list[str]:
    """Return the columns that name a joint, those with the fewest words first.

    A column that names a joint whose name contains this one's is not among them.
    """
    longer = [name for name in joints if name != joint and _names_joint(name, joint)]
    own = [
        column
        for column in columns
        if _names_joint(column, joint)
        and not any(_names_joint(column, name) for name in longer)
    ]
    return sorted(own, key=lambda column: len(words(column)))


def _names_joint(column: str, joint: str) -> bool:
    around = rf"(?<![A-Za-z0-9]){re.escape(joint)}(?![A-Za-z0-9])"
    return re.search(around, column, re.IGNORECASE) is not None


def _ends_with(column: str, number: int) -> bool:
    return re.search(rf"(?<!\d)0*{number}[\])]*$", column) is not None


def _require_own_columns(file: Path, found: Mapping[str, Sequence[str]]) -> None:
    """Refuse a column that has two meanings, or is the position of two joints."""
    seen: dict[str, str] = {}
    for role, given in found.items():
        for name in dict.fromkeys(given) if role in _SHARED else given:
            if name in seen:
                raise RecordingError(
                    f"{file}: column {name!r} would be {seen[name]} and {role} of "
                    "different joints or meanings; state the columns, such as "
                    f"--columns {role}={role}_{{joint}}"
                )
            seen[name] = role


def _fits(role: str, said: frozenset[str]) -> bool:
    if role == "position":
        return bool(said & _POSITION) and not said & (_GOAL | _OTHER)
    if role == "goal":
        return bool(said & _GOAL) and not said & _OTHER
    return bool(said & _ROLES[role]) and not said & _GOAL
