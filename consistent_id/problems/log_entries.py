"""What a problem file says of its logs: columns, rows that count, gains of drives."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from consistent_id.errors import ProblemError
from consistent_id.problems.base_tables import beside_columns
from consistent_id.problems.file import DataTable, GainsTable, RecordingTable
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers import JOINT_STATE, Columns
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import DriveCalibration, PDGains, calibrated


def span_of(raw: Recording, entry: RecordingTable) -> tuple[float, float]:
    """Return the times of the first and the last row that count [s].

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


def rows_of(entry: RecordingTable) -> tuple[int, int] | None:
    """Return the first and the last row that count, from 0, omitted ones left out.

    None, if all rows count.
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
        With the rows.
    """
    rows = left + len(set(entry.omit))
    if entry.rows is None:
        return
    first, last = entry.rows
    if not 1 <= first < last <= rows:
        raise ProblemError(f"{name}: rows {first} to {last}, but the file has {rows}")


def gains_table(
    gains: PDGains, delay: float | Literal["estimated"] = 0.0
) -> GainsTable:
    """Return gains, and by how much commands are late [s], as a file has them."""
    limit = gains.torque_limit
    return GainsTable(
        kp=gains.kp.tolist(),
        kd=gains.kd.tolist(),
        torque_limit=limit.tolist() if np.isfinite(limit).any() else None,
        delay=delay,
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
            "[data.gains] make torque of commands, but [data.columns] names no "
            "position_command"
        )
    if columns.torque is not None:
        raise ProblemError(
            f"[data.columns] names a torque, {columns.torque}, and [data.gains] make "
            "one of commands; leave one of them out"
        )
    limit = data.gains.torque_limit
    return PDGains(
        np.array(data.gains.kp),
        np.array(data.gains.kd),
        np.array(np.inf if limit is None else limit),
    )


def drive_limits(gains: PDGains | None, joints: Sequence[str]) -> dict[str, float]:
    """Return where drives that follow commands clip their torque, [N m or N]."""
    if gains is None:
        return {}
    limits = gains.of(len(joints)).torque_limit.tolist()
    return dict(zip(joints, limits, strict=True))


def with_torque(
    raw: Recording,
    gains: PDGains | None,
    calibration: DriveCalibration | None = None,
) -> Recording:
    """Return a log with the torque of its commands, if there are gains.

    The measured velocity is left out then: the drive has it in its torque, and noise
    that is in the motion and in the torque would bias estimates.

    Parameters
    ----------
    gains : PDGains, optional
        As they are stated.
    """
    if gains is None:
        return raw
    known = DriveCalibration() if calibration is None else calibration
    return replace(calibrated(raw, gains, known), velocity=None)


def columns_of(data: DataTable, file: Path) -> Columns:
    """Return how a recording names its columns; by default as its format does."""
    usual = JOINT_STATE if log_format(file).holds == "joint states" else Columns()
    named = {} if data.columns is None else msgspec.structs.asdict(data.columns)
    return replace(
        usual,
        **named,
        torque_joints=data.torque_joints,
        units=data.units,
        beside=beside_columns(data.base, data.contacts, data.wrenches),
    )
