"""Joints that a log locks by what it lacks, or the user by a statement, and move.

A joint without a column of the position is locked.  A joint that moves in the log is
then another robot: its column was forgotten, or the statement is wrong.  A light one,
such as a gripper, may be stated to be locked.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id._support.tables import some_of
from consistent_id.errors import RecordingError
from consistent_id.recordings.column_guess import ColumnGuess
from consistent_id.recordings.column_names import (
    NamePattern,
    columns_of_pattern,
    name_patterns,
    shown,
)
from consistent_id.recordings.column_proposals import KnownColumns, candidates
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers import Columns, read_recording, recording_from
from consistent_id.recordings.readers.columns import wanted
from consistent_id.recordings.readers.data_frames import ColumnTable
from consistent_id.recordings.readers.recording_file import column_names
from consistent_id.robot.model import RobotModel

_MOVES = 0.05  # rad or m; play and creep of a locked joint are below
_LIGHT = 0.1  # of the robot's mass: what a locked joint may move


def require_positions(log: Path, guess: ColumnGuess, known: KnownColumns) -> None:
    """Refuse a log that has torque or velocity of a joint, but not its position.

    Parameters
    ----------
    log : Path
    guess : ColumnGuess
    known : KnownColumns
        As the columns were guessed.

    Raises
    ------
    RecordingError
        With the joint, the column that was seen, and what to do.
    """
    absent = [joint for joint in known.joints if joint not in guess.joints]
    names = _names(log, known)
    if not absent or not names:
        return
    for channel in (known.effort, "velocity"):
        of_joint = _further_columns(channel, log, names, guess, known)
        seen = {joint: of_joint[joint] for joint in absent if joint in of_joint}
        if not seen:
            continue
        joints, columns = some_of(list(seen)), some_of(list(seen.values()))
        first = next(iter(seen))
        said = channel.replace("_", " ")
        positions = wanted(guess.columns, guess.joints, str(log)).columns["position"]
        raise RecordingError(
            f"{log}: has the {said} of {joints} ({columns}), but no position of it; "
            f"the positions are {shown(positions)}. Without its position a joint "
            "would be locked at zero, and its motion would count as that of the "
            f"others. Add the position of {first} to the log, or name its column like "
            f"the others. If {first} stood still, state it: --lock {first}, or "
            f"--lock {first}=POSITION in rad or m"
        )


def locked_notes(
    log: Path,
    guess: ColumnGuess,
    known: KnownColumns,
    locked: Mapping[str, float],
    table: ColumnTable | None,
    unlocked: RobotModel,
) -> tuple[str, ...]:
    """Return notes on joints that are locked elsewhere than they stand in a log.

    A joint that moves is noted, too, if it moves little of the robot's mass.

    Parameters
    ----------
    log : Path
    guess : ColumnGuess
    known : KnownColumns
        As the columns were guessed.
    locked : mapping of str to float
        Joints that the user locked, and their positions [rad or m].
    table : ColumnTable, optional
        The log, if it is in memory.
    unlocked : RobotModel
        The robot with all of its joints.

    Raises
    ------
    RecordingError
        If a locked joint moves in the log, and a tenth of the robot's mass with it;
        with its travel.
    """
    names, notes, moving = _names(log, known), list[str](), list[str]()
    for joint, stated in locked.items():
        column = _locked_column(joint, log, names, guess, known)
        if column is None:
            continue
        try:
            position = _position(log, joint, guess.columns, column, table)
        except RecordingError:  # nobody can tell: the column has texts or gaps
            continue
        travel, place = float(np.ptp(position)), float(np.median(position))
        if travel > _MOVES:
            moving.append(joint)
            share = _moved_share(unlocked, moving)
            if share is None or share > _LIGHT:
                raise _moving(log, moving, column, travel, share)
            notes.append(
                f"{joint} is locked at {stated:g} rad or m, as stated, but moves by "
                f"{travel:.3g} in {log.name} (column {column}); the motion of "
                f"{share:.0%} of the robot's mass counts as that of the others"
            )
            continue
        if abs(place - stated) > _MOVES:
            notes.append(
                f"{joint} is locked at {stated:g} rad or m, as stated, but stands at "
                f"{place:.3g} in {log.name}: --lock {joint}={place:.3g}"
            )
    return tuple(notes)


def _moving(
    log: Path, joints: Sequence[str], column: str, travel: float, share: float | None
) -> RecordingError:
    *others, joint = joints
    mass = "an unknown share" if share is None else f"{share:.0%}"
    also = f" and {some_of(others)}, which move, too" if others else ""
    return RecordingError(
        f"--lock {joint}: {joint} moves by {travel:.3g} rad or m in {log} (column "
        f"{column}), and {mass} of the robot's mass with it{also}; locked joints may "
        f"move by {_MOVES:g} at most, or {_LIGHT:.0%} of the mass. Leave it out of "
        "--lock, or write the rows in which it stands still into a log of their own"
    )


def _moved_share(robot: RobotModel, joints: Sequence[str]) -> float | None:
    """Return the share of the robot's mass that joints move; None if not known."""
    known = robot.nominal
    if known is None or not set(joints) <= set(robot.joint_names):
        return None
    masses = known.reshape(-1, 10)[:, 0]
    moved = np.array([one.name in joints for one in robot.joints])
    for k, one in enumerate(robot.joints):
        moved[k] |= one.parent >= 0 and moved[one.parent]
    whole = float(masses.sum())
    return float(masses[moved].sum()) / whole if whole > 0.0 else None


