"""Logs of a robot that has no problem file, and the options that they need.

Logs are files, tables in memory or recordings.  A message proposes all options at once:
they are tried before it is shown.  Units that the numbers show are among them: a clock
in milliseconds or positions in degrees would show only in the diagnosis, after the next
command, and gains of currents that they imply would be wrong.
"""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.files import local_path
from consistent_id.diagnosis.clock import clock_unit
from consistent_id.diagnosis.findings import FoundUnit
from consistent_id.diagnosis.wrong_units import travel_unit
from consistent_id.errors import ModelError, ProblemError, RecordingError
from consistent_id.problems.found_logs import RobotLogs, found_logs, read_logs
from consistent_id.problems.nominal_gains import (
    NominalGains,
    implied_gains,
    nominal_gains,
)
from consistent_id.problems.statement import (
    Statement,
    declarations,
    statement_of_words,
)
from consistent_id.recordings.column_proposals import GAINS
from consistent_id.recordings.log_formats import LOG_FORMATS
from consistent_id.recordings.readers.data_frames import ColumnTable, as_wide_table
from consistent_id.recordings.readers.printed_messages import is_element
from consistent_id.recordings.readers.text_files import encoding_of
from consistent_id.recordings.readers.units import COUNTS, RATE
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import unwrapped
from consistent_id.robot.model import RobotModel

GivenLog = str | Path | ColumnTable | Recording
"""A log: a file; a data frame, an Arrow table or a mapping of arrays; a recording."""

_COLUMNS = {
    "position": "q",
    "velocity": "dq",
    "torque": "tau",
    "position_command": "q_des",
}
_BESIDE = ("base", "wrenches", "contacts", "torque_known")

_WHOLE = 0.8  # of a turn: a jump by a whole one
_STEADY = 1.0  # rad, between samples that do not jump
_ROBOTS = (".urdf", ".xml", ".mjcf", ".xacro")
_HEAD = 1_000  # characters of a file that show what it is
_MOST_REMEDIES = 4


@dataclass(frozen=True, slots=True, eq=False)
class GivenLogs:
    """Logs by path; a table in memory has a made-up path.

    Parameters
    ----------
    tables : mapping of Path to ColumnTable
        Tables in memory, with a row for each instant.
    notes : tuple of str
        Sentences on tables that had a row for each joint and instant.
    """

    training: tuple[Path, ...]
    validation: tuple[Path, ...]
    tables: Mapping[Path, ColumnTable]
    notes: tuple[str, ...] = ()


def given_logs(
    training: GivenLog | Sequence[GivenLog], validation: GivenLog | Sequence[GivenLog]
) -> GivenLogs:
    """Return logs by path; tables in memory are numbered in their order.

    Raises
    ------
    ProblemError
        If there is none to learn from, or one is given twice.
    RecordingError
        If a recording has signals that a table of joints does not have.
    """
    roles = [_several(training), _several(validation)]
    if not roles[0]:
        raise ProblemError("no training log, expected at least one")
    every = [log for logs in roles for log in logs]
    names = {id(log): _path(log, number) for number, log in enumerate(every, 1)}
    _require_distinct([names[id(log)] for log in every])
    found = {
        names[id(log)]: as_wide_table(_table(log), str(names[id(log)]))
        for log in every
        if not _is_file(log)
    }
    tables = {path: table for path, (table, _) in found.items()}
    notes = tuple(note for _, note in found.values() if note)
    first, second = (tuple(names[id(log)] for log in logs) for logs in roles)
    return GivenLogs(first, second, tables, notes)


def _several(logs: GivenLog | Sequence[GivenLog]) -> tuple[GivenLog, ...]:
    """Return logs as a tuple; a data frame is one log, though it is iterable."""
    return tuple(logs) if isinstance(logs, list | tuple) else (logs,)


def _is_file(log: GivenLog) -> bool:
    return isinstance(log, str | Path)


def _path(log: GivenLog, number: int) -> Path:
    return local_path(log) if isinstance(log, str | Path) else Path(f"log-{number}")


def _table(log: GivenLog) -> ColumnTable:
    return _columns_of(log) if isinstance(log, Recording) else cast(ColumnTable, log)


