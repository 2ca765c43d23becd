"""All that a log has beside the joints of a floating robot: base, contacts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from consistent_id.problems.floating.base_guess import BaseGuess, chosen_names, settled
from consistent_id.problems.floating.contact_guess import (
    ContactGuess,
    guessed_contacts,
    stated_contacts,
)
from consistent_id.problems.floating.feet import feet_of
from consistent_id.problems.floating.hints import BaseHints
from consistent_id.problems.floating.mujoco_arrays import (
    MujocoArrays,
    base_frames,
    mujoco_arrays,
    widths_of,
)
from consistent_id.recordings.base_words import BaseNames, BaseRole, base_names
from consistent_id.recordings.clock_words import is_time
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers.array_parts import read_parts, stored_name
from consistent_id.recordings.readers.beside_columns import BaseColumns, BesideColumns
from consistent_id.recordings.readers.recording_file import column_names, reader_of
from consistent_id.robot.model import RobotModel

_TOPICS: Mapping[str, tuple[tuple[BaseRole, str], ...]] = {
    "sensor_msgs/msg/Imu": (
        ("angular_velocity", "angular_velocity"),
        ("acceleration", "linear_acceleration"),
    ),
    "nav_msgs/msg/Odometry": (
        ("position", "pose.pose.position"),
        ("orientation", "pose.pose.orientation"),
    ),
    "geometry_msgs/msg/PoseStamped": (
        ("position", "pose.position"),
        ("orientation", "pose.orientation"),
    ),
}
_ARRAYS = ("NPZ", "Parquet", "Feather")  # formats whose columns may be arrays


@dataclass(frozen=True, slots=True)
class FloatingColumns:
    """What a log has beside the joints, and what that says of the joints' columns.

    Parameters
    ----------
    joints : MujocoArrays
        Columns of the joints, if the log is of arrays of MuJoCo.
    taken : tuple of str
        Names that are of no joint.
    standing : bool
        Whether feet are taken to stand all the time, which is to be looked at.
    names : tuple of str
        The log's, for messages.
    """

    beside: BesideColumns
    joints: MujocoArrays
    taken: tuple[str, ...]
    notes: tuple[str, ...]
    standing: bool
    names: tuple[str, ...]


def floating_columns(
    log: Path, robot: RobotModel, model: Path, hints: BaseHints
) -> FloatingColumns:
    """Find columns of the base and of contacts in a log.

    Parameters
    ----------
    robot : RobotModel
        Whose base floats.
    model : Path
        Its file.
    hints : BaseHints
        What is known.

    Raises
    ------
    RecordingError
        If the base's motion cannot be found, or its quaternion's order; with the
        option that says it.
    """
    names, widths, found = _named(log)
    arrays = MujocoArrays()
    if "qpos" in widths:
        arrays = mujoco_arrays(model, robot.joint_names, widths)
        found = (*arrays.base, *found)
    guess = chosen_names(found, hints, log, names)
    said = hints.order is not None or _is_bag(log)
    ordered = said or guess.columns.orientation in {b.names for b in found if b.order}
    frames = base_frames(model)
    imu = hints.imu or (arrays.imu if _from_simulation(guess, arrays) else None)
    guess = _settled(log, guess, robot, replace(hints, imu=imu), frames, ordered)
    contacts = _contacts(hints, names, robot, model, guess.columns)
    return FloatingColumns(
        BesideColumns(guess.columns, contacts.columns),
        arrays,
        tuple(stored_name(name) for each in found for name in _listed(each)),
        (*guess.notes, *contacts.notes),
        contacts.assumed,
        names,
    )


def base_in_log(log: Path) -> tuple[BaseNames, ...]:
    """Return what a log has that may be of a moving base; () if it names nothing."""
    if not log_format(log).lists_names and not _is_bag(log):
        return ()
    return _named(log)[2]


def _named(log: Path) -> tuple[tuple[str, ...], dict[str, int], tuple[BaseNames, ...]]:
    """Return a log's names, the widths of its arrays, and which are of the base."""
    if _is_bag(log):
        kinds: dict[str, str] = reader_of(log).topic_kinds(log)
        found = [
            BaseNames(
                role, f"{topic}.{name}", "xyzw" if role == "orientation" else None
            )
            for topic, kind in kinds.items()
            for role, name in _TOPICS.get(kind, ())
        ]
        return tuple(kinds), {}, tuple(found)
    if not log_format(log).lists_names:
        return (), {}, ()
    names = column_names(log)
    widths = {}
    if log_format(log).name in _ARRAYS:
        widths = widths_of(reader_of(log).read_arrays(log, names))
    return names, widths, base_names(names, widths)


def _is_bag(log: Path) -> bool:
    return log_format(log).holds == "joint states"


def _from_simulation(guess: BaseGuess, arrays: MujocoArrays) -> bool:
    return guess.columns.acceleration in {each.names for each in arrays.base}


def _settled(
    log: Path,
    guess: BaseGuess,
    robot: RobotModel,
    hints: BaseHints,
    frames: Mapping[str, Any],
    ordered: bool,
) -> BaseGuess:
    """Return the guess with what the data say: order, gravity, the unit's place."""
    if _is_bag(log):
        arrays, time = _of_topics(log, guess.columns)
    else:
        wanted = guess.columns.names
        names = column_names(log) if log_format(log).lists_names else ()
        clock = next((name for name in names if is_time(name)), None)
        arrays = read_parts(reader_of(log), log, [*wanted, *([clock] if clock else [])])
        time = np.asarray(arrays[clock] if clock else (), dtype=np.float64).reshape(-1)
    rows = len(time) or max(max(np.shape(a)) for a in arrays.values())
    time = time if len(time) else np.arange(rows, dtype=np.float64)
    return settled(
        guess,
        arrays,
        time,
        robot,
        hints,
        frames=frames,
        ordered=ordered,
        where=str(log),
    )


def _of_topics(
    log: Path, columns: BaseColumns
) -> tuple[dict[str, NDArray[Any]], NDArray[np.float64]]:
    """Return what topics say, each by itself cut to the shortest."""
    signals = reader_of(log).read_messages(log, None, columns.names).signals
    rows = min(len(signal.values) for signal in signals.values())
    arrays = {name: signal.values[:rows] for name, signal in signals.items()}
    times = next(iter(signals.values())).log_times[:rows]
    return arrays, (times - times[0]) / 1e9


def _contacts(
    hints: BaseHints,
    names: Sequence[str],
    robot: RobotModel,
    model: Path,
    base: BaseColumns,
) -> ContactGuess:
    feet = feet_of(robot, model)
    if hints.contacts is None:
        found = guessed_contacts(names, feet)
    else:
        found = stated_contacts(dict(hints.contacts), feet, robot)
    if base.orientation is not None:
        return found
    rolling = [contact for contact in found.columns if contact.radius > 0.0]
    if not rolling:
        return found
    note = "feet are taken for points: how balls roll needs the base's orientation"
    points = tuple(replace(contact, radius=0.0) for contact in found.columns)
    return replace(found, columns=points, notes=(*found.notes, note))


def _listed(found: BaseNames) -> tuple[str, ...]:
    return (found.names,) if isinstance(found.names, str) else found.names
