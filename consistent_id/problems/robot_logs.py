"""Logs of a robot that has no problem file: its joints, their columns and units."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from consistent_id.errors import ModelError, ProblemError, RecordingError
from consistent_id.problems.floating.floating_columns import (
    FloatingColumns,
    base_in_log,
    floating_columns,
)
from consistent_id.problems.floating.hints import BaseHints, require_floating
from consistent_id.problems.wrench_note import wrench_note, wrenches_in_log
from consistent_id.recordings.column_guess import (
    ColumnGuess,
    guess_columns,
    require_torque,
)
from consistent_id.recordings.log_formats import LOG_FORMATS
from consistent_id.recordings.readers import Columns, read_recording, recording_from
from consistent_id.recordings.readers.data_frames import ColumnTable, table_names
from consistent_id.recordings.readers.units import Units
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains
from consistent_id.robot.chains import Selection
from consistent_id.robot.limbs import base_question
from consistent_id.robot.loaders import load_robot
from consistent_id.robot.model import RobotModel

_ROBOTS = (".urdf", ".xml", ".mjcf", ".xacro")


@dataclass(frozen=True, slots=True, eq=False)
class RobotLogs:
    """A robot, and how its logs are read.

    Parameters
    ----------
    robot : RobotModel
        With the joints that the logs have.
    locked : dict of str to float
        Joints that do not move, and where they are held [rad or m].
    gain : float or list of float
        From the torque columns to torque.
    notes : tuple of str
        What was guessed.
    gains : PDGains, optional
        Of PD-controlled joints.
    floating : FloatingColumns, optional
        How the base moves, if it floats.
    tables : mapping of Path to ColumnTable
        Logs in memory, by the paths that stand for them.
    """

    robot: RobotModel
    columns: Columns
    locked: dict[str, float]
    gain: float | list[float]
    notes: tuple[str, ...]
    gains: PDGains | None = None
    floating: FloatingColumns | None = None
    tables: Mapping[Path, ColumnTable] = field(default_factory=dict)

    def read(self, log: Path) -> Recording:
        """Read a log as it was written; `with_torque` makes torque of its commands."""
        if log in self.tables:
            return recording_from(
                self.tables[log],
                self.robot.joint_names,
                self.columns,
                torque_gain=self.gain,
                name=log.name,
            )
        return read_recording(
            log, self.robot.joint_names, self.columns, torque_gain=self.gain
        )


def robot_logs(
    model: Path,
    log: Path,
    *,
    tables: Mapping[Path, ColumnTable] | None = None,
    columns: Mapping[str, str] | None = None,
    units: Units | None = None,
    torque_joints: Sequence[str] = (),
    selection: Selection | None = None,
    torque_gain: Sequence[float] = (),
    gains: PDGains | None = None,
    base: BaseHints | None = None,
) -> RobotLogs:
    """Find out how a robot's logs are to be read.

    Parameters
    ----------
    model : Path
        URDF or MJCF.
    log : Path
        One of the logs; the others have the same columns.
    tables : mapping of Path to ColumnTable, optional
        Logs in memory, by the paths that stand for them.
    columns, units, torque_joints
        As far as they are known; see `guess_columns`.
    selection : Selection, optional
        The part of the robot that moves; of its joints, those that the log does not
        have are locked.
    torque_gain : sequence of float
        From the torque columns to torque: one for all joints, or one each.
    gains : PDGains, optional
        Of PD-controlled joints: commands of position are wanted in place of torque.
    base : BaseHints, optional
        What is known of the columns of a floating base.

    Raises
    ------
    ModelError, RecordingError
        If a file cannot be read, or columns cannot be guessed.
    ProblemError
        If the two files seem to be exchanged, or the gains are too many or too few.
    """
    tables = tables or {}
    if log not in tables:
        _require_order(model, log)
    selection = Selection() if selection is None else selection
    robot = load_robot(model, **asdict(selection))
    hints = base or BaseHints()
    require_floating(hints, floating=robot.floating)
    if log in tables:
        _require_fixed(robot)
    else:
        _require_base(model, log, robot, selection)
    floating = floating_columns(log, robot, model, hints) if robot.floating else None
    names = table_names(tables[log], log.name) if log in tables else None
    wrenches = wrenches_in_log(log, names)
    felt = wrench_note(wrenches, robot)
    others = () if floating is None else floating.taken
    guess = _guessed(
        felt,
        log,
        robot.joint_names,
        columns,
        names=names,
        taken=(*others, *(name for one in wrenches for name in one.names)),
        arrays=_arrays(floating),
        torque_joints=torque_joints,
        units=units,
        currents=len(torque_gain) > 0,
        commands=gains is not None,
        held=_every_joint(model, selection),
        chains=chains_of(robot),
    )
    require_torque(guess.columns.torque, torque_gain)
    robot, locked = _without_absent(model, robot, selection, guess.joints)
    gain = gains_of(torque_gain, len(robot.joint_names))
    kept = (f"{path} stands for a table in memory" for path in tables)
    found, notes = guess.columns, (*guess.notes, *kept, *[felt] * bool(felt))
    if floating is not None:
        found = replace(found, beside=floating.beside)
        notes = (*notes, *floating.notes)
    return RobotLogs(robot, found, locked, gain, notes, gains, floating, tables)


def _without_absent(
    model: Path, robot: RobotModel, selection: Selection, joints: Collection[str]
) -> tuple[RobotModel, dict[str, float]]:
    """Return the robot without joints that the log does not have, and the locked."""
    absent = [name for name in robot.joint_names if name not in joints]
    locked = dict(selection.locked or {}) | dict.fromkeys(absent, 0.0)
    if absent:
        robot = load_robot(model, **asdict(replace(selection, locked=locked)))
    return robot, locked


def _guessed(felt: str, *logged: Any, **known: Any) -> ColumnGuess:
    """Guess columns; where that fails, say what else the log has."""
    try:
        return guess_columns(*logged, **known)
    except RecordingError as cause:
        raise RecordingError(f"{cause} {felt}".strip()) from None


def _arrays(floating: FloatingColumns | None) -> Columns | None:
    """Return the joints' columns in arrays of MuJoCo, if the log has these."""
    if floating is None or not floating.joints.columns:
        return None
    arrays = floating.joints
    named = arrays.columns
    return Columns(
        position=named["position"],
        velocity=named.get("velocity"),
        torque=named.get("torque"),
        array_joints=arrays.array_joints,
    )


