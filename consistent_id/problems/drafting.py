"""From a robot and logs to the draft of a problem."""

import shlex
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np

from consistent_id.errors import ConsistentIdError, ProblemError, RecordingError
from consistent_id.estimation.cutoff import CutoffChoice, best_cutoff
from consistent_id.problems.draft import Draft, DraftRecording
from consistent_id.problems.draft_rows import (
    SHARE,
    Clock,
    Split,
    clock_of,
    moving_rows,
    split_logs,
)
from consistent_id.problems.floating.floating_draft import standing_draft
from consistent_id.problems.given_logs import GivenLog, GivenLogs, given_logs
from consistent_id.problems.log_entries import with_torque
from consistent_id.problems.overrides import StatedDrive, stated_drive
from consistent_id.problems.robot_logs import (
    RobotLogs,
    robot_logs,
    with_options,
    with_remedies,
)
from consistent_id.problems.selection.model_selection import select_model
from consistent_id.problems.selection.setup import DRIVE, KINDS
from consistent_id.problems.stated_model import DEFAULT_DRIVE
from consistent_id.problems.statement import (
    Statement,
    statement_of,
    with_keywords_of_a_statement,
)
from consistent_id.recordings.readers.table_folder import one_recording
from consistent_id.recordings.recording import Recording, velocities
from consistent_id.recordings.signals import (
    Delay,
    Track,
    estimate_delay,
    resampled,
    split_at_gaps,
)
from consistent_id.recordings.signals.clocks import own_rate
from consistent_id.recordings.signals.derivatives import lost_acceleration
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.parameters import did_you_mean

DRY = 0.05
"""Width of friction's change of sign where commands are to be replayed, [rad/s or m/s].
Friction of simulators is dry.  A wider change can fit torque better, because it
represents creep, play and lag, but replays worse: on held-out parts of the training
motion, rollouts of two real robots select 0.05 and less, and torque 0.1."""
_CUTOFFS = (2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 50.0)  # Hz
_COMPARED = (3.0, 5.0, 10.0)  # Hz, for a log with its velocity and without
_WORSE = 1.05  # left-out error with a velocity over that without
_SMOOTHED = 0.01
"""Share of acceleration that a velocity may lack.  The columns of a UR10e and a KR300
lack 0.0005, those of a UR3 with jittered stamps 0.007."""
_SPECTRUM = 64  # samples, from which on it is computed
_SAME_SCALE = 0.03  # of a velocity whose integral is the position
_MOVING = 0.05  # rad or m of travel, from which on the scale is compared
_FOLDS = 6
_USUAL = 10.0  # Hz
_STANDING = 30.0
"""Hz, for a robot on its feet: a filter spreads friction's jump around reversals of
joints, and a lower cut-off leaves fewer rows (see `rest_guard`).
"""
_LOW = 5.0  # Hz; least cut-off that must be among those tried
_SURE = 5.0  # standard errors of the delay
_AS_LATE = (0.6, 1.5)  # the torque's delay over the velocity's, if they are one
_SAMPLES = 1.0  # sampling periods; less is below the resolution of the stamps


@dataclass(frozen=True, slots=True)
class DraftCutoff:
    """A cut-off [Hz], and the reason for it."""

    frequency: float
    reason: str


@with_keywords_of_a_statement
def draft_problem(
    model: str | Path,
    log: GivenLog | Sequence[GivenLog],
    *,
    progress: bool = False,
    **stated: Any,
) -> Draft:
    """Draft the problem of identifying a robot from one log or several.

    Joints and columns are matched by name, the clock is made uniform, standstill at
    either end is left out, and `select_model` selects the model from the training rows.
    Without logs for validation, the last 30 % of each log's motion are the validation
    rows.

    Parameters
    ----------
    model : str or Path
        URDF or MJCF.
    log : str, Path, table or Recording, or a list of them
        Training logs: files (see `read_recording`), or data frames, Arrow tables and
        mappings of arrays (see `recording_from`).  All have the columns of the first.
    progress : bool
        Whether to show the progress of the selection on the standard error.
    stated
        The user's statements, by the fields of `Statement`, such as
        ``torque="current{number}", masses="free"``; all other settings are found or
        selected.  Logs for `validation` have the same forms as `log`; they are read
        after the selection.  If bodies are the model's, no masses are selected; if the
        base floats, neither masses nor a model: bodies behind the base are those of the
        model.

    Raises
    ------
    ModelError, RecordingError
        If a file cannot be read, or columns cannot be guessed.
    ProblemError
        If no log is given, or one is given twice; if a keyword is unknown, or two
        statements contradict each other.

    Examples
    --------
    >>> import consistent_id as ci
    >>> folder = "problems/kuka_kr300"
    >>> log = f"{folder}/FF_A.csv"
    >>> draft = ci.draft_problem(f"{folder}/robot.urdf", log, select=False)
    >>> draft.problem().model.robot.joint_names[0]
    'joint_1'
    """
    return drafted(Path(model), log, statement_of(stated), progress=progress)


