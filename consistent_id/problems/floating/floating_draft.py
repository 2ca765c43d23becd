"""The floating base in a draft: its columns, contacts, legs, rotors, slip."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from consistent_id.problems.file import DriveTable
from consistent_id.problems.floating.base_guess import (
    BaseGuess,
    BaseSamples,
    MujocoArrays,
    base_frames,
    chosen_names,
    completed_guess,
    frames_on_base,
    mujoco_arrays,
    widths_of,
)
from consistent_id.problems.floating.contact_guess import (
    SLIP,
    ContactGuess,
    feet_of,
    guessed_contacts,
    require_standing,
    share_at_rest,
    stated_contacts,
)
from consistent_id.problems.statement import Statement
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers.beside_columns import BaseColumns, BesideColumns
from consistent_id.recordings.readers.named_arrays import read_parts, stored_name
from consistent_id.recordings.readers.recording_file import column_names, reader_of
from consistent_id.recordings.readers.units import is_time
from consistent_id.recordings.readers.used_rows import UsedRows
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.sensor_words import BaseNames, BaseRole, base_names
from consistent_id.robot.loaders.mjcf_spec import read_spec
from consistent_id.robot.loaders.robot_file import is_mjcf
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

# Share of the samples that must keep rows when slipping feet are removed.
_ENOUGH = 0.25


@dataclass(frozen=True, slots=True)
class FloatingColumns:
    """Channels of a log beside the joints, and their effect on the joints' columns.

    Parameters
    ----------
    joints : MujocoArrays
        Columns of the joints, if the log has arrays of MuJoCo.
    taken : tuple of str
        Names that belong to no joint.
    standing : bool
        Whether feet are assumed to stand all the time, which must be checked.
    names : tuple of str
        Names of the log, for messages.
    """

    beside: BesideColumns
    joints: MujocoArrays
    taken: tuple[str, ...]
    notes: tuple[str, ...]
    standing: bool
    names: tuple[str, ...]


def floating_columns(
    log: Path, robot: RobotModel, model: Path, stated: Statement
) -> FloatingColumns:
    """Find columns of the base and of contacts in a log.

    Parameters
    ----------
    robot : RobotModel
        A robot with a floating base.
    model : Path
        File of the robot.
    stated : Statement
        The user's statement.

    Raises
    ------
    RecordingError
        If the base's motion or its quaternion's order cannot be found; with the option
        that states it.
    """
    names, widths, found = _named(log)
    arrays = MujocoArrays()
    if "qpos" in widths:
        arrays = mujoco_arrays(model, robot.joint_names, widths)
        found = (*arrays.base, *found)
    guess = chosen_names(found, stated, log, names)
    said = stated.quaternion is not None or _is_bag(log)
    ordered = said or guess.columns.orientation in {b.names for b in found if b.order}
    imu = stated.imu or (arrays.imu if _from_simulation(guess, arrays) else None)
    guess = completed_guess(
        guess,
        _samples(log, guess.columns, robot, stated),
        frames_on_base(robot, base_frames(model)),
        imu,
        ordered=ordered,
    )
    contacts = _contacts(stated, names, robot, model, guess.columns)
    return FloatingColumns(
        BesideColumns(guess.columns, contacts.columns),
        arrays,
        tuple(stored_name(name) for each in found for name in _listed(each)),
        (*guess.notes, *contacts.notes),
        contacts.assumed,
        names,
    )


def base_in_log(log: Path) -> tuple[BaseNames, ...]:
    """Return names in a log that may belong to a moving base; () if there are none."""
    if not log_format(log).lists_names and not _is_bag(log):
        return ()
    return _named(log)[2]


def _named(log: Path) -> tuple[tuple[str, ...], dict[str, int], tuple[BaseNames, ...]]:
    """Return a log's names, the widths of its arrays, and names of the base."""
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


def _samples(
    log: Path, columns: BaseColumns, robot: RobotModel, stated: Statement
) -> BaseSamples:
    """Read the samples of the base's columns."""
    if _is_bag(log):
        joints = (*robot.joint_names, *(stated.names or {}))
        arrays, time = _of_topics(log, columns, stated.topic, joints)
    else:
        names = column_names(log) if log_format(log).lists_names else ()
        clock = next((name for name in names if is_time(name)), None)
        omit = stated.omitted_of(log)
        named = [*columns.names, *([clock] if clock else [])]
        read = read_parts(reader_of(log), log, named, UsedRows(omit))
        samples = max(map(len, read.values()))
        kept = np.delete(
            np.arange(samples), [row - 1 for row in omit if row <= samples]
        )
        arrays = {n: a[kept] if len(a) == samples else a for n, a in read.items()}
        time = np.asarray(arrays[clock] if clock else (), dtype=np.float64).reshape(-1)
    rows = len(time) or max(max(np.shape(a)) for a in arrays.values())
    time = time if len(time) else np.arange(rows, dtype=np.float64)
    return BaseSamples(arrays, time, str(log))


