"""A user's statements, which replace settings of a problem file.

Drive terms are stated in words: for all joints, with exceptions for some.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from consistent_id._support.files import relative_path
from consistent_id.errors import ProblemError
from consistent_id.problems.file import (
    ColumnsTable,
    DataTable,
    ProblemTable,
    RecordingTable,
)
from consistent_id.problems.log_entries import columns_of, gains_table
from consistent_id.problems.parameter_tables import (
    DriveTable,
    FileTable,
    JointTable,
    exceptions,
)
from consistent_id.problems.paths import as_named
from consistent_id.problems.stated_model import DEFAULT_DRIVE, robot_of
from consistent_id.problems.statement import Statement, declarations
from consistent_id.problems.task_tables import (
    ALWAYS,
    BaseTable,
    ContactTable,
    SceneTable,
)
from consistent_id.regression.drive.drive_terms import DEFAULTS, DriveTerms
from consistent_id.robot.parameters import did_you_mean, require_known

_SWITCHES = tuple(name for name, value in DEFAULTS.items() if value in (False, "none"))


@dataclass(frozen=True, slots=True)
class StatedDrive:
    """Drive terms of all joints, and exceptions for some."""

    common: DriveTable
    joints: Mapping[str, JointTable]

    def terms(self, joints: Sequence[str]) -> tuple[DriveTerms, ...]:
        """Return the terms of joints, in their order."""
        own = (self.joints.get(name) for name in joints)
        tables = (self.common if t is None else t.over(self.common) for t in own)
        return tuple(table.terms for table in tables)


def stated_drive(
    words: Sequence[str], joints: Sequence[str], *, width: float | None = None
) -> StatedDrive:
    """Return the drive that words state.

    Parameters
    ----------
    words : sequence of str
        Terms of all joints, such as ``viscous``, and terms that replace these for one
        joint: ``wrist=viscous,coulomb``, or ``wrist=`` for none.
    joints : sequence of str
        The robot's.
    width : float, optional, [rad/s or m/s]
        The width of friction's change of sign; by default a usual one.

    Raises
    ------
    ProblemError
        If there is no such term or joint, or one joint alone is described.
    """
    common = [word for word in words if "=" not in word]
    alone = [word for word in words if "=" in word]
    if alone and not common:
        raise ProblemError(
            f"drive terms are only {alone[0]!r}, expected those of all joints "
            f"before, such as viscous coulomb offset {alone[0]}"
        )
    table, own = drive_table(common, width), dict[str, JointTable]()
    for word in alone:
        joint, _, terms = word.partition("=")
        if joint not in joints:
            raise ProblemError(
                f"drive terms {word!r}: no joint {joint!r}; "
                f"{did_you_mean(joint, joints)}"
            )
        other = drive_table([term for term in terms.split(",") if term], width)
        own[joint] = JointTable(**exceptions(other, table))
    return StatedDrive(table, own)


def drive_table(names: Sequence[str], width: float | None = None) -> DriveTable:
    """Return the drive terms of these names; shapes have their usual values.

    Raises
    ------
    ProblemError
        If there is no such term.
    """
    require_known(names, _SWITCHES, "no drive term")
    keys: dict[str, Any] = dict.fromkeys(names, True)
    if keys.pop("coulomb", False):
        usual = DEFAULT_DRIVE.velocity_scale
        keys |= {"coulomb": "tanh", "velocity_scale": width or usual}
    return DriveTable(**keys)


_MADE: dict[str, Callable[[], FileTable]] = {
    "columns": ColumnsTable,
    "base": BaseTable,
    "scene": SceneTable,
}
"""Tables that a file may lack, by their keys."""


class Stated(NamedTuple):
    """A problem file's content with a user's statements, and notes on them."""

    table: ProblemTable
    notes: tuple[str, ...] = ()


def overridden(table: ProblemTable, stated: Statement, file: Path) -> Stated:
    """Return a problem file's content with a user's statements.

    Parameters
    ----------
    file : Path
        The file whose folder is the base of relative names.

    Raises
    ------
    ProblemError
        If a statement concerns a choice that a problem file always makes, or needs a
        table that the file lacks; with a command that works.
    """
    notes = []
    for name in stated.given:
        declared = declarations()[name]
        if not declared.key:
            raise ProblemError(_refusal(name, stated, file))
        if declared.key.startswith("data.") and table.data is None:
            raise ProblemError(
                f"{declared.option} is for logs, but {file} names none; add a [data] "
                "table, or give robot and log: consistent-id identify ROBOT.urdf LOG"
            )
        before = _shown(table, declared.key)
        table = (
            _WHOLE[name](table, stated, file)
            if name in _WHOLE
            else _put(table, declared.key.split("."), _value(name, table, stated, file))
        )
        now = _shown(table, declared.key)
        instead = f" in place of {before}" if before and before != now else ""
        instead = ", as the file has it" if before == now else instead
        notes.append(f"stated: {declared.key} = {now}{instead}")
    return Stated(table, tuple(notes))


def _refusal(name: str, stated: Statement, file: Path) -> str:
    """Return why a setting cannot be stated beside a problem file, with advice."""
    declared = declarations()[name]
    if name == "imu":
        return (
            f"{declared.option} is for a log without a problem file; {file} states "
            "where the unit is: imu_position and imu_orientation of [data.base]"
        )
    if name == "select":
        return (
            f"{declared.option} is for a log without a problem file; {file} states the "
            "model. Leave it out"
        )
    value = getattr(stated, name)
    words = f"{value:g}" if isinstance(value, float) else " ".join(value)
    return (
        f"{declared.option} is for the selection of a model, and {file} states the "
        f"model. To select again: consistent-id select {file} {declared.option} {words}"
    )


def _put(table: Any, path: list[str], value: object) -> Any:
    """Return a table with a value at a path of keys; missing tables are made."""
    key, *inner = path
    if inner:
        own = getattr(table, key)
        value = _put(_MADE[key]() if own is None else own, inner, value)
    return msgspec.structs.replace(table, **{key: value})


def _shown(table: Any, key: str) -> str:
    """Return the value of a key, for people; empty if it is missing."""
    while key:
        if isinstance(table, list):
            return "; ".join(filter(None, (_shown(member, key) for member in table)))
        part, _, key = key.partition(".")
        table = getattr(table, part, None)
    if isinstance(table, FileTable):
        values = msgspec.structs.asdict(table)
        return ", ".join(f"{k} {v}" for k, v in values.items() if v)
    if isinstance(table, list) and table and isinstance(table[0], FileTable):
        return f"{len(table)} tables"
    if table is None or table in ([], {}):
        return ""
    return f"{table:g}" if isinstance(table, float) else str(table)


def _value(name: str, table: ProblemTable, stated: Statement, file: Path) -> object:
    """Return a stated value in the form of the file."""
    value: Any = getattr(stated, name)
    data, folder = table.data, file.parent
    if data is not None and name in _OF_DATA:
        return _OF_DATA[name](value, data, folder)
    if name == "package_dirs":
        return [as_named(Path(package), folder) for package in value]
    if name == "gravity":
        return tuple(map(float, value))
    if name == "contacts":
        pairs = (
            (f, True if column == ALWAYS else column) for f, column in value.items()
        )
        return [ContactTable(frame=frame, closed=closed) for frame, closed in pairs]
    return list(value) if isinstance(value, tuple) else value


def _units(value: Any, data: DataTable, folder: Path) -> object:
    given = {
        c: unit if isinstance(unit, str) else list(unit) for c, unit in value.items()
    }
    return data.units | given


def _gains(value: Any, data: DataTable, folder: Path) -> object:
    """Return gains, with the delay and the calibration that the file states."""
    given = gains_table(value)
    keys = ("kp", "kd", "torque_limit")
    own = given if data.gains is None else data.gains
    return msgspec.structs.replace(own, **{key: getattr(given, key) for key in keys})


def _validation(value: Any, data: DataTable, folder: Path) -> object:
    """Return the recordings with other validation logs, all rows of which are used."""
    where = folder / data.folder
    others = [
        RecordingTable(file=relative_path(Path(log), where), role="validation")
        for log in value
    ]
    return [*(e for e in data.recordings if e.role == "training"), *others]


_OF_DATA: dict[str, Callable[[Any, DataTable, Path], object]] = {
    "units": _units,
    "gains": _gains,
    "validation": _validation,
    "torque_gain": lambda gain, *_: list(gain) if len(gain) > 1 else gain[0],
}


def _rows(table: ProblemTable, stated: Statement, file: Path) -> ProblemTable:
    """State which rows of the named logs are used, and which are omitted."""
    data = table.data
    entries = []
    recordings = () if data is None else data.recordings
    stated.require_logs(Path(entry.file) for entry in recordings)
    for entry in recordings:
        log = Path(entry.file)
        rows, omit = stated.rows_of(log), stated.omitted_of(log)
        kept = entry.rows if rows is None else list(rows)
        parts = [other for other in recordings if other.file == entry.file]
        if rows is not None and entry.rows and len(parts) > 1:
            # Else training and validation of one log would have the same rows.
            kept = [max(rows[0], entry.rows[0]), min(rows[1], entry.rows[1])]
            if kept[0] >= kept[1]:
                raise ProblemError(
                    f"--rows {rows[0]},{rows[1]} leaves none of rows {entry.rows[0]} "
                    f"to {entry.rows[1]} of {entry.file}, which are for {entry.role}; "
                    f"change rows of [[data.recordings]] in {file}"
                )
        left = list(omit) or entry.omit
        entries.append(msgspec.structs.replace(entry, rows=kept, omit=left))
    found: ProblemTable = _put(table, ["data", "recordings"], entries)
    return found


def _column(name: str) -> "_Put":
    """Return stated names of columns; other names are those of the log's format."""

    def put(table: ProblemTable, stated: Statement, file: Path) -> ProblemTable:
        data = table.data
        if data is not None and data.columns is None:
            usual = columns_of(data, Path(data.recordings[0].file))
            named: dict[str, Any] = {
                key: getattr(usual, key) for key in ColumnsTable.__struct_fields__
            }
            named |= {"array_joints": list(usual.array_joints)}
            table = _put(table, ["data", "columns"], ColumnsTable(**named))
        key = declarations()[name].key
        found: ProblemTable = _put(table, key.split("."), getattr(stated, name))
        return found

    return put