def drafted(
    model: Path,
    log: GivenLog | Sequence[GivenLog],
    stated: Statement,
    *,
    progress: bool = False,
) -> Draft:
    """Draft the problem of a robot and its logs from what is stated."""
    given = given_logs(log, stated.validation)
    stated.require_logs([*given.training, *given.validation])
    _require_kinds(stated.keep)
    logs = _logs_of(model, given, stated)
    stated = logs.stated
    if stated.friction_velocity is None and stated.gains is not None:
        stated = replace(stated, friction_velocity=DRY)
    try:
        reading = _reading(logs, given)
    except RecordingError as cause:
        if not cause.options or given.tables:
            raise
        raise with_remedies(cause, model, given.training[0], logs.stated, {}) from None
    note = _smoothed_velocity(reading, stated) or _poor_velocity(reading, stated)
    if note is not None:
        columns = replace(logs.columns, velocity=None)
        logs = replace(logs, columns=columns, notes=(*logs.notes, note))
        reading = _reading(logs, given)
    draft = _draft_of(reading, model, stated, progress)
    if reading.late is not None and _torque_as_late(draft, reading.late):
        both = _reading(logs, given, early=_rounded(reading.late.seconds))
        if _smoothed_velocity(both, stated) is None:
            other = _draft_of(both, model, stated, progress)
            if not _torque_as_late(other, reading.late):
                reading, draft = both, other
    return _with_validation(draft, given.validation, reading)


def _logs_of(model: Path, given: GivenLogs, stated: Statement) -> RobotLogs:
    """Find how to read the logs; the error names files that are one recording."""
    files = given.training
    try:
        return robot_logs(model, files[0], stated, tables=given.tables)
    except RecordingError as cause:
        folder = one_recording(files) if not given.tables else None
        if folder is None or _helps(cause, model, files[0], stated):
            raise
        said, more = "", ""
        try:
            robot_logs(model, folder, stated).read(folder)
        except RecordingError as of_folder:
            if not of_folder.options:
                raise cause from None
            said, more = f"\nThen {of_folder}", f" {of_folder.options}"
        except ConsistentIdError:
            raise cause from None
        names = ", ".join(file.name for file in files)
        raise RecordingError(
            f"{cause} But {names} cover the same time, or have as many rows: they are "
            f"one recording. Give their folder in place of them: {folder}{said}",
            options=f"{shlex.quote(str(folder))}{more}",
            replaces=[str(file) for file in files],
        ) from None


def _helps(cause: RecordingError, model: Path, log: Path, stated: Statement) -> bool:
    """Return whether the options of an error are enough to read the log by itself."""
    if not cause.options or cause.replaces:
        return False
    try:
        with_options(model, log, stated, cause.options)
    except ConsistentIdError:
        return False
    return True


def _draft_of(
    reading: "_Reading", model: Path, stated: Statement, progress: bool
) -> Draft:
    """Return a draft of training logs, with the model that is selected."""
    logs, raws = reading.logs, list(reading.raws.values())
    drive = _stated_drive(logs, stated)
    found = logs.floating
    standing = (
        None
        if found is None
        else standing_draft(found, logs.robot, raws, model, drive.common)
    )
    select = stated.select is not False
    on_feet = standing is not None and standing.rests
    chosen = _plain_cutoff(
        reading, drive, stated.cutoff, select or standing is not None, standing=on_feet
    )
    draft = Draft(
        model=model,
        recordings=tuple(sorted(reading.split.entries, key=lambda entry: entry.role)),
        stated=stated,
        joints=logs.robot.joint_names,
        held=logs.locked,
        columns=logs.columns,
        rate=own_rate(raws[0]),
        resample=reading.clock.resample,
        max_gap=reading.clock.max_gap,
        cutoff=chosen.frequency,
        cutoff_reason=chosen.reason,
        masses=_masses(logs, stated.masses),
        raw=reading.recordings,
        notes=logs.notes,
        drive=drive.common,
        joint_drives=drive.joints,
        standing=standing,
        early=reading.early,
    )
    if stated.gains is not None:
        draft = _with_delay(draft)
    if select and standing is None:
        draft = _with_model(draft, progress)
    return draft