def _require_fixed(robot: RobotModel) -> None:
    if robot.floating:
        raise ProblemError(
            "the log is a table in memory and the base floats; write the table to a "
            "file, in which columns of the base are found by their names"
        )


def _require_base(
    model: Path, log: Path, robot: RobotModel, selection: Selection
) -> None:
    """Refuse a robot on legs whose base is taken for fixed, though its log moves it."""
    if selection.base is not None or not base_question(robot):
        return
    moved = [str(found) for found in base_in_log(log)]
    if moved:
        raise ProblemError(
            f"several limbs hang on the base of {model}, and {log} says how a base "
            f"moves ({'; '.join(moved[:3])}). Does it move? Then say --base floating. "
            "If it hangs still, or is bolted down, say --base ROOT with the name of "
            "the link that stands still"
        )


def chains_of(robot: RobotModel) -> dict[int, tuple[str, ...]] | None:
    """Return the only chain of so many joints from the base on, by their number.

    None, if the robot has no branches: the first joints are one chain then.
    """
    driven = set(robot.joint_names)
    chains: list[tuple[str, ...]] = []
    for joint in robot.joints:
        before = chains[joint.parent] if joint.parent >= 0 else ()
        chains.append((*before, joint.name) if joint.name in driven else before)
    if len(max(chains, key=len)) == len(driven):
        return None
    numbers = [len(chain) for chain in dict.fromkeys(chains)]
    return {len(c): c for c in chains if c and numbers.count(len(c)) == 1}


def _every_joint(model: Path, selection: Selection) -> tuple[str, ...]:
    """Return the names of all joints, if some of them are locked."""
    if not selection.locked:
        return ()
    return load_robot(model, **asdict(replace(selection, locked=None))).joint_names


def gains_of(given: Sequence[float], joints: int) -> list[float] | float:
    """Return gains as `read_recording` takes them: one for all joints, or one each.

    Raises
    ------
    ProblemError
        If their number is neither.
    """
    if len(given) not in (0, 1, joints):
        raise ProblemError(
            f"{len(given)} torque gains for {joints} joints, expected one or {joints}"
        )
    return list(given) if len(given) == joints else (*given, 1.0)[0]


def _require_order(model: Path, log: Path) -> None:
    """Refuse a log in the place of the robot, and the robot in that of a log."""
    suffixes = {suffix for known in LOG_FORMATS for suffix in known.suffixes}
    first, second = model.suffix.lower(), log.suffix.lower()
    if first in suffixes and second in _ROBOTS:
        raise ProblemError(
            f"{model} is a log and {log} a robot: the robot comes first: {log} {model}"
        )
    if first in suffixes:
        raise ModelError(
            f"{model} is a log, expected a robot (URDF or MJCF) before {log}"
        )
    if first == ".toml":
        raise ProblemError(
            f"{model} is a problem file, which names its own recordings: leave {log} "
            "out, or put the robot's URDF or MJCF file in its place"
        )
    if second in _ROBOTS:
        raise ProblemError(f"{log} is a robot, expected a log after {model}")