def _of_topics(
    log: Path, columns: BaseColumns, topic: str | None, joints: Sequence[str]
) -> tuple[dict[str, NDArray[Any]], NDArray[np.float64]]:
    """Return the signals of topics, cut to the length of the shortest."""
    content = reader_of(log).read_messages(log, topic, columns.names, joints)
    signals = content.signals
    rows = min(len(signal.values) for signal in signals.values())
    arrays = {name: signal.values[:rows] for name, signal in signals.items()}
    times = next(iter(signals.values())).log_times[:rows]
    return arrays, (times - times[0]) / 1e9


def _contacts(
    stated: Statement,
    names: Sequence[str],
    robot: RobotModel,
    model: Path,
    base: BaseColumns,
) -> ContactGuess:
    feet = feet_of(robot, model)
    if stated.contacts is None:
        found = guessed_contacts(names, feet)
    else:
        found = stated_contacts(dict(stated.contacts), feet, robot)
    if base.orientation is not None:
        return found
    rolling = [contact for contact in found.columns if contact.radius > 0.0]
    if not rolling:
        return found
    note = "feet are assumed to be points: balls that roll need the base's orientation"
    points = tuple(replace(contact, radius=0.0) for contact in found.columns)
    return replace(found, columns=points, notes=(*found.notes, note))


def _listed(found: BaseNames) -> tuple[str, ...]:
    return (found.names,) if isinstance(found.names, str) else found.names


@dataclass(frozen=True, slots=True)
class StandingDraft:
    """The settings of a draft for a floating base.

    Parameters
    ----------
    known_links : tuple of str
        Bodies that are taken from the model's file: all but the base.
    rotors : dict of str to float
        Rotor inertias of the model's file, by parameter [kg m^2].
    most_slip : float, optional, [m/s]
        The largest speed of feet that stand on the ground.
    rests : bool
        Whether torque of joints at rest is declared unknown.
    round_feet : bool
        Whether feet are balls, whose radius is found in the log.
    late_torque : bool
        Whether the delay of the torque is found in the log.
    """

    known_links: tuple[str, ...]
    rotors: dict[str, float] = field(hash=False)
    most_slip: float | None
    rests: bool
    round_feet: bool
    late_torque: bool

    @property
    def preparation(self) -> dict[str, Any]:
        """Keys of the table of preparation, beside the delay of the position."""
        keys: dict[str, Any] = {"most_slip": self.most_slip}
        if self.rests:
            keys["least_joint_speed"] = "estimated"
        if self.round_feet:
            keys["contact_radius"] = "estimated"
        return keys

    @property
    def comments(self) -> dict[str, str]:
        """Comments for a problem file, by key."""
        found = {
            "constraints.known_links": "GUESS: as in the file; on the ground they "
            "cannot be separated from the base",
            "data.base": "GUESS: columns, and place of the unit.",
            "data.contacts": "GUESS: contacts of feet; samples within guard [s] of a "
            "change are left out.",
            "data.preparation.most_slip": "m/s; feet that move faster slip",
            "data.preparation.least_joint_speed": "at rest, friction has any value "
            "that balances the joint",
            "data.preparation.contact_radius": "feet deform: their radius is "
            "estimated from the log",
            "data.preparation.delays.torque": "many drivers stamp a torque before it "
            "acts, which looks like inertia",
        }
        if self.rotors:
            found["constraints.fixed"] = "GUESS: armatures of the file"
        return found


def standing_draft(
    found: FloatingColumns,
    robot: RobotModel,
    raws: Sequence[Recording],
    model: Path,
    drive: DriveTable,
) -> StandingDraft:
    """Return the settings of a draft for a floating base.

    Parameters
    ----------
    found : FloatingColumns
        Columns of the robot's logs.
    raws : sequence of Recording
        Logs as they were read.
    model : Path
        The robot's file.
    drive : DriveTable
        Terms of all joints.

    Raises
    ------
    RecordingError
        If feet are assumed to stand all the time, and do not.
    """
    if found.standing:
        require_standing(robot, raws, found.names, model)
    contacts = len(found.beside.contacts)
    return StandingDraft(
        robot.link_names[1:],
        _armatures(robot, model) if drive.rotor_inertia else {},
        SLIP if contacts > 1 and share_at_rest(robot, raws) > _ENOUGH else None,
        contacts > 0,
        any(contact.radius > 0.0 for contact in found.beside.contacts),
        contacts > 0,
    )


def _armatures(robot: RobotModel, model: Path) -> dict[str, float]:
    """Return the rotor inertias that an MJCF file states; a URDF states none."""
    if not is_mjcf(model):
        return {}
    import mujoco

    compiled = read_spec(model, mujoco).compile()
    stated = {
        compiled.joint(j).name: float(compiled.dof_armature[compiled.jnt_dofadr[j]])
        for j in range(compiled.njnt)
    }
    return {
        f"{joint}.rotor_inertia": stated[joint]
        for joint in robot.joint_names
        if stated.get(joint, 0.0) > 0.0
    }
