"""From a robot and logs to the draft of a problem."""

import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from consistent_id.errors import ConsistentIdError, ProblemError, RecordingError
from consistent_id.problems.draft import ONE_SAMPLE, Draft, DraftRecording
from consistent_id.problems.draft_reading import (
    DraftCutoff,
    DraftReading,
    draft_cutoff,
    drive_of,
    poor_velocity,
    read_draft_logs,
    smoothed_velocity,
    usual_cutoff,
)
from consistent_id.problems.draft_rows import moving_rows
from consistent_id.problems.floating.floating_draft import standing_draft
from consistent_id.problems.found_logs import RobotLogs
from consistent_id.problems.log_entries import with_torque
from consistent_id.problems.overrides import StatedDrive
from consistent_id.problems.robot_logs import (
    GivenLog,
    GivenLogs,
    given_logs,
    robot_logs,
    with_options,
    with_remedies,
)
from consistent_id.problems.selection.model_selection import select_model
from consistent_id.problems.selection.setup import DRIVE, KINDS
from consistent_id.problems.statement import (
    Statement,
    statement_of,
    with_keywords_of_a_statement,
)
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers.recording_file import column_names
from consistent_id.recordings.readers.table_folder import one_recording
from consistent_id.recordings.signals import (
    Delay,
)
from consistent_id.recordings.signals.clocks import own_rate
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.parameters import did_you_mean

DRY = 0.05
"""Width of friction's change of sign where commands are to be replayed, [rad/s or m/s].
Friction of simulators is dry.  A wider change can fit torque better, because it
represents creep, play and lag, but replays worse: on held-out parts of the training
motion, rollouts of two real robots select 0.05 and less, and torque 0.1."""
_AS_LATE = (0.6, 1.5)  # the torque's delay over the velocity's, if they are one


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
    rows; less where a joint would otherwise not move in training.

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
        selected.  Logs for `validation` have the same forms as `log`; they are used
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
    logs = replace(logs, notes=(*given.notes, *logs.notes))
    stated = logs.stated
    if stated.friction_velocity is None and stated.gains is not None:
        stated = replace(stated, friction_velocity=DRY)
    try:
        reading = read_draft_logs(logs, given)
    except RecordingError as cause:
        if not cause.options or given.tables:
            raise
        raise with_remedies(cause, model, given.training[0], logs.stated, {}) from None
    note = smoothed_velocity(reading, stated) or poor_velocity(reading, stated)
    if note is not None:
        columns = replace(logs.columns, velocity=None)
        logs = replace(logs, columns=columns, notes=(*logs.notes, note))
        reading = read_draft_logs(logs, given)
    stated = replace(stated, missing=reading.logs.stated.missing)
    draft = _draft_of(reading, model, stated, progress)
    if reading.late is not None and _torque_as_late(draft, reading.late):
        both = read_draft_logs(logs, given, early=_rounded(reading.late.seconds))
        if smoothed_velocity(both, stated) is None:
            other = _draft_of(both, model, stated, progress)
            if not _torque_as_late(other, reading.late):
                reading, draft = both, other
    return _with_validation(draft, reading)


def _logs_of(model: Path, given: GivenLogs, stated: Statement) -> RobotLogs:
    """Find how to read the logs; the error names files that are one recording."""
    files = given.training
    try:
        return robot_logs(model, files[0], stated, tables=given.tables)
    except RecordingError as cause:
        folder = one_recording(files) if not given.tables else None
        alone = folder is None and not given.tables and not cause.options
        if alone and _other_columns(files):
            raise RecordingError(
                f"{cause} Each of {len(files)} files is read as a recording of its "
                "own, and they have different columns: if they are the channels of "
                "one, give a folder in which they are alone in place of them"
            ) from None
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


def _other_columns(files: Sequence[Path]) -> bool:
    """Return whether files of text have other columns than the first has."""
    known = [log_format(file) for file in files]
    if len(files) < 2 or not all(form.is_text and form.lists_names for form in known):
        return False
    return all({*column_names(f)} - {*column_names(files[0])} for f in files[1:])


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
    reading: DraftReading, model: Path, stated: Statement, progress: bool
) -> Draft:
    """Return a draft of training logs, with the model that is selected."""
    logs, raws = reading.logs, list(reading.raws.values())
    drive = drive_of(logs, stated)
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


def _torque_as_late(draft: Draft, velocity: Delay) -> bool:
    """Return whether torque and velocity have the same delay to the position."""
    if draft.selection is None:
        return False
    least, most = _AS_LATE
    late = draft.selection.choice.delay
    return least * velocity.seconds <= late <= most * velocity.seconds


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
    reading: DraftReading,
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


def _with_validation(draft: Draft, reading: DraftReading) -> Draft:
    """Return a draft with logs for validation, which are used when all is chosen."""
    stated, entries = reading.logs.stated, list(draft.recordings)
    for file, raw in reading.held_out.items():
        rows = moving_rows(with_torque(raw, stated.gains), file, reading.clock, stated)
        entries.append(DraftRecording(file, "validation", rows))
    raws = {**draft.raw, **reading.held_out}
    return replace(draft, raw=raws, recordings=tuple(entries))


def _with_delay(draft: Draft) -> Draft:
    """Return a draft with the delay of commands from its training rows.

    The delay with the best torque fit also compensates for errors of the model.  It is
    limited to one period, because a command reaches its drive before the next is sent.
    If that is its delay, it may be as long as the torque says, or longer by a period.
    """
    try:
        late = replace(draft, delay="estimated").problem().command_delay
    except ConsistentIdError as cause:
        note = f"commands are assumed to have no delay: none was found ({cause})"
        return replace(draft, notes=(*draft.notes, note))
    if late is None:
        return draft
    period = 1.0 / draft.rate
    found, error = min(late.seconds, period), late.bounded_error
    if found > ONE_SAMPLE * period:
        error = max(error, late.seconds - period, period)
    delay, error = (float(f"{value:.2g}") for value in (found, error))
    return replace(draft, delay=delay, delay_error=error)


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