def _smoothed_velocity(reading: "_Reading", stated: Statement) -> str | None:
    """Return why a log's velocity is not read: it lacks acceleration of the position.

    A filter without a delay makes it so.  Left-out rows do not show this, because their
    velocity is smoothed, too.  None, if the velocity is stated, or commands need it.
    """
    if stated.velocity is not None or stated.gains is not None:
        return None
    worst, joint, name = max(
        (found for part in reading.split.training for found in _lost(part, reading)),
        default=(0.0, "", ""),
    )
    if worst <= _SMOOTHED:
        return None
    return (
        f"the velocity of {name} is not read: it is smoothed, and lacks "
        f"{100 * worst:.2g} % of the acceleration of {joint}, which the positions "
        "have; name the column (--velocity) to read it anyway"
    )


def _lost(part: Recording, reading: "_Reading") -> Iterator[tuple[float, str, str]]:
    """Yield the share of acceleration that the velocity lacks, joint and recording."""
    longest = _longest(part, reading.clock)
    if part.velocity is None or len(longest) < _SPECTRUM:
        return
    moving = np.flatnonzero(np.ptp(longest.position, axis=0) > _MOVING)
    time = np.linspace(longest.time[0], longest.time[-1], len(longest))
    q, dq = (
        np.column_stack([np.interp(time, longest.time, x[:, j]) for j in moving])
        if len(moving)
        else np.zeros((len(time), 0))
        for x in (longest.position, velocities(longest))
    )
    lost = lost_acceleration(time, q, dq, highest=_USUAL)
    for j, share in zip(moving, lost, strict=True):
        yield float(share), part.joints[j], part.name


def _longest(log: Recording, clock: Clock) -> Recording:
    """Return the longest part between gaps."""
    if clock.max_gap is None:
        return log
    return max(split_at_gaps(log, clock.max_gap), key=len)


def _poor_velocity(reading: "_Reading", stated: Statement) -> str | None:
    """Return why a log's velocity is not read: without it, torque is predicted better.

    None, if it is read: it is stated, its left-out error is at most 5 % larger, or its
    scale contradicts the position's, which is a fault of the log that has to be seen.
    """
    parts = reading.split.training
    given = (stated.velocity, stated.gains, stated.cutoff)  # commands need it, too
    if any(value is not None for value in given):
        return None
    if reading.logs.floating is not None or any(p.velocity is None for p in parts):
        return None
    if not all(_of_one_scale(part, reading.clock) for part in parts):
        return None
    logs, drive = reading.logs, _stated_drive(reading.logs, stated)
    measured = tuple(logs.columns.torque_joints)
    terms = drive.terms(logs.robot.joint_names)
    model = TorqueModel(logs.robot, terms, torque_joints=measured)
    top = usual_cutoff(parts)
    bare = [replace(part, velocity=None) for part in parts]
    try:
        with_it, without = (
            float(_chosen(model, each, reading.clock, top, _COMPARED).error.min())
            for each in (parts, bare)
        )
    except ConsistentIdError:
        return None
    if with_it <= _WORSE * without:
        return None
    return (
        f"the velocity is not read: it predicts left-out rows {with_it / without:.2g} "
        "times worse than differentiated positions do; name the column (--velocity) to "
        "read it anyway"
    )


def _of_one_scale(log: Recording, clock: Clock) -> bool:
    """Return whether velocities, integrated, are the position in all moving joints."""
    longest = _longest(log, clock)
    t, q = longest.time - longest.time[0], longest.position
    speed = velocities(longest)
    steps = np.diff(t)[:, None] * 0.5 * (speed[1:] + speed[:-1])
    way = np.vstack([np.zeros(q.shape[1]), np.cumsum(steps, axis=0)])
    moving = np.ptp(q, axis=0) > _MOVING
    for j in np.flatnonzero(moving):
        columns = np.column_stack([way[:, j], t, np.ones(len(t))])
        (slope, *_), *_ = np.linalg.lstsq(columns, q[:, j], rcond=None)
        if abs(slope - 1.0) > _SAME_SCALE:
            return False
    return bool(moving.any())


def _torque_as_late(draft: Draft, velocity: Delay) -> bool:
    """Return whether torque and velocity have the same delay to the position."""
    if draft.selection is None:
        return False
    least, most = _AS_LATE
    late = draft.selection.choice.delay
    return least * velocity.seconds <= late <= most * velocity.seconds


