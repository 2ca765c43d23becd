"""From a robot and logs to the draft of a problem: what is guessed, and how."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec

from consistent_id.errors import ConsistentIdError, ProblemError
from consistent_id.problems.draft import Draft, DraftRecording
from consistent_id.problems.draft_cutoff import DraftCutoff, draft_cutoff, usual_cutoff
from consistent_id.problems.draft_rows import (
    Clock,
    Split,
    clock_of,
    moving_rows,
    split_logs,
)
from consistent_id.problems.floating.hints import BaseHints
from consistent_id.problems.floating.standing_draft import standing_draft
from consistent_id.problems.given_logs import GivenLog, GivenLogs, given_logs
from consistent_id.problems.late_velocity import on_time
from consistent_id.problems.log_entries import with_torque
from consistent_id.problems.model import DEFAULT_DRIVE
from consistent_id.problems.robot_logs import RobotLogs, robot_logs
from consistent_id.problems.selection.select import select_model
from consistent_id.problems.selection.setup import DRIVE, KINDS
from consistent_id.problems.stated_drive import StatedDrive, stated_drive
from consistent_id.recordings.readers.units import Units
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains
from consistent_id.recordings.signals.clocks import own_rate
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.chains import Selection
from consistent_id.robot.parameters import did_you_mean

DRY = 0.05
"""Width of friction's change of sign where commands are to be replayed, [rad/s or m/s].
Friction of simulators is dry.  A wider change can fit torque better, as what is creep,
play and lag, and then replays worse: on parts of the training motion that were not
learnt from, rollouts of two real robots choose 0.05 and less, and torque 0.1."""


def draft_problem(
    model: str | Path,
    log: GivenLog | Sequence[GivenLog],
    *,
    validation: GivenLog | Sequence[GivenLog] = (),
    columns: Mapping[str, str] | None = None,
    units: Units | None = None,
    torque_joints: Sequence[str] = (),
    selection: Selection | None = None,
    torque_gain: Sequence[float] = (),
    masses: Literal["datasheet", "free"] | None = None,
    drive: Sequence[str] | None = None,
    cutoff: float | None = None,
    band: float | None = None,
    friction_velocity: float | None = None,
    keep: Sequence[str] = (),
    select: bool = True,
    progress: bool = False,
    gains: PDGains | None = None,
    bodies: Literal["identified", "model"] = "identified",
    base: BaseHints | None = None,
) -> Draft:
    """Draft the problem of identifying a robot from one log or several.

    Joints and columns are matched by name, the clock is made uniform, what stands still
    at either end is left out, and `select_model` chooses the model on what is for
    training.  Without logs for validation, the last 30 % of each log's motion are.

    Parameters
    ----------
    model : str or Path
        URDF or MJCF.
    log : str, Path, table or Recording, or a list of them
        To learn from: files (see `read_recording`), or data frames, Arrow tables and
        mappings of arrays (see `recording_from`).  All have the columns of the first.
    validation : str, Path, table or Recording, or a list of them
        Logs to judge by.  They are read when all else has been chosen.
    columns : mapping of str to str, optional
        Columns by channel, as in `Columns`, as far as they are known, such as
        ``{"torque": "current{number}"}``; the others are guessed from the
        log's names.
    units : mapping of str to str or sequence of str, optional
        Units by channel, as in `Columns`; the others are guessed from columns' names.
    torque_joints : sequence of str
        Joints whose torque the log has, if that is known.
    selection : Selection, optional
        The part of the robot that moves; of its joints, those that the log does not
        have are locked.
    torque_gain : sequence of float
        From the torque columns to torque: one for all joints, or one each.
    masses : {"datasheet", "free"}, optional
        Whether the model's masses are known; where it has none, they are free. By
        default the data may contradict them.
    drive : sequence of str, optional
        Drive terms of all joints, such as ``["viscous", "coulomb", "offset"]``, and of
        one joint in their place, ``"wrist=viscous,coulomb"``; by default chosen.
    cutoff : float, optional, [Hz]
        Of the motion; by default chosen.
    band : float, optional, [Hz]
        Up to which torque is to be predicted; see `select_model`.
    friction_velocity : float, optional, [rad/s or m/s]
        Width of friction's change of sign (`velocity_scale`); by default chosen, and
        `DRY` for logs of commands.
    keep : sequence of str
        Of what `select_model` chooses, what stays as in the plain model.
    select : bool
        Whether a model is chosen; else it is viscous and Coulomb friction with an
        offset, and a cut-off of `best_cutoff`.
    progress : bool
        Whether the choice shows on the standard error how far it is.
    gains : PDGains, optional
        Of PD-controlled joints: torque is then computed from commands of position.
    bodies : {"identified", "model"}
        Whether bodies are identified, or those of the model are the robot's.
    base : BaseHints, optional
        What is known of the columns of a floating base and its contacts.  No model is
        chosen for such a robot: bodies behind the base are those of the model.

    Raises
    ------
    ModelError, RecordingError
        If a file cannot be read, or columns cannot be guessed.
    ProblemError
        If no log is given, or one is given twice; or bodies are the model's and masses
        are free.
    """
    model = Path(model)
    given = given_logs(log, validation)
    _require_known_bodies(bodies, masses)
    _require_kinds(keep)
    logs = robot_logs(
        model,
        given.training[0],
        tables=given.tables,
        columns=columns,
        units=units,
        torque_joints=torque_joints,
        selection=selection,
        torque_gain=torque_gain,
        gains=gains,
        base=base,
    )
    reading = _reading(logs, given, columns)
    logs, raws = reading.logs, list(reading.raws.values())
    if friction_velocity is None and gains is not None:
        friction_velocity = DRY
    stated = _stated(logs, drive, friction_velocity)
    standing = standing_draft(logs, raws, model, stated.common)
    select, searched = select and standing is None, select or standing is not None
    on_feet = standing is not None and standing.rests
    chosen = _plain_cutoff(reading, stated, cutoff, searched, standing=on_feet)
    draft = Draft(
        model=model,
        recordings=tuple(sorted(reading.split.entries, key=lambda entry: entry.role)),
        joints=logs.robot.joint_names,
        held=logs.locked,
        base=None if selection is None else selection.base,
        tip=None if selection is None else selection.tip,
        columns=logs.columns,
        torque_gain=tuple(torque_gain),
        rate=own_rate(raws[0]),
        resample=reading.clock.resample,
        max_gap=reading.clock.max_gap,
        cutoff=chosen.frequency,
        cutoff_reason=chosen.reason,
        masses=_masses(logs, masses),
        raw=reading.recordings,
        notes=logs.notes,
        drive=stated.common,
        joint_drives=stated.joints,
        gains=gains,
        bodies=bodies,
        standing=standing,
    )
    if gains is not None:
        draft = _with_delay(draft)
    if select:
        fixed = {*keep, *_fixed(masses, cutoff, drive, friction_velocity)}
        draft = _with_model(draft, fixed, band, progress)
    return _with_validation(draft, given.validation, reading)


class _Reading(NamedTuple):
    """Training logs by file, as recorded and with torque; what moves of them."""

    logs: RobotLogs
    recordings: dict[Path, Recording]
    raws: dict[Path, Recording]
    clock: Clock
    split: Split


def _reading(
    logs: RobotLogs, given: GivenLogs, columns: Mapping[str, str] | None
) -> _Reading:
    """Read logs, without velocities that come late unless their columns are given."""
    read = {file: logs.read(file) for file in given.training}
    if "velocity" not in (columns or {}):
        logs = on_time(logs, read.values())
        if logs.columns.velocity is None:
            read = {file: replace(raw, velocity=None) for file, raw in read.items()}
    raws = {file: with_torque(raw, logs.gains) for file, raw in read.items()}
    clock = clock_of(list(raws.values()))
    split = split_logs(raws, clock, whole=bool(given.validation))
    return _Reading(logs, read, raws, clock, split)


def _masses(
    logs: RobotLogs, masses: Literal["datasheet", "free"] | None
) -> Literal["datasheet", "free"]:
    """Return whether masses are known; where the model has none, they are free."""
    if all(link.datasheet.mass is None for link in logs.robot.links):
        return "free"
    return masses or ("free" if logs.robot.floating else "datasheet")


def _fixed(
    masses: str | None,
    cutoff: float | None,
    drive: Sequence[str] | None,
    friction_velocity: float | None,
) -> list[str]:
    """Return what is given, and not chosen."""
    given = {
        "masses": masses,
        "motion_cutoff": cutoff,
        "velocity_scale": friction_velocity,
    }
    fixed = [kind for kind, value in given.items() if value is not None]
    if drive is not None:
        fixed += [kind for kind in DRIVE if kind != "velocity_scale"]
    return fixed


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
        return DraftCutoff(given, f"{given:g} Hz, as was asked for")
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
    """Return a draft with logs for validation, read when its model is fixed."""
    logs, raws, entries = reading.logs, dict(draft.raw), list(draft.recordings)
    for file in held_out:
        raws[file] = logs.read(file)
        rows = moving_rows(with_torque(raws[file], logs.gains), reading.clock)
        entries.append(DraftRecording(file, "validation", rows))
    return replace(draft, raw=raws, recordings=tuple(entries))


def _with_delay(draft: Draft) -> Draft:
    """Return a draft with the delay of commands that its training rows ask for.

    The delay with which torque fits best also takes up what the model lacks; but a
    command reaches its drive before the next is sent.
    """
    try:
        found = replace(draft, delay="estimated").problem().delay_of_commands
    except ConsistentIdError as cause:
        note = f"commands are taken to be on time, as no delay was found ({cause})"
        return replace(draft, notes=(*draft.notes, note))
    return replace(draft, delay=float(f"{min(found, 1.0 / draft.rate):.2g}"))


def _with_model(
    draft: Draft, fixed: Collection[str], band: float | None, progress: bool
) -> Draft:
    """Return a draft with the model that its training rows ask for, if they do."""
    try:
        chosen = select_model(
            draft.problem(), fixed=fixed, band=band, progress=progress
        )
    except ConsistentIdError as cause:
        reason = f"{draft.cutoff:g} Hz, as none could be chosen ({cause})"
        note = f"the model is the plain default, as none could be chosen ({cause})"
        return replace(draft, cutoff_reason=reason, notes=(*draft.notes, note))
    return replace(draft, selection=chosen)


def _require_known_bodies(bodies: str, masses: str | None) -> None:
    if bodies == "model" and masses == "free":
        raise ProblemError(
            "masses are free and bodies are those of the model, which have masses; "
            "leave one of the two out"
        )


def _require_kinds(keep: Sequence[str]) -> None:
    for kind in keep:
        if kind not in KINDS:
            raise ProblemError(
                f"keep: nothing {kind!r} is chosen; {did_you_mean(kind, KINDS)}"
            )


def _stated(
    logs: RobotLogs, words: Sequence[str] | None, width: float | None
) -> StatedDrive:
    """Return the drive that is asked for, or that of which nothing is known."""
    if words is not None:
        return stated_drive(words, logs.robot.joint_names, width=width)
    plain = DEFAULT_DRIVE
    if width is not None:
        plain = msgspec.structs.replace(plain, velocity_scale=width)
    if logs.gains is not None or logs.robot.floating:
        # PD-controlled motors and those of legs have gears.
        plain = msgspec.structs.replace(plain, rotor_inertia=True)
    return StatedDrive(plain, {})
