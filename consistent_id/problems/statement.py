"""The statements of a user on a robot and its logs, each declared once.

A field of `Statement` is a keyword in Python, an option in the shell, a row of the
documentation and, by its ``key``, a place in the problem file.  Other settings are
found in the logs, selected from the training data, or defaults.
"""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, ParamSpec, TypeVar

from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.problems import statement_words as words
from consistent_id.problems.statement_words import Declaration, Part

if TYPE_CHECKING:
    from consistent_id.recordings.readers.units import Units
    from consistent_id.recordings.signals import PDGains

P = ParamSpec("P")
R = TypeVar("R")

EVERY = ""
"""Stands for all logs, in place of a log's name."""


def _said(*declared: Any, default: Any = None, **more: Any) -> Any:
    return field(
        default=default, metadata={"declaration": Declaration(*declared, **more)}
    )


_COLUMN = "the log's column, with {joint} or {number} (default: found by its name)"


@brief
@dataclass(frozen=True, slots=True, kw_only=True)
class Statement:
    """The statement of a user on a robot and its logs; None for fields not stated.

    The fields are the keywords of `draft_problem`, `identify_log` and `load_problem`,
    and the options of the shell's commands; `declarations` has a sentence on each.

    Raises
    ------
    ProblemError
        If two fields contradict each other.

    Examples
    --------
    >>> Statement(tip="flange", cutoff=8.0).given
    ('tip', 'cutoff')
    """

    base: str | None = _said(
        "robot",
        "--base LINK",
        "link that stands still (default: the root), or 'floating'",
        "model.base",
    )
    tip: str | None = _said(
        "robot", "--tip LINK", "last link of the chain, such as the flange", "model.tip"
    )
    locked: Mapping[str, float] | None = _said(
        "robot",
        "--lock JOINT ...",
        "joints that stand still, at zero or at JOINT=POSITION (rad or m)",
        "model.locked",
        read=words.positions,
    )
    gravity: Sequence[float] | None = _said(
        "robot",
        "--gravity X,Y,Z",
        "gravity in the root link's frame, m/s^2; or X Y Z (default: the MJCF file's, "
        "or 0,0,-9.81)",
        "model.gravity",
        read=words.vector,
    )
    package_dirs: Sequence[str | Path] = _said(
        "robot",
        "--package-dirs FOLDER ...",
        "folders of the packages that the file's meshes are in",
        "excitation.scene.packages",
        default=(),
        read=words.folders,
    )
    validation: Sequence[Any] = _said(
        "log",
        "--validate LOG ...",
        "logs for validation (default: the last 30 %% of each log's motion)",
        "data.recordings",
        default=(),
        read=words.folders,
    )
    time: str | None = _said(
        "log",
        "--time NAME",
        "the log's clock; 'SEC + NANOSEC' for two columns; if it has none and samples "
        "are evenly spaced, their rate, such as 1000Hz (default: found by its name)",
        "data.columns.time",
    )
    position: str | None = _said(
        "log", "--position NAME", _COLUMN, "data.columns.position"
    )
    velocity: str | None = _said(
        "log", "--velocity NAME", _COLUMN, "data.columns.velocity"
    )
    torque: str | None = _said("log", "--torque NAME", _COLUMN, "data.columns.torque")
    names: Mapping[str, str] | None = _said(
        "log",
        "--names NAME=JOINT ...",
        "the log's name of a joint, and the robot's, where the two differ",
        "data.columns.names",
        read=words.pairs("--names NAME=JOINT"),
    )
    topic: str | None = _said(
        "log",
        "--topic TOPIC",
        "joint states of a ROS bag (default: the topic that names most of the robot's "
        "joints)",
        "data.topic",
    )
    units: "Units | None" = _said(
        "log",
        "--units UNIT ...",
        "units that are not s, rad, m, N m or N: deg, mm, rpm, ms, %% of rated torque; "
        "or CHANNEL=UNIT, such as velocity=deg/s or, joint by joint, position=deg,mm "
        "(default: as names say)",
        "data.units",
        read=words.units,
    )
    torque_joints: Sequence[str] = _said(
        "log",
        "--torque-joints JOINT ...",
        "joints whose torque the log has (default: all)",
        "data.torque_joints",
        default=(),
        read=tuple,
    )
    torque_gain: Sequence[float] = _said(
        "log",
        "--torque-gain NUMBER ...",
        "factor from the torque columns to N m or N: one for all joints, or one each",
        "data.torque_gain",
        default=(),
        read=words.numbers,
    )
    gain_source: Literal["drives", "model"] | None = _said(
        "log",
        "--gain-source",
        "source of the torque gains: the drives, or the model's bodies, an assumption "
        "that the verdict names (default: drives)",
        "data.gain_source",
        choices=("drives", "model"),
    )
    gains: "PDGains | None" = _said(
        "log",
        "--gains KP,KD[,LIMIT] ...",
        "gains of PD-controlled joints, for all or one each: torque is computed from "
        "commands of position, and clipped at the drive's limit (N m, N) if given",
        "data.gains",
        read=words.gains,
    )
    position_command: str | None = _said(
        "log",
        "--position-command NAME",
        "the log's column of commands, for --gains (default: found by its name)",
        "data.columns.position_command",
    )
    rows: Mapping[str, Sequence[int]] | Sequence[int] | None = _said(
        "log",
        "--rows FIRST,LAST ...",
        "rows of the logs to use, from 1; LOG=FIRST,LAST for one of them",
        "data.recordings.rows",
        read=words.rows("--rows FIRST,LAST or LOG=FIRST,LAST"),
    )
    omit: Mapping[str, Sequence[int]] | Sequence[int] | None = _said(
        "log",
        "--omit ROW,ROW ...",
        "broken rows of the logs, from 1; LOG=ROW,ROW for one of them",
        "data.recordings.omit",
        read=words.rows("--omit ROW,ROW or LOG=ROW,ROW"),
    )
    max_gap: float | None = _said(
        "log",
        "--max-gap SECONDS",
        "longest step between samples; a log is cut at longer ones (default: ten times "
        "the usual step)",
        "data.preparation.max_gap",
        read=words.positive("--max-gap"),
    )
    most_joint_speed: "float | Literal['model'] | None" = _said(
        "log",
        "--most-joint-speed SPEED",
        "leave out the rows of a joint that is faster, rad/s or m/s; model: than the "
        "model's speed limit of each joint (default: all rows count)",
        "data.preparation.most_joint_speed",
        read=words.speed,
    )
    duplicates: Literal["refuse", "first", "last"] | None = _said(
        "log",
        "--duplicates",
        "the row that is used of several with one time stamp (default: refuse)",
        "data.duplicates",
        choices=("refuse", "first", "last"),
    )
    missing: Literal["refuse", "omit"] | None = _said(
        "log",
        "--missing",
        "rows with empty or NaN values: refused, or left out (default: refuse)",
        "data.missing",
        choices=("refuse", "omit"),
    )
    wraps: Literal["keep", "undo"] | None = _said(
        "log",
        "--wraps",
        "jumps of the position by whole turns: as they are, or undone (default: keep)",
        "data.wraps",
        choices=("keep", "undo"),
    )
    position_scale: Mapping[str, float] | None = _said(
        "log",
        "--position-scale JOINT=FACTOR ...",
        "factor from a joint's position and velocity in the log to the model's: -1 if "
        "its axis is reversed",
        "data.position_scale",
        read=words.values("--position-scale JOINT=FACTOR"),
    )
    position_offset: Mapping[str, float] | None = _said(
        "log",
        "--position-offset JOINT=VALUE ...",
        "rad or m that are added to a joint's position in the log, if its zero is not "
        "the model's",
        "data.position_offset",
        read=words.values("--position-offset JOINT=VALUE"),
    )
    coupled: Mapping[str, str] | None = _said(
        "log",
        "--coupled JOINT=JOINT ...",
        "joints whose position in the log is the sum with another's, as of a forearm "
        "given against the horizontal: J3=J2, or J3=-J2 if it is the difference",
        "data.coupled",
        read=words.pairs("--coupled JOINT=JOINT or JOINT=-JOINT"),
    )
    angular_velocity: words.Names | None = _said(
        "base",
        "--angular-velocity NAMES",
        "gyroscope, rad/s: gx,gy,gz or an array",
        "data.base.angular_velocity",
        read=words.columns,
    )
    acceleration: words.Names | None = _said(
        "base",
        "--acceleration NAMES",
        "accelerometer, m/s^2 with gravity: ax,ay,az or an array",
        "data.base.acceleration",
        read=words.columns,
    )
    base_position: words.Names | None = _said(
        "base",
        "--base-position NAMES",
        "place of the base in the world, m: x,y,z or an array",
        "data.base.position",
        read=words.columns,
    )
    orientation: words.Names | None = _said(
        "base",
        "--orientation NAMES",
        "quaternion of the base: four columns or an array",
        "data.base.orientation",
        read=words.columns,
    )
    quaternion: Literal["xyzw", "wxyz"] | None = _said(
        "base",
        "--quaternion",
        "place of its real part: last (ROS, Isaac Gym) or first (MuJoCo)",
        "data.base.order",
        choices=("xyzw", "wxyz"),
    )
    imu: str | None = _said(
        "base", "--imu FRAME", "frame of the robot's file at which the unit is mounted"
    )
    contacts: Mapping[str, str] | None = _said(
        "base",
        "--contact FRAME=COLUMN ...",
        "flag of a foot, or FRAME=always; none: no contacts",
        "data.contacts",
        read=words.contacts,
    )
    bodies: Literal["identified", "model"] | None = _said(
        "model",
        "--bodies",
        "identify bodies, or take those of the model and identify the drives "
        "(default: identified)",
        "constraints.bodies",
        choices=("identified", "model"),
    )
    masses: Literal["datasheet", "free"] | None = _said(
        "model",
        "--masses",
        "take the masses of the model, or leave them free",
        "constraints.masses",
        read=words.masses,
        choices=("model", "free"),
    )
    drive: Sequence[str] | None = _said(
        "model",
        "--drive TERM ...",
        "drive terms of all joints, such as viscous coulomb offset; other terms for "
        "one joint: JOINT=viscous,coulomb",
        "drive",
        read=tuple,
    )
    cutoff: float | None = _said(
        "model",
        "--cutoff HZ",
        "cut-off of the motion",
        "data.preparation.motion_cutoff",
        read=words.positive("--cutoff"),
    )
    friction_velocity: float | None = _said(
        "model",
        "--friction-velocity V",
        "width of friction's change of sign, rad/s or m/s",
        "drive.velocity_scale",
        read=words.positive("--friction-velocity"),
    )
    band: float | None = _said(
        "selection",
        "--band HZ",
        "frequency up to which torque is to be predicted (default: 20 times the band "
        "of the velocity)",
        read=words.positive("--band"),
    )
    keep: Sequence[str] = _said(
        "selection",
        "--keep KIND ...",
        "settings that stay as in the file or the plain model, such as masses, delay, "
        "coupling, least_speed, motion_cutoff or drive terms",
        default=(),
        read=tuple,
    )
    select: bool | None = _said(
        "selection",
        "--no-select",
        "use viscous and Coulomb friction and an offset; choose only a cut-off",
        read=words.switched_off,
    )

    def __post_init__(self) -> None:
        if isinstance(self.torque_gain, int | float):
            object.__setattr__(self, "torque_gain", (float(self.torque_gain),))
        for name in ("rows", "omit"):
            value = getattr(self, name)
            if value is not None and not isinstance(value, Mapping):
                object.__setattr__(self, name, {EVERY: tuple(value)})
        for folder in self.package_dirs:
            if not Path(folder).is_dir():
                raise ProblemError(
                    f"--package-dirs (package_dirs): {folder} is no folder; name the "
                    "folders of the packages that the robot's meshes are in, or those "
                    "above them"
                )
        if not isinstance(self.validation, list | tuple):
            object.__setattr__(self, "validation", (self.validation,))
        if self.bodies == "model" and self.masses == "free":
            raise ProblemError(
                "masses are free and bodies are those of the model, which have masses; "
                "leave one of the two out"
            )

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the fields that are stated."""
        return tuple(
            f.name for f in fields(self) if not _same(getattr(self, f.name), f.default)
        )

    def of_part(self, *parts: Part) -> tuple[str, ...]:
        """Return the names of the fields of some parts that are stated."""
        return tuple(n for n in self.given if declarations()[n].part in parts)

    def rows_of(self, log: Path) -> tuple[int, int] | None:
        """Return the first and the last used row of a log, from 1.

        Raises
        ------
        ProblemError
            If they are not two numbers.
        """
        rows = self._of_log(self.rows, log)
        if rows is None:
            return None
        if len(rows) != 2 or not 1 <= rows[0] < rows[1]:
            raise ProblemError(
                f"rows of {log}: {','.join(map(str, rows))}, expected the first and "
                "the last, counted from 1"
            )
        return rows[0], rows[1]

    def omitted_of(self, log: Path) -> tuple[int, ...]:
        """Return the rows of a log to leave out, from 1."""
        return self._of_log(self.omit, log) or ()

    def require_logs(self, logs: Iterable[Path]) -> None:
        """Refuse rows of a log that is not among those given.

        Raises
        ------
        ProblemError
            The message names the logs.
        """
        known = {name: log.name for log in logs for name in _names_of(log)}
        for field_name in ("rows", "omit"):
            for name in getattr(self, field_name) or ():
                if name != EVERY and name not in known:
                    logs_given = ", ".join(dict.fromkeys(known.values()))
                    raise ProblemError(
                        f"--{field_name} {name}=...: no log {name!r}; known: "
                        f"{logs_given}"
                    )

    def _of_log(self, stated: Any, log: Path) -> tuple[int, ...] | None:
        """Return the value stated for a log, by its path or name, or for all logs."""
        for name in (*_names_of(log), EVERY):
            if stated is not None and name in stated:
                return tuple(stated[name])
        return None


def _names_of(log: Path) -> tuple[str, ...]:
    """Return the names by which rows of a log are stated."""
    return str(log), log.as_posix(), log.name


def _same(value: object, default: object) -> bool:
    """Return whether a value, which may be an array, is the default."""
    return value is default or (isinstance(value, tuple | list) and list(value) == [])


_DECLARED: dict[str, Declaration] = {
    f.name: f.metadata["declaration"] for f in fields(Statement)
}


def declarations() -> Mapping[str, Declaration]:
    """Return the declaration of each field of `Statement`, by its name."""
    return _DECLARED


def statement_of(given: Mapping[str, Any]) -> Statement:
    """Return the statement that keywords make.

    Raises
    ------
    ProblemError
        If there is no such keyword; with the nearest one.
    """
    for name in given:
        if name not in _DECLARED:
            from consistent_id.robot.parameters import did_you_mean

            raise ProblemError(
                f"nothing {name!r} can be stated; {did_you_mean(name, _DECLARED)}"
            )
    return Statement(**given)


def statement_of_words(given: Mapping[str, Any]) -> Statement:
    """Return the statement that words of the shell make, None or empty for no words."""
    return Statement(
        **{
            name: declared.read(given[name])
            for name, declared in _DECLARED.items()
            if given.get(name) not in (None, (), [])
        }
    )


def with_keywords_of_a_statement(function: Callable[P, R]) -> Callable[P, R]:
    """Show the fields of `Statement` among a function's keywords.

    Its ``**stated`` takes them; ``help`` and editors of notebooks list them.
    """
    signature = inspect.signature(function)
    own = [p for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD]
    shown = [
        inspect.Parameter(
            f.name, inspect.Parameter.KEYWORD_ONLY, default=f.default, annotation=f.type
        )
        for f in fields(Statement)
    ]
    whole = signature.replace(parameters=[*own, *shown])
    function.__signature__ = whole  # type: ignore[attr-defined]
    return function
