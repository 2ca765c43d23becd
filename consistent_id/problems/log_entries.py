"""Logs and drives in a problem file: columns, rows, gains, calibration."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import msgspec
import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.tables import Table
from consistent_id.constraints import Constraint
from consistent_id.errors import ProblemError
from consistent_id.problems.file import DataTable, GainsTable, RecordingTable
from consistent_id.problems.task_tables import beside_columns
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers.columns import JOINT_STATE, Columns
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import unwrapped
from consistent_id.recordings.signals.drive_torque import (
    DriveCalibration,
    PDGains,
    calibrated,
)
from consistent_id.recordings.signals.end_velocities import with_end_velocities
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.parameters import require_known

if TYPE_CHECKING:
    from consistent_id.estimation.delayed_commands import CommandDelay
    from consistent_id.estimation.drive_calibration import CalibrationFit
    from consistent_id.estimation.transmission_springs import JointSprings


def span_of(raw: Recording, entry: RecordingTable) -> tuple[float, float]:
    """Return the times of the first and the last used row [s].

    Raises
    ------
    ProblemError
        If the log has no such rows.
    """
    rows = rows_of(entry)
    if rows is None:
        return -np.inf, np.inf
    require_rows(raw.name, entry, len(raw))
    first, last = rows
    return float(raw.time[first]), float(raw.time[last])


_MOTION = (
    "position",
    "velocity",
    "acceleration",
    "position_command",
    "velocity_command",
)


def motion_of_joints(
    recording: Recording,
    *,
    wraps: Literal["keep", "undo"] | None,
    scale: Mapping[str, float] | None,
    offset: Mapping[str, float] | None,
    coupled: Mapping[str, str] | None,
) -> Recording:
    """Return the motion of the robot's joints from that of a log's columns.

    Whole turns are undone first; then scale and offset change each column, and coupled
    ones are taken apart.  Torques stay as they are.  First and last velocities that
    lack a difference of positions get one, see `with_end_velocities`.

    Parameters
    ----------
    wraps : {"keep", "undo"}
        Whether jumps of the position by whole turns are undone.
    scale : mapping of str to float
        Factors of the position, velocity, acceleration and commands of joints.
    offset : mapping of str to float
        Added to the position and its command afterwards [rad or m].
    coupled : mapping of str to str
        See `uncoupled`.

    Raises
    ------
    ProblemError
        If there is no such joint, or a scale is zero.
    """
    raw = unwrapped(recording) if wraps == "undo" else recording
    factors = _of_each("position_scale", scale, raw.joints, 1.0)
    if not factors.all():
        raise ProblemError(f"position_scale: {dict(scale or {})}, expected none zero")
    added = _of_each("position_offset", offset, raw.joints, 0.0)
    if scale or offset:
        known = {name: getattr(raw, name) for name in _MOTION}
        moved = {n: value * factors for n, value in known.items() if value is not None}
        for name in moved.keys() & {"position", "position_command"}:
            moved[name] = moved[name] + added
        raw = replace(raw, **moved)
    return with_end_velocities(uncoupled(raw, coupled or {}))


def _of_each(
    name: str, given: Mapping[str, float] | None, joints: Sequence[str], usual: float
) -> Vector:
    """Return a value for each joint, the usual one where none is given."""
    values = dict(given or {})
    require_known(values, joints, f"{name}: no joint")
    if not np.isfinite(list(values.values())).all():
        raise ProblemError(f"{name}: {values}, expected finite numbers")
    return np.array([values.get(joint, usual) for joint in joints])


def uncoupled(recording: Recording, coupled: Mapping[str, str]) -> Recording:
    """Return the motion of the joints of a log that has sums of two of them.

    Positions, velocities, accelerations and commands are changed.  Torques are not:
    each drive acts at its own joint.

    Parameters
    ----------
    coupled : mapping of str to str
        ``{"J3": "J2"}``: the log's J3 is the position of J3 plus that of J2;
        ``{"J3": "-J2"}``: less that of J2.

    Raises
    ------
    ProblemError
        If there is no such joint.

    Examples
    --------
    >>> log = Recording(("J2", "J3"), [0.0, 1.0], [[0.1, 0.3], [0.2, 0.5]])
    >>> uncoupled(log, {"J3": "J2"}).position[:, 1].round(3).tolist()
    [0.2, 0.3]
    """
    places, signs = list(recording.joints), np.eye(len(recording.joints))
    for joint, word in coupled.items():
        other = word.removeprefix("-")
        require_known([joint, other], places, f"coupled {joint} = {word!r}: no joint")
        if other in coupled or joint == other:
            raise ProblemError(
                f"coupled: {other} is to be the position of one joint, for {joint}"
            )
        sign = -1.0 if word.startswith("-") else 1.0
        signs[places.index(joint), places.index(other)] = sign
    if not coupled:
        return recording
    back = np.linalg.inv(signs).T
    known = {name: getattr(recording, name) for name in _MOTION}
    moved = {name: value @ back for name, value in known.items() if value is not None}
    return replace(recording, **moved)


def rows_of(entry: RecordingTable) -> tuple[int, int] | None:
    """Return the first and the last used row, from 0, without omitted ones.

    None, if all rows are used.
    """
    if entry.rows is None:
        return None
    first, last = entry.rows
    omitted = set(entry.omit)
    return (
        first - 1 - sum(row < first for row in omitted),
        last - 1 - sum(row <= last for row in omitted),
    )


def require_rows(name: str, entry: RecordingTable, left: int) -> None:
    """Refuse rows that a log does not have.

    Parameters
    ----------
    left : int
        Rows of the log that are not omitted.

    Raises
    ------
    ProblemError
        The message states the rows.
    """
    rows = left + len(set(entry.omit))
    if entry.rows is None:
        return
    first, last = entry.rows
    if not 1 <= first < last <= rows:
        raise ProblemError(f"{name}: rows {first} to {last}, but the file has {rows}")


def gains_table(
    gains: PDGains,
    delay: float | Literal["estimated"] = 0.0,
    delay_error: float = 0.0,
) -> GainsTable:
    """Return gains, the delay of commands and its standard error [s], of a file."""
    limit = gains.torque_limit
    return GainsTable(
        kp=gains.kp.tolist(),
        kd=gains.kd.tolist(),
        torque_limit=limit.tolist() if np.isfinite(limit).any() else None,
        delay=delay,
        delay_error=delay_error,
    )


def gains_of_drives(data: DataTable) -> PDGains | None:
    """Return the gains of PD-controlled joints, if the file states any.

    Raises
    ------
    ProblemError
        If there are gains and no column of commands, or both gains and torque.
    """
    if data.gains is None:
        return None
    columns = data.columns
    if columns is None or columns.position_command is None:
        raise ProblemError(
            "[data.gains] need commands, but [data.columns] names no position_command"
        )
    if columns.torque is not None:
        raise ProblemError(
            f"[data.columns] names a torque, {columns.torque}, and [data.gains] "
            f"compute one from commands; leave one of them out"
        )
    if data.gains.delay == "estimated" and data.gains.delay_error:
        raise ProblemError(
            f"[data.gains] has delay_error = {data.gains.delay_error:g}, but delay = "
            '"estimated", which is found with its error; leave one of them out'
        )
    limit = data.gains.torque_limit
    return PDGains(
        np.array(data.gains.kp),
        np.array(data.gains.kd),
        np.array(np.inf if limit is None else limit),
    )


def drive_limits(gains: PDGains | None, joints: Sequence[str]) -> dict[str, float]:
    """Return the torque limits of drives that follow commands, [N m or N]."""
    if gains is None:
        return {}
    limits = gains.of(joints).torque_limit.tolist()
    return dict(zip(joints, limits, strict=True))


def with_torque(
    raw: Recording,
    gains: PDGains | None,
    calibration: DriveCalibration | None = None,
) -> Recording:
    """Return a log with the torque of its commands, if there are gains.

    The measured velocity is then left out: the computed torque contains it, and noise
    in both motion and torque would bias estimates.

    Parameters
    ----------
    gains : PDGains, optional
        Stated gains.
    """
    if gains is None:
        return raw
    known = DriveCalibration() if calibration is None else calibration
    return replace(calibrated(raw, gains, known), velocity=None)


def columns_of(data: DataTable, file: Path) -> Columns:
    """Return the names of a recording's columns; by default those of its format."""
    usual = JOINT_STATE if log_format(file).holds == "joint states" else Columns()
    named = {} if data.columns is None else msgspec.structs.asdict(data.columns)
    return replace(
        usual,
        **named,
        torque_joints=data.torque_joints,
        units=data.units,
        beside=beside_columns(data.base, data.contacts, data.wrenches),
    )


