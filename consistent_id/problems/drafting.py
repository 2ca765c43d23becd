"""From a robot and logs to the draft of a problem: what is guessed, and how."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from consistent_id.errors import ConsistentIdError, ProblemError, RecordingError
from consistent_id.estimation.cutoff import CutoffChoice, best_cutoff
from consistent_id.problems.draft import Draft, DraftRecording
from consistent_id.problems.file import DriveTable, PreparationTable
from consistent_id.problems.model import DEFAULT_DRIVE
from consistent_id.problems.preparation import prepared
from consistent_id.problems.robot_logs import RobotLogs, robot_logs
from consistent_id.problems.selection.select import select_model
from consistent_id.problems.selection.setup import DRIVE
from consistent_id.recordings.readers.units import Units
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import (
    estimated_period,
    resampled,
    split_at_gaps,
    standstill,
    trimmed,
)
from consistent_id.recordings.signals.clocks import is_uniform, own_rate
from consistent_id.regression.drive.drive_terms import DEFAULTS
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.chains import Selection
from consistent_id.robot.parameters import did_you_mean

_TRAINING = 0.7  # of the motion; the rest is for validation
_PERIOD = 0.02  # of the motion: shorter periods need no whole ones
_GAP = 10.0  # steps without a sample
_ALIKE = 1.25  # ratio of rates up to which one resampled rate does for both
_CUTOFFS = (2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 50.0)  # Hz
_SHARE = 0.2  # of the rate, up to which a cut-off is tried
_FOLDS = 6
_SWITCHES = tuple(name for name, value in DEFAULTS.items() if value in (False, "none"))
_LOW = 5.0  # Hz; a choice among higher ones alone would be none


class _Clock(NamedTuple):
    resample: float | None  # Hz
    max_gap: float | None  # s


def draft_problem(
    model: str | Path,
    log: str | Path | Sequence[str | Path],
    *,
    validation: Sequence[str | Path] = (),
    columns: Mapping[str, str] | None = None,
    units: Units | None = None,
    torque_joints: Sequence[str] = (),
    selection: Selection | None = None,
    torque_gain: Sequence[float] = (),
    masses: Literal["datasheet", "free"] | None = None,
    drive: Sequence[str] | None = None,
    cutoff: float | None = None,
    band: float | None = None,
    select: bool = True,
    progress: bool = False,
) -> Draft:
    """Draft the problem of identifying a robot from one log or several.

    Joints and columns are matched by name, the clock is made uniform, what stands still
    at either end is left out, and `select_model` chooses the model on what is for
    training.  Without logs for validation, the last 30 % of each log's motion are.

    Parameters
    ----------
    model : str or Path
        URDF or MJCF.
    log : str or Path, or a sequence of them
        To learn from; see `read_recording`.  All have the columns of the first.
    validation : sequence of str or Path
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
        Drive terms of all joints, such as ``["viscous", "coulomb", "offset"]``; by
        default chosen.
    cutoff : float, optional, [Hz]
        Of the motion; by default chosen.
    band : float, optional, [Hz]
        Up to which torque is to be predicted; see `select_model`.
    select : bool
        Whether a model is chosen; else it is viscous and Coulomb friction with an
        offset, and a cut-off of `best_cutoff`.
    progress : bool
        Whether the choice shows on the standard error how far it is.

    Raises
    ------
    ModelError, RecordingError
        If a file cannot be read, or columns cannot be guessed.
    ProblemError
        If no log is given, or one is given twice.
    """
    model = Path(model)
    given = [log] if isinstance(log, str | Path) else log
    training, held_out = [Path(file) for file in given], [Path(f) for f in validation]
    _require_distinct(training, held_out)
    logs = robot_logs(
        model,
        training[0],
        columns=columns,
        units=units,
        torque_joints=torque_joints,
        selection=selection,
        torque_gain=torque_gain,
    )
    raws = {file: logs.read(file) for file in training}
    clock = _clock(list(raws.values()))
    entries, parts = list[DraftRecording](), list[Recording]()
    for file, raw in raws.items():
        start, stop = _moving(raw, clock)
        middle = stop if held_out else start + _training(raw, stop - start)
        entries += _entries(file, raw, start, middle, stop)
        parts.append(trimmed(raw, start, middle))
    table = DEFAULT_DRIVE if drive is None else _drive_table(drive)
    if cutoff is not None:
        chosen, reason = cutoff, f"{cutoff:g} Hz, as was asked for"
    elif select:
        chosen, reason = _fallback(parts), "the plain default"
    else:
        torque_model = TorqueModel(
            logs.robot, table.terms, torque_joints=tuple(logs.columns.torque_joints)
        )
        chosen, reason = _cutoff(torque_model, parts, clock)
    known = any(link.datasheet.mass is not None for link in logs.robot.links)
    draft = Draft(
        model=model,
        recordings=tuple(sorted(entries, key=lambda entry: entry.role)),
        joints=logs.robot.joint_names,
        held=logs.locked,
        base=None if selection is None else selection.base,
        tip=None if selection is None else selection.tip,
        columns=logs.columns,
        torque_gain=tuple(torque_gain),
        rate=own_rate(raws[training[0]]),
        resample=clock.resample,
        max_gap=clock.max_gap,
        cutoff=chosen,
        cutoff_reason=reason,
        masses=(masses or "datasheet") if known else "free",
        raw=raws,
        notes=logs.notes,
        drive=table,
    )
    if select:
        fixed_values = {"masses": masses, "motion_cutoff": cutoff}
        fixed = [kind for kind, value in fixed_values.items() if value is not None]
        if drive is not None:
            fixed += [kind for kind in DRIVE if kind != "velocity_scale"]
        draft = _with_model(draft, fixed, band, progress)
    return _with_validation(draft, held_out, logs, clock)


def _with_validation(
    draft: Draft, held_out: Sequence[Path], logs: RobotLogs, clock: _Clock
) -> Draft:
    """Return a draft with logs for validation, read when its model is fixed."""
    raws, entries = dict(draft.raw), list(draft.recordings)
    for file in held_out:
        raws[file] = logs.read(file)
        rows = _rows(raws[file], *_moving(raws[file], clock))
        entries.append(DraftRecording(file, "validation", rows))
    return replace(draft, raw=raws, recordings=tuple(entries))


def _with_model(
    draft: Draft, fixed: Sequence[str], band: float | None, progress: bool
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


def _drive_table(names: Sequence[str]) -> DriveTable:
    """Return the drive terms of these names; those with shapes have usual ones."""
    for name in names:
        if name not in _SWITCHES:
            near = did_you_mean(name, _SWITCHES)
            raise ProblemError(f"no drive term {name!r}; {near}")
    keys: dict[str, Any] = dict.fromkeys(names, True)
    if keys.pop("coulomb", False):
        width = DEFAULT_DRIVE.velocity_scale
        keys |= {"coulomb": "tanh", "velocity_scale": width}
    return DriveTable(**keys)


def _fallback(training: Sequence[Recording]) -> float:
    """Return a cut-off [Hz] that no data have chosen."""
    top = _SHARE * min(own_rate(part) for part in training)
    return float(f"{min(10.0, top):.2g}")


def _require_distinct(training: Sequence[Path], held_out: Sequence[Path]) -> None:
    every = [*training, *held_out]
    if not training:
        raise ProblemError("no log to learn from, expected at least one")
    for file in every:
        if every.count(file) > 1:
            raise ProblemError(
                f"{file} is given twice; a log is for training or for validation"
            )


def _entries(
    file: Path, raw: Recording, start: float, middle: float, stop: float
) -> list[DraftRecording]:
    """Return the rows that are for training and, after the middle, for validation."""
    first, last = _rows(raw, start, middle)
    if middle >= stop:
        return [DraftRecording(file, "training", (first, last))]
    last -= 1
    end = _rows(raw, start, stop)[1]
    return [
        DraftRecording(file, "training", (first, last)),
        DraftRecording(file, "validation", (last + 1, end)),
    ]


def _rows(raw: Recording, start: float, stop: float) -> tuple[int, int]:
    """Return the first and the last row between two times, counted from 1."""
    first, last = np.searchsorted(raw.time, [start, stop]).tolist()
    return first + 1, min(last + 1, len(raw))


def _training(raw: Recording, duration: float) -> float:
    """Return how long the training lasts [s]: whole periods, where motion repeats."""
    share = _TRAINING * duration
    try:
        period = estimated_period(raw, shortest=_PERIOD * duration)
    except RecordingError:
        return share
    whole = int(duration / period)
    if whole < 2:
        return share
    return period * min(max(round(_TRAINING * whole), 1), whole - 1)


def _clock(raws: Sequence[Recording]) -> _Clock:
    """Return what makes the logs' clocks uniform.

    Raises
    ------
    RecordingError
        If one uniform rate does not do for all.
    """
    rates = [own_rate(raw) for raw in raws]
    steps = [
        float(np.diff(raw.time).max()) * rate
        for raw, rate in zip(raws, rates, strict=True)
    ]
    max_gap = float(f"{_GAP / min(rates):.3g}") if max(steps) > _GAP else None
    if all(is_uniform(raw) for raw in raws):
        return _Clock(None, max_gap)
    if max(rates) > _ALIKE * min(rates):
        seen = ", ".join(
            f"{raw.name} {rate:.4g} Hz" for raw, rate in zip(raws, rates, strict=True)
        )
        raise RecordingError(
            f"clocks jitter, and the logs' rates differ too much to be resampled to "
            f"one: {seen}. Resample the faster ones first"
        )
    return _Clock(float(f"{min(rates):.4g}"), max_gap)


def _moving(raw: Recording, clock: _Clock) -> tuple[float, float]:
    """Return when the first joint begins to move, and when the last one stops [s]."""
    low = min(10.0, _SHARE * own_rate(raw))
    table = PreparationTable(
        max_gap=clock.max_gap, resample=clock.resample, motion_cutoff=low
    )
    times = [
        part.time[~standstill(part).all(axis=1)]
        for part in prepared(raw, table)
        if part.velocity is not None and part.velocity.any()
    ]
    moving = np.concatenate([np.empty(0), *times])
    if len(moving) < 2:
        raise RecordingError(f"{raw.name}: no joint ever moves")
    return float(moving[0]), float(moving[-1])


def _cutoff(
    model: TorqueModel, training: Sequence[Recording], clock: _Clock
) -> tuple[float, str]:
    """Return the cut-off [Hz], and why it is that."""
    top = _SHARE * min(own_rate(part) for part in training)
    fallback = _fallback(training)
    try:
        chosen = _chosen(model, training, clock, top)
    except ConsistentIdError as cause:
        return fallback, f"{fallback:g} Hz, as none could be chosen ({cause})"
    tried = ", ".join(f"{f:g}" for f in chosen.motion)
    return chosen.motion_cutoff, (
        f"of {tried} Hz the one with which the training rows predict each other best"
    )


def _chosen(
    model: TorqueModel, training: Sequence[Recording], clock: _Clock, top: float
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
    tried = [cutoff for cutoff in _CUTOFFS if 1.02 * least < cutoff <= top]
    return best_cutoff(model, parts, tried, folds=_FOLDS)