class _Reading(NamedTuple):
    """Training logs by file: as recorded, with torque, and their rows in motion.

    `late` is the delay of a velocity that is not read for that reason, and `early` the
    time [s] by which the position is ahead of the other channels.
    """

    logs: RobotLogs
    recordings: dict[Path, Recording]
    raws: dict[Path, Recording]
    clock: Clock
    split: Split
    late: Delay | None
    early: float


def _reading(logs: RobotLogs, given: GivenLogs, *, early: float = 0.0) -> _Reading:
    """Read logs; delayed velocities are read only if their columns are given.

    If the position is stated to be early, the velocity is not late.
    """
    read = {file: logs.read(file) for file in given.training}
    late = None
    if early:
        note = (
            f"velocity and torque are both {1e3 * early:.3g} ms later than the "
            f"position: the position is moved, and the velocity is read"
        )
        logs = replace(logs, notes=(*logs.notes, note))
    elif logs.stated.velocity is None:
        logs, late = on_time(logs, read.values())
        if late is not None:
            read = {file: replace(raw, velocity=None) for file, raw in read.items()}
    raws = {file: with_torque(raw, logs.stated.gains) for file, raw in read.items()}
    clock = clock_of(list(raws.values()), logs.stated.max_gap)
    split = split_logs(raws, clock, logs.stated, whole=bool(given.validation))
    return _Reading(logs, read, raws, clock, split, late, early)


def _rounded(seconds: float) -> float:
    return float(f"{seconds:.2g}")


def _masses(
    logs: RobotLogs, masses: Literal["datasheet", "free"] | None
) -> Literal["datasheet", "free"]:
    """Return whether masses are known; if the model has none, they are free."""
    if all(link.datasheet.mass is None for link in logs.robot.links):
        return "free"
    return masses or ("free" if logs.robot.floating else "datasheet")


def _fixed(stated: Statement) -> set[str]:
    """Return the kinds of moves that the statement excludes."""
    by_field = {
        "masses": ["masses"],
        "cutoff": ["motion_cutoff"],
        "friction_velocity": ["velocity_scale"],
        "drive": [kind for kind in DRIVE if kind != "velocity_scale"],
    }
    fixed = [kind for name in stated.given for kind in by_field.get(name, ())]
    return {*stated.keep, *fixed}


def _plain_cutoff(
    reading: _Reading,
    drive: StatedDrive,
    given: float | None,
    select: bool,
    *,
    standing: bool,
) -> DraftCutoff:
    """Return the cut-off of a draft whose model has not been selected."""
    if given is not None:
        return DraftCutoff(given, f"{given:g} Hz, as stated")
    if select:
        usual = usual_cutoff(reading.split.training, standing=standing)
        return DraftCutoff(usual, "the plain default")
    logs = reading.logs
    measured = tuple(logs.columns.torque_joints)
    terms = drive.terms(logs.robot.joint_names)
    model = TorqueModel(logs.robot, terms, torque_joints=measured)
    return draft_cutoff(model, reading.split.training, reading.clock)


def _with_validation(
    draft: Draft, held_out: Sequence[Path], reading: _Reading
) -> Draft:
    """Return a draft with logs for validation, read after its model is chosen."""
    logs, raws, entries = reading.logs, dict(draft.raw), list(draft.recordings)
    for file in held_out:
        raws[file] = logs.read(file)
        raw = with_torque(raws[file], logs.stated.gains)
        rows = moving_rows(raw, file, reading.clock, logs.stated)
        entries.append(DraftRecording(file, "validation", rows))
    return replace(draft, raw=raws, recordings=tuple(entries))


def _with_delay(draft: Draft) -> Draft:
    """Return a draft with the delay of commands from its training rows.

    The delay with the best torque fit also compensates for errors of the model.  It is
    limited to one period, because a command reaches its drive before the next is sent.
    """
    try:
        found = replace(draft, delay="estimated").problem().delay_of_commands
    except ConsistentIdError as cause:
        note = f"commands are assumed to have no delay: none was found ({cause})"
        return replace(draft, notes=(*draft.notes, note))
    return replace(draft, delay=float(f"{min(found, 1.0 / draft.rate):.2g}"))


def _with_model(draft: Draft, progress: bool) -> Draft:
    """Return a draft with the model selected from its training rows, if possible."""
    fixed, band = _fixed(draft.stated), draft.stated.band
    try:
        chosen = select_model(
            draft.problem(), fixed=fixed, band=band, progress=progress
        )
    except ConsistentIdError as cause:
        reason = f"{draft.cutoff:g} Hz, as none could be chosen ({cause})"
        note = f"the model is the plain default, as none could be selected ({cause})"
        return replace(draft, cutoff_reason=reason, notes=(*draft.notes, note))
    return replace(draft, selection=chosen)