def _columns_of(log: Recording) -> dict[str, Vector]:
    """Return a recording's arrays by names of columns."""
    beside = [name for name in _BESIDE if _is_there(getattr(log, name))]
    if beside:
        raise RecordingError(
            f"{log.name}: has {', '.join(beside)}, which a call without a problem file "
            "does not know; build_regression and identify take such recordings"
        )
    table = {"time": log.time}
    for channel, word in _COLUMNS.items():
        if (values := getattr(log, channel)) is not None:
            for joint, column in zip(log.joints, values.T, strict=True):
                table[f"{word}_{joint}"] = column
    return table


def _is_there(value: object) -> bool:
    return value is not None and not (isinstance(value, tuple) and not value)


def _require_distinct(every: Sequence[Path]) -> None:
    for file in every:
        if every.count(file) > 1:
            raise ProblemError(
                f"{file} is given twice; a log is for training or for validation"
            )


def robot_logs(
    model: Path,
    log: Path,
    stated: Statement | None = None,
    *,
    tables: Mapping[Path, ColumnTable] | None = None,
) -> RobotLogs:
    """Find how to read a robot's logs.

    Parameters
    ----------
    model : Path
        URDF or MJCF.
    log : Path
        One of the logs; the others have the same columns.
    stated : Statement, optional
        The user's statement; joints of the robot that the log does not have are locked.
    tables : mapping of Path to ColumnTable, optional
        Logs in memory, by the paths that stand for them.

    Raises
    ------
    ModelError, RecordingError
        If a file cannot be read, or columns cannot be guessed.
    ProblemError
        If the two files seem to be exchanged, or the gains are too many or too few.
    """
    tables, stated = tables or {}, stated or Statement()
    try:
        if log not in tables:
            _require_order(model, log)
        return found_logs(model, log, stated, tables)
    except (ModelError, RecordingError) as cause:
        known = {declarations()[n].option for n in stated.given}
        if cause.option_names <= known and not cause.replaces:
            raise  # the error proposes nothing, or only stated options
        raise with_remedies(cause, model, log, stated, tables) from None


def with_remedies(
    cause: ModelError | RecordingError,
    model: Path,
    log: Path,
    stated: Statement,
    tables: Mapping[Path, ColumnTable],
) -> ModelError | RecordingError:
    """Return an error that proposes all needed options, not only the first."""
    if cause.replaces:  # what it proposes are no options
        return cause
    said, options, error = [str(cause)], list[str](), cause
    while error.options and len(options) < _MOST_REMEDIES:
        if error.option_names & set(" ".join(options).split()) - {"--units"}:
            break
        options.append(error.options)
        try:
            said_more, more_options = _further(model, log, stated, options, tables)
            said += said_more
            options += more_options
            break
        except (ModelError, RecordingError) as following:
            said.append(f"Then {following}")
            error = following
        except ProblemError:  # such as a value that only the user knows
            break
    kind = ModelError if isinstance(cause, ModelError) else RecordingError
    joined = joined_options(options)
    return kind("\n".join(said), options=joined, replaces=cause.replaces)


def _further(
    model: Path,
    log: Path,
    stated: Statement,
    options: Sequence[str],
    tables: Mapping[Path, ColumnTable],
) -> tuple[list[str], list[str]]:
    """Return what a log that can be read with options needs besides: why, and options.

    Units that its numbers show, whole turns, and gains that the bodies imply.
    """
    said, further = list[str](), list[str]()
    logs, read, more = with_options(model, log, stated, joined_options(options), tables)
    while (unit := needed_unit(logs.robot, read, more)) is not None:
        said.append(f"Then {unit.finding.statement}: {unit.options}".rstrip(": "))
        further += [unit.options] * bool(unit.options)
        if not unit.options or COUNTS in unit.options:  # what follows depends on it
            return said, further
        given = joined_options([*options, *further])
        logs, read, more = with_options(model, log, stated, given, tables)
    if more.wraps is None and wraps(read):
        said.append("Then positions jump by whole turns")
        further.append("--wraps undo")
        read = unwrapped(read)
    gains = nominal_gains(logs.robot, read)
    if gains is not None and gains.far and not len(more.torque_gain):
        said.append(f"Then {gains.sentence[0].lower()}{gains.sentence[1:]}")
        further.append(gains.option)
    return said, further