def _names(log: Path, known: KnownColumns) -> Sequence[str]:
    """Return the names of a table's columns; none of arrays and messages."""
    if known.names is not None:
        return known.names
    form = log_format(log)
    if form.holds == "joint states" or not form.lists_names:
        return ()
    return column_names(log)


def _further_columns(
    channel: str,
    log: Path,
    names: Sequence[str],
    guess: ColumnGuess,
    known: KnownColumns,
) -> dict[str, str]:
    """Return columns of a channel by joint: of the pattern that the guess follows."""
    if channel == known.effort:
        patterns = candidates(channel, names, known.joints, known)
    else:
        patterns = name_patterns(channel, names, known.joints, known.all_joints)
    return _followed(channel, log, patterns, guess)


def _locked_column(
    joint: str,
    log: Path,
    names: Sequence[str],
    guess: ColumnGuess,
    known: KnownColumns,
) -> str | None:
    """Return the column of a locked joint's position, if the log has it.

    Numbers may count all joints, or those of the log and this one.
    """
    every = known.all_joints
    with_it = tuple(j for j in every if j == joint or j in guess.joints)
    for joints in (every, with_it) if names else ():
        patterns = name_patterns("position", names, joints, every)
        found = _followed("position", log, patterns, guess)
        if joint in found:
            return found[joint]
    return None


def _followed(
    channel: str, log: Path, patterns: Sequence[NamePattern], guess: ColumnGuess
) -> dict[str, str]:
    """Return the columns by joint of the pattern that has all columns of a guess."""
    own = wanted(guess.columns, guess.joints, str(log)).columns.get(channel, ())
    read = {j: name for j, name in zip(guess.joints, own, strict=False) if name}
    for pattern in patterns:
        if not pattern.is_array:
            columns = columns_of_pattern(pattern)
            found = dict(zip(pattern.joints, columns, strict=True))
            if read and read.items() <= found.items():
                return found
    return {}


def _position(
    log: Path, joint: str, columns: Columns, column: str, table: ColumnTable | None
) -> Matrix:
    """Read one joint's position, whatever the log lacks besides."""
    units = {c: u for c, u in columns.units.items() if c == "time"}
    unit = columns.units.get("position")
    if isinstance(unit, str):
        units["position"] = unit
    name = column.replace("{", "{{").replace("}", "}}")
    only = Columns(columns.time, name, units=units)
    how: dict[str, Any] = {"duplicates": "first", "missing": "omit"}
    if table is None:
        return read_recording(log, [joint], only, **how).position
    return recording_from(table, [joint], only, name=log.name, **how).position
