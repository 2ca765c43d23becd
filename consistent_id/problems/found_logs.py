"""How the logs of a robot without a problem file are read: joints, columns, units."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from consistent_id.diagnosis.wrong_units import require_lengths_of_sliding
from consistent_id.errors import ProblemError, RecordingError
from consistent_id.problems.floating.base_guess import widths_of
from consistent_id.problems.floating.floating_draft import (
    FloatingColumns,
    base_in_log,
    floating_columns,
)
from consistent_id.problems.locked_joints import locked_notes, require_positions
from consistent_id.problems.log_entries import motion_of_joints
from consistent_id.problems.nominal_gains import (
    LogRowsOfJoints,
    nominal_gains,
)
from consistent_id.problems.stated_model import base_question
from consistent_id.problems.statement import (
    Statement,
)
from consistent_id.recordings.column_guess import (
    ColumnGuess,
    guess_columns,
    require_one_clock,
)
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.mixed_columns import require_torque
from consistent_id.recordings.readers import Columns, read_recording, recording_from
from consistent_id.recordings.readers.columns import wanted
from consistent_id.recordings.readers.data_frames import (
    ColumnTable,
    has_only_columns,
    table_names,
)
from consistent_id.recordings.readers.named_arrays import require_gain
from consistent_id.recordings.readers.recording_file import column_names, reader_of
from consistent_id.recordings.readers.used_rows import NoValueError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.sensor_words import (
    WrenchNames,
    may_be_wrench,
    wrench_names,
)
from consistent_id.robot.chains import Selection
from consistent_id.robot.loaders import load_robot
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import did_you_mean

_PLAIN_GAIN = "--torque-gain 1"
_NO_GAINS = (
    "The model's bodies imply no gains for this log; masses would be in the unit of "
    "its columns with"
)
_MOST_LOST = 0.2  # share of a log's rows that lack the velocity, and are left out
_CHANNELS = ("time", "position", "velocity", "torque", "position_command")


@dataclass(frozen=True, slots=True, eq=False)
class RobotLogs:
    """A robot, and how its logs are read.

    Parameters
    ----------
    robot : RobotModel
        The robot with the joints that the logs have.
    columns : Columns
    locked : dict of str to float
        Joints that do not move, and their positions [rad or m].
    stated : Statement
        The user's statement, with the topic if the logs are bags.
    notes : tuple of str
        Notes on guesses.
    floating : FloatingColumns, optional
        Motion of the base, if it floats.
    tables : mapping of Path to ColumnTable
        Logs in memory, by the paths that stand for them.
    """

    robot: RobotModel
    columns: Columns
    locked: dict[str, float]
    stated: Statement
    notes: tuple[str, ...]
    floating: FloatingColumns | None = None
    tables: Mapping[Path, ColumnTable] = field(default_factory=dict)

    def read(self, log: Path) -> Recording:
        """Read a log as written; `with_torque` computes torque from its commands."""
        joints, stated = self.robot.joint_names, self.stated
        gain = gains_of(stated.torque_gain, len(joints))
        how: dict[str, Any] = {
            "torque_gain": gain,
            "omit": stated.omitted_of(log),
            "duplicates": stated.duplicates or "refuse",
            "missing": stated.missing or "refuse",
        }
        if log in self.tables:
            table = self.tables[log]
            raw = recording_from(table, joints, self.columns, name=log.name, **how)
        else:
            raw = read_recording(log, joints, self.columns, topic=stated.topic, **how)
        return motion_of_joints(
            raw,
            wraps=stated.wraps,
            scale=stated.position_scale,
            offset=stated.position_offset,
            coupled=stated.coupled,
        )


def read_logs(
    logs: RobotLogs, files: Sequence[Path]
) -> tuple[RobotLogs, dict[Path, Recording]]:
    """Read logs of whose values only some of the velocity may be missing.

    Rows that lack it are left out; if these are many, or a joint has no velocity at
    all, it is not read.

    Raises
    ------
    RecordingError
        If they cannot be read without it, either, or the user named it.
    """
    try:
        return logs, {file: logs.read(file) for file in files}
    except RecordingError:
        if logs.columns.velocity is None or logs.stated.velocity is not None:
            raise
        bare = replace(logs, columns=replace(logs.columns, velocity=None))
        without = {file: bare.read(file) for file in files}
        if (found := _with_less_velocity(logs, without)) is None:
            raise
    return found


def _with_less_velocity(
    logs: RobotLogs, without: dict[Path, Recording]
) -> tuple[RobotLogs, dict[Path, Recording]] | None:
    """Read logs without the rows that lack only the velocity, or without it.

    Parameters
    ----------
    without : dict of Path to Recording
        The logs without the velocity.
    """
    some = replace(logs, stated=replace(logs.stated, missing="omit"))
    try:
        read = {file: some.read(file) for file in without}
    except NoValueError as cause:
        if cause.channel != "velocity":
            return None
        said = cause.said
    except RecordingError:
        return None
    else:
        lost = {file: len(raw) - len(read[file]) for file, raw in without.items()}
        most = max(lost, key=lambda file: lost[file] / len(without[file]))
        said = f"{most.name}: the velocity is missing in {lost[most]} rows"
        if lost[most] <= _MOST_LOST * len(without[most]):
            note = f"{said}, which are left out"
            return replace(some, notes=(*logs.notes, note)), read
    note = f"{said}: it is not read, and positions are differentiated"
    columns = replace(logs.columns, velocity=None)
    return replace(logs, columns=columns, notes=(*logs.notes, note)), without


def found_logs(
    model: Path, log: Path, stated: Statement, tables: Mapping[Path, ColumnTable]
) -> RobotLogs:
    """Find how to read logs under the stated options."""
    robot = whole = _loaded(model, stated)
    if stated.locked:
        whole = _loaded(model, replace(stated, locked=None))
    _require_floating(stated, floating=robot.floating)
    if log in tables:
        _require_fixed(robot)
    else:
        _require_base(model, log, robot, stated)
    floating = floating_columns(log, robot, model, stated) if robot.floating else None
    in_memory = table_names(tables[log], log.name) if log in tables else None
    wrenches = wrenches_in_log(log, in_memory)
    felt = wrench_note(wrenches, robot)
    others = () if floating is None else floating.taken
    known = replace(
        _stated_columns(robot, stated),
        names=in_memory,
        flat=in_memory is not None and has_only_columns(tables[log], in_memory),
        taken=(*others, *(name for one in wrenches for name in one.names)),
        arrays=_arrays(floating),
        all_joints=whole.joint_names if stated.locked else (),
        rows=_rows_of_joints(model, log, robot, stated, tables),
    )
    guessed = partial(_guessed, log, renamed=_names_in_log(stated, robot), felt=felt)
    try:
        guess = guessed(known)
        require_torque(guess.columns.torque, stated.torque_gain)
        if not len(stated.torque_gain):
            require_gain(guess.columns.units, log.name)
    except RecordingError as cause:
        if len(stated.torque_gain) or cause.options or log in tables:
            raise
        with_currents = partial(guessed, replace(known, currents=True))
        locking = partial(_with_locked, model, stated, robot)
        raise _with_gains(cause, with_currents, locking, log) from None
    if in_memory is not None:
        require_one_clock(log, in_memory, guess.columns, tables[log])
    stated = replace(stated, topic=guess.topic)
    if log not in tables and "position" not in guess.columns.units:
        _require_usual_units(log, guess)
    robot, locked = _with_locked(model, stated, robot, guess.joints)
    require_lengths_of_sliding(robot, guess.columns.units)
    gains_of(stated.torque_gain, len(robot.joint_names))
    kept = (f"{path} stands for a table in memory" for path in tables)
    said = () if log in tables else log_format(log).notes(log)
    said += locked_notes(log, guess, known, stated.locked or {}, tables.get(log), whole)
    found, notes = guess.columns, (*said, *guess.notes, *kept, *[felt] * bool(felt))
    if floating is not None:
        found = replace(found, beside=floating.beside)
        notes = (*notes, *floating.notes)
    return RobotLogs(robot, found, locked, stated, notes, floating, tables)


def _stated_columns(robot: RobotModel, stated: Statement) -> KnownColumns:
    """Return what the robot and the user's statement say of a log's columns."""
    return KnownColumns(
        robot.joint_names,
        {c: name for c in _CHANNELS if (name := getattr(stated, c)) is not None},
        torque_joints=stated.torque_joints,
        units=stated.units,
        currents=len(stated.torque_gain) > 0,
        commands=stated.gains is not None,
        sliding=frozenset(j.name for j in robot.driven if j.kind == "prismatic"),
        topic=stated.topic,
    )


def _with_locked(
    model: Path, stated: Statement, robot: RobotModel, joints: Sequence[str]
) -> tuple[RobotModel, dict[str, float]]:
    """Return the robot with the joints that a log does not have locked, and these."""
    absent = [name for name in robot.joint_names if name not in joints]
    locked = dict(stated.locked or {}) | dict.fromkeys(absent, 0.0)
    return _loaded(model, replace(stated, locked=locked)) if absent else robot, locked


def _with_gains(
    cause: RecordingError,
    guessed: Callable[[], ColumnGuess],
    locking: Callable[[Sequence[str]], tuple[RobotModel, dict[str, float]]],
    log: Path,
) -> RecordingError:
    """Return an error with the gains that the model's bodies imply for currents.

    The gain is one if they imply none; there is none if the log has no currents.
    """
    try:
        guess = guessed()
        robot, _ = locking(guess.joints)
        if guess.joints != robot.joint_names or guess.columns.torque is None:
            return cause
        plain = [1.0] * len(guess.joints)  # which a current's unit needs, too
        raw = read_recording(log, guess.joints, guess.columns, torque_gain=plain)
    except (RecordingError, ProblemError):
        return cause
    gains = nominal_gains(robot, raw)
    if gains is None:
        said, options = _NO_GAINS, _PLAIN_GAIN
    else:
        said, options = gains.sentence, gains.option
    return RecordingError(f"{cause} {said}: {options}", options=options)


def _rows_of_joints(
    model: Path,
    log: Path,
    robot: RobotModel,
    stated: Statement,
    tables: Mapping[Path, ColumnTable],
) -> LogRowsOfJoints | None:
    """Return the joints that the log may have, if it has fewer than the robot.

    None, if joints are named: then it has the joints that are.
    """
    if stated.names or robot.floating:
        return None

    def read(rest: Sequence[str]) -> tuple[RobotModel, Recording]:
        locked = dict(stated.locked or {}) | dict.fromkeys(rest, 0.0)
        moved = len(robot.joint_names) - len(rest)
        plain = tuple(stated.torque_gain) or (1.0,) * moved  # currents will do, too
        likely = replace(stated, locked=locked, torque_gain=plain)
        logs = found_logs(model, log, likely, tables)
        return logs.robot, logs.read(log)

    return LogRowsOfJoints(robot, read)


def _require_usual_units(log: Path, guess: ColumnGuess) -> None:
    """Refuse positions without a unit that are not in radians or metres."""
    columns = guess.columns
    if columns.position is not None and not columns.array_joints:
        form = log_format(log)
        if form.holds == "arrays":
            want = wanted(columns, guess.joints, str(log))
            form.require_units(log, want.columns["position"])


def _loaded(model: Path, stated: Statement) -> RobotModel:
    return load_robot(model, gravity=stated.gravity, **asdict(selection_of(stated)))


def selection_of(stated: Statement) -> Selection:
    """Return the part of the robot that is stated to move."""
    return Selection(stated.base, stated.tip, locked=stated.locked or None)


def _names_in_log(stated: Statement, robot: RobotModel) -> dict[str, str]:
    """Return names of joints in the log by those of the robot, where they differ."""
    for joint in (stated.names or {}).values():
        if joint not in robot.joint_names:
            near = did_you_mean(joint, robot.joint_names)
            raise ProblemError(f"names: no joint {joint!r}; {near}")
    return {joint: name for name, joint in (stated.names or {}).items()}


def _guessed(
    log: Path, known: KnownColumns, *, renamed: Mapping[str, str], felt: str
) -> ColumnGuess:
    """Guess columns; if this fails, name the log's other columns.

    Parameters
    ----------
    renamed : mapping of str to str
        The log's names of joints, where they are not the robot's.
    felt : str
        A sentence on columns of a force/torque sensor, or nothing.
    """
    try:
        guess = guess_columns(log, known := known.renamed(renamed))
        require_positions(log, guess, known)
    except RecordingError as cause:
        said = f"{cause} {felt}".strip()
        raise RecordingError(
            said, options=cause.options, replaces=cause.replaces
        ) from None
    if not renamed:
        return guess
    for joint, name in renamed.items():
        if name not in guess.joints:
            raise RecordingError(
                f"--names {name}={joint}: {log} has no columns of {name!r}; it has "
                f"those of {', '.join(guess.joints)}. Leave this name out"
            )
    own = {name: joint for joint, name in renamed.items()}

    def of_robot(names: Iterable[str]) -> tuple[str, ...]:
        return tuple(own.get(name, name) for name in names)

    columns = guess.columns
    found = {name: own.get(joint, joint) for name, joint in columns.names.items()}
    columns = replace(
        columns,
        names={k: j for k, j in own.items() if j not in found.values()} | found,
        array_joints=of_robot(columns.array_joints),
        torque_joints=of_robot(columns.torque_joints),
    )
    return replace(guess, columns=columns, joints=of_robot(guess.joints))


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


def _require_floating(stated: Statement, *, floating: bool) -> None:
    """Refuse columns of a base that does not move."""
    if stated.of_part("base") and not floating:
        raise ProblemError(
            "columns of the base or of contacts are given, but the base is assumed "
            "to be fixed; add --base floating (base = 'floating')"
        )


def _require_base(model: Path, log: Path, robot: RobotModel, stated: Statement) -> None:
    """Refuse a robot on legs with a fixed base whose log has a moving base."""
    if stated.base is not None or not base_question(robot):
        return
    moved = [str(found) for found in base_in_log(log)]
    if moved:
        raise ProblemError(
            f"{model} has several limbs on its base, and {log} has the motion of a "
            f"base ({'; '.join(moved[:3])}). If the base moves, add --base floating. "
            f"If it hangs still, or is bolted down, add --base ROOT with the name of "
            f"the link that stands still"
        )


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
    return list(given) * (joints // len(given)) if len(given) else 1.0


_KINDS = ("geometry_msgs/msg/WrenchStamped", "geometry_msgs/msg/Wrench")
_ARRAYS = ("NPZ", "Parquet", "Feather")  # formats whose columns may be arrays


def wrenches_in_log(
    log: Path, names: Sequence[str] | None = None
) -> tuple[WrenchNames, ...]:
    """Return columns of a log that may belong to a wrench sensor.

    Parameters
    ----------
    log : Path
    names : sequence of str, optional
        Columns of a table in memory, which the path stands for.
    """
    if names is not None:
        return wrench_names(names)
    form = log_format(log)
    if form.holds == "joint states":
        kinds: dict[str, str] = reader_of(log).topic_kinds(log)
        fields = {_KINDS[0]: ".wrench", _KINDS[1]: ""}
        return tuple(
            WrenchNames((topic + fields[kind],))
            for topic, kind in kinds.items()
            if fields.get(kind)
        )
    if not form.lists_names:
        return ()
    known = column_names(log)
    widths = {}
    if form.name in _ARRAYS and (wanted := [n for n in known if may_be_wrench(n)]):
        widths = widths_of(reader_of(log).read_arrays(log, wanted))
    return wrench_names(known, widths)


def wrench_note(found: Sequence[WrenchNames], robot: RobotModel) -> str:
    """Return a note on columns that look like a wrench sensor's, "" without such.

    The proposed frame is the last one that is fixed to the last link; it is a guess.
    """
    if not found:
        return ""
    last = robot.links[-1]
    frame = last.merged[-1].name if last.merged else last.name
    seen = "; ".join(map(str, found))
    values = ", ".join(f'"{name}"' for name in found[0].names)
    columns = f'[[data.wrenches]] frame = "{frame}", values = [{values}]'
    if robot.floating:
        return (
            f"{seen}: these look like a wrench sensor's columns and are not used; "
            f"for a foot with frame {frame}, for example, write {columns}"
        )
    return (
        f"{seen}: these look like a wrench sensor's; they show what hangs on it, not "
        f'the robot: [wrist_sensor] frame = "{frame}" (or where it is) and {columns} '
        "in a problem file (consistent-id help wrist-sensor)"
    )