def _drive(table: ProblemTable, stated: Statement, file: Path) -> ProblemTable:
    """State drive terms; the datasheets of motors stay."""
    joints = robot_of(table, file.parent).joint_names
    width = stated.friction_velocity or table.drive.velocity_scale
    drive = stated_drive(stated.drive or (), joints, width=width)
    own = {}
    for joint in {**table.joints, **drive.joints}:
        before = table.joints.get(joint, JointTable())
        new = drive.joints.get(joint, JointTable())
        own[joint] = msgspec.structs.replace(
            new, gear_ratio=before.gear_ratio, motor_inertia=before.motor_inertia
        )
    return msgspec.structs.replace(table, drive=drive.common, joints=own)


def _width(table: ProblemTable, stated: Statement, file: Path) -> ProblemTable:
    """State the width of friction's change of sign, for joints that have one."""
    width = stated.friction_velocity
    own = {
        joint: msgspec.structs.replace(each, velocity_scale=width)
        if each.stated.get("velocity_scale")
        else each
        for joint, each in table.joints.items()
    }
    if table.drive.coulomb != "tanh" and own == table.joints:
        raise ProblemError(
            '--friction-velocity is of Coulomb friction, coulomb = "tanh", which '
            f"{file} does not have; state it: --drive viscous coulomb offset"
        )
    table = msgspec.structs.replace(table, joints=own)
    if table.drive.coulomb != "tanh":
        return table
    found: ProblemTable = _put(table, ["drive", "velocity_scale"], width)
    return found


_Put = Callable[[ProblemTable, Statement, Path], ProblemTable]
_COLUMNS = ("time", "position", "velocity", "torque", "names", "position_command")
_WHOLE: dict[str, _Put] = {
    **{name: _column(name) for name in _COLUMNS},
    "rows": _rows,
    "omit": _rows,
    "drive": _drive,
    "friction_velocity": _width,
}
"""Fields of a statement that change more than one key."""