Prepared = Callable[[DriveCalibration], Sequence[Recording]]


@dataclass(frozen=True, slots=True, eq=False)
class FoundDrives:
    """Gains and calibration of PD-controlled joints, as stated or found in the data.

    Parameters
    ----------
    gains : PDGains, optional
        The real gains: the stated ones, times the scale.
    delay : CommandDelay, optional
        The scan of the delay, if it is to be found.
    fit : CalibrationFit, optional
        If scales or biases are to be found, and the delay with them.
    springs : JointSprings, optional
        If springs between motors and links are to be found.
    """

    gains: PDGains | None = None
    calibration: DriveCalibration = DriveCalibration()  # noqa: RUF009  frozen
    delay: "CommandDelay | None" = None
    fit: "CalibrationFit | None" = None
    springs: "JointSprings | None" = None

    def tables(self) -> list[Table]:
        """Return the estimated values as tables; none if nothing was estimated."""
        found = (self.fit or self.delay, self.springs)
        return [one.table() for one in found if one is not None]


def found_drives(
    data: DataTable | None,
    model: TorqueModel,
    constraints: Sequence[Constraint],
    prepared: Prepared,
    groups: Sequence[Sequence[str]] = (),
) -> FoundDrives:
    """Return gains and calibration, estimated from the data where the file says so.

    Parameters
    ----------
    prepared : callable
        From a calibration to the training recordings, prepared.
    groups : sequence of sequence of str
        Joints of equal motors.

    Raises
    ------
    ProblemError, RecordingError
        If the file or its recordings cannot be used.
    """
    from consistent_id.estimation.delayed_commands import command_delay
    from consistent_id.estimation.drive_calibration import UNKNOWNS, fit_calibration
    from consistent_id.estimation.transmission_springs import joint_springs

    gains = None if data is None else gains_of_drives(data)
    if data is None or data.gains is None or gains is None:
        return FoundDrives()
    asked = [name for name in UNKNOWNS if getattr(data.gains, name) == "estimated"]
    known, late, fit = _stated(data.gains), None, None
    if "delay" in asked:
        start = known
        late = command_delay(
            model,
            lambda delay: prepared(replace(start, delay=delay)),
            constraints=constraints,
        )
        known = replace(known, delay=late.seconds, delay_error=late.bounded_error)
    if set(asked) - {"delay"}:
        fit = fit_calibration(
            model, prepared, asked, start=known, constraints=constraints
        )
        known = replace(
            fit.calibration,
            compliance=known.compliance,
            delay_error=fit.delay_error if "delay" in asked else known.delay_error,
        )
    springs = None
    if data.gains.stiffness == "estimated":
        springs = joint_springs(
            model, prepared(known), groups=groups, constraints=constraints
        )
        known = replace(known, compliance=springs.compliance)
    return FoundDrives(known.gains(gains), known, late, fit, springs)


def _stated(table: GainsTable) -> DriveCalibration:
    """Return stated values of drives and encoders; ideal ones where none are."""
    unstated = table.stiffness is None or table.stiffness == "estimated"
    return DriveCalibration(
        0.0 if table.delay == "estimated" else float(table.delay),
        np.array(1.0 if table.scale == "estimated" else table.scale),
        np.array(0.0 if table.encoder_bias == "estimated" else table.encoder_bias),
        1.0 / np.array(np.inf if unstated else table.stiffness),
        delay_error=table.delay_error,
    )