class ReadLog(NamedTuple):
    """A log as it is read with a statement."""

    logs: RobotLogs
    recording: Recording
    stated: Statement


def with_options(
    model: Path,
    log: Path,
    stated: Statement,
    options: str,
    tables: Mapping[Path, ColumnTable] | None = None,
) -> ReadLog:
    """Read a log with options as they are typed, and some value for what is open.

    Raises
    ------
    ModelError, RecordingError, ProblemError
        If that is not enough.
    """
    filled = options.replace(GAINS, "1,0").replace(RATE, "100Hz")
    filled = filled.replace(COUNTS, "4096")
    more = _stated_with(stated, shlex.split(filled))
    logs, read = read_logs(found_logs(model, log, more, tables or {}), [log])
    return ReadLog(logs, read[log], more)


def _stated_with(stated: Statement, words: Sequence[str]) -> Statement:
    """Return a statement with options as they are typed in a shell."""
    names = {d.option: (n, d.usage.endswith("...")) for n, d in declarations().items()}
    given: dict[str, Any] = {}
    for word in words:
        if word in names:
            name, several = names[word]
            given[name] = []
        else:
            given[name] = [*given[name], word] if several else word
    more = statement_of_words(given)
    return replace(stated, **{name: getattr(more, name) for name in more.given})


def model_gains(model: Path, logs: Sequence[Path], stated: Statement) -> NominalGains:
    """Return the gains of logs that the bodies of a robot's file imply.

    Raises
    ------
    ModelError, RecordingError, ProblemError
        See `robot_logs`; also if they imply none.
    """
    read = robot_logs(model, logs[0], replace(stated, torque_gain=(1.0,)))
    return implied_gains(read.robot, list(map(read.read, logs)), str(model))


def _require_order(model: Path, log: Path) -> None:
    """Refuse a log in the place of the robot, and the robot in that of a log."""
    suffixes = {suffix for known in LOG_FORMATS for suffix in known.suffixes}
    suffixes -= {*_ROBOTS}  # XML is a robot, unless its content says otherwise
    first, second = model.suffix.lower(), log.suffix.lower()
    if model.is_dir() and not log.exists():
        raise ProblemError(f"{log}: no such file or folder")
    if model.is_dir():
        raise ProblemError(
            f"{model} is a folder, expected a robot's URDF or MJCF file before {log}; "
            "a folder of a problem or of results goes without logs"
        )
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
    if second in _ROBOTS and not _has_elements(log):
        raise ProblemError(f"{log} is a robot, expected a log after {model}")


def _has_elements(log: Path) -> bool:
    """Return whether an XML file is no robot, but a log of elements."""
    try:
        with log.open(encoding=encoding_of(log)) as file:
            return is_element(file.read(_HEAD))
    except (OSError, UnicodeDecodeError):
        return False


def needed_unit(
    robot: RobotModel, log: Recording, stated: Statement
) -> FoundUnit | None:
    """Return the unit of the clock or of positions that is not the stated one.

    Parameters
    ----------
    robot : RobotModel
        With the log's joints, in their order.
    stated : Statement
        Channels whose units are stated are not examined.
    """
    units = stated.units or {}
    found = None if "time" in units else clock_unit(log)
    if found is None and "position" not in units:
        return travel_unit(robot, log)
    return found


def wraps(log: Recording) -> bool:
    """Return whether positions jump by whole turns, and by no other steps."""
    most, undone = (
        float(abs(np.diff(each.position, axis=0)).max(initial=0.0))
        for each in (log, unwrapped(log))
    )
    return most > _WHOLE * 2.0 * np.pi and undone < _STEADY


def joined_options(options: Sequence[str]) -> str:
    """Return options as one text, in which each has all its values.

    Examples
    --------
    >>> joined_options(["--units time=ms --lock a", "--units deg"])
    '--units time=ms deg --lock a'
    """
    values: dict[str, list[str]] = {}
    name = ""
    for word in shlex.split(" ".join(options)):
        if word.startswith("--"):
            name = word
            values.setdefault(name, [])
        else:
            values[name].append(word)
    return " ".join(
        " ".join([name, *map(shlex.quote, each)]).strip()
        for name, each in values.items()
    )