def _require_kinds(keep: Sequence[str]) -> None:
    for kind in keep:
        if kind not in KINDS:
            raise ProblemError(
                f"keep: nothing {kind!r} is chosen; {did_you_mean(kind, KINDS)}"
            )


def _stated_drive(logs: RobotLogs, stated: Statement) -> StatedDrive:
    """Return the stated drive, or the default one."""
    width = stated.friction_velocity
    if stated.drive is not None:
        return stated_drive(stated.drive, logs.robot.joint_names, width=width)
    plain = DEFAULT_DRIVE
    if width is not None:
        plain = msgspec.structs.replace(plain, velocity_scale=width)
    if stated.gains is not None or logs.robot.floating:
        # PD-controlled motors and those of legs have gears.
        plain = msgspec.structs.replace(plain, rotor_inertia=True)
    return StatedDrive(plain, {})


def usual_cutoff(training: Sequence[Recording], *, standing: bool = False) -> float:
    """Return a default cut-off [Hz]."""
    top = SHARE * min(own_rate(part) for part in training)
    return float(f"{min(_STANDING if standing else _USUAL, top):.2g}")


def draft_cutoff(
    model: TorqueModel, training: Sequence[Recording], clock: Clock
) -> DraftCutoff:
    """Return the cut-off with which training rows predict each other best."""
    top = SHARE * min(own_rate(part) for part in training)
    fallback = usual_cutoff(training)
    try:
        chosen = _chosen(model, training, clock, top)
    except ConsistentIdError as cause:
        return DraftCutoff(
            fallback, f"{fallback:g} Hz, as none could be chosen ({cause})"
        )
    tried = ", ".join(f"{f:g}" for f in chosen.motion)
    return DraftCutoff(
        chosen.motion_cutoff,
        f"of {tried} Hz the one with which the training rows predict each other best",
    )


def _chosen(
    model: TorqueModel,
    training: Sequence[Recording],
    clock: Clock,
    top: float,
    cutoffs: Sequence[float] = _CUTOFFS,
) -> CutoffChoice:
    parts = list(training)
    if clock.max_gap is not None:
        shortest = sum(part.duration for part in parts) / _FOLDS
        parts = [
            piece
            for part in parts
            for piece in split_at_gaps(part, clock.max_gap, shortest=shortest)
        ]
    if clock.resample is not None:
        parts = [
            resampled(part, clock.resample, max_gap=clock.max_gap) for part in parts
        ]
    # A quarter of a fold may be lost at each end to the lowest cut-off.
    least = 4.0 * _FOLDS / sum(part.duration for part in parts)
    if least > _LOW:
        raise RecordingError(f"the motion is too short to try {_LOW:g} Hz and less")
    tried = [cutoff for cutoff in cutoffs if 1.02 * least < cutoff <= top]
    return best_cutoff(model, parts, tried, folds=_FOLDS)


def on_time(
    logs: RobotLogs, training: Iterable[Recording]
) -> tuple[RobotLogs, Delay | None]:
    """Return how logs are read, without a delayed velocity, and that delay.

    Parameters
    ----------
    training : iterable of Recording
        As they were read; one late velocity suffices.
    """
    for raw in training:
        delay = velocity_delay(raw)
        if delay is not None:
            note = (
                f"the velocity of {raw.name} is {1e3 * delay.seconds:.3g} ms later "
                f"than the position: it is not read, and positions are "
                f"differentiated; name the column (--velocity) to read it anyway"
            )
            columns = replace(logs.columns, velocity=None)
            late = replace(logs, columns=columns, notes=(*logs.notes, note))
            return late, delay
    return logs, None


def velocity_delay(recording: Recording) -> Delay | None:
    """Return the delay of the velocity; None without a delay or a velocity."""
    if recording.velocity is None:
        return None
    joints, time, name = recording.joints, recording.time, recording.name
    position = Track("position", joints, time, recording.position, name)
    velocity = Track("velocity", joints, time, recording.velocity, name)
    try:
        delay = estimate_delay(position, velocity)
    except RecordingError:
        return None  # not of one motion: the diagnosis finds its content
    period = _SAMPLES / own_rate(recording)
    late = delay.seconds > max(period, _SURE * delay.standard_error)
    return delay if late else None
