"""From a robot and a log to the draft of a problem: what is guessed, and how."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from consistent_id.errors import ConsistentIdError, ProblemError, RecordingError
from consistent_id.estimation.cutoff import CutoffChoice, best_cutoff
from consistent_id.problems.draft import Draft
from consistent_id.problems.file import PreparationTable
from consistent_id.problems.model import DEFAULT_DRIVE
from consistent_id.problems.preparation import prepared
from consistent_id.recordings.column_guess import guess_columns, require_torque
from consistent_id.recordings.readers import read_recording
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import (
    PDGains,
    commanded,
    estimated_period,
    resampled,
    split_at_gaps,
    standstill,
    trimmed,
)
from consistent_id.recordings.signals.clocks import is_uniform, own_rate
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.chains import Selection
from consistent_id.robot.loaders import load_robot

_TRAINING = 0.7  # of the motion; the rest is for validation
_PERIOD = 0.02  # of the motion: shorter periods need no whole ones
_GAP = 10.0  # steps without a sample
_CUTOFFS = (2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 50.0)  # Hz
_SHARE = 0.2  # of the rate, up to which a cut-off is tried
_FOLDS = 6
_LOW = 5.0  # Hz; a choice among higher ones alone would be none


def draft_problem(
    model: str | Path,
    log: str | Path,
    *,
    columns: Mapping[str, str] | None = None,
    torque_joints: Sequence[str] = (),
    selection: Selection | None = None,
    torque_gain: Sequence[float] = (),
    masses: Literal["datasheet", "free"] = "datasheet",
    gains: PDGains | None = None,
    bodies: Literal["identified", "model"] = "identified",
) -> Draft:
    """Draft the problem of identifying a robot from one log.

    Joints and columns are matched by name, the clock is made uniform, what stands still
    at either end is left out, the last 30 % of the motion are kept for validation, and
    the cut-off is chosen by `best_cutoff` on the rest.

    Parameters
    ----------
    model : str or Path
        URDF or MJCF.
    log : str or Path
        See `read_recording`.
    columns : mapping of str to str, optional
        Columns by channel, as in `Columns`, as far as they are known, such as
        ``{"torque": "current{number}"}``; the others are guessed from the
        log's names.
    torque_joints : sequence of str
        Joints whose torque the log has, if that is known.
    selection : Selection, optional
        The part of the robot that moves; of its joints, those that the log does not
        have are locked.
    torque_gain : sequence of float
        From the torque columns to torque: one for all joints, or one each.
    masses : {"datasheet", "free"}
        Whether the model's masses are known; where it has none, they are free.
    gains : PDGains, optional
        Of PD-controlled joints: torque is then computed from commands of position.
    bodies : {"identified", "model"}
        Whether bodies are identified, or those of the model are the robot's.

    Raises
    ------
    ModelError, RecordingError
        If a file cannot be read, or columns cannot be guessed.
    """
    model, log = Path(model), Path(log)
    selection = Selection() if selection is None else selection
    robot = load_robot(model, **asdict(selection))
    guess = guess_columns(
        log,
        robot.joint_names,
        columns,
        torque_joints=torque_joints,
        commands=gains is not None,
    )
    require_torque(guess.columns.torque, torque_gain)
    locked = tuple(name for name in robot.joint_names if name not in guess.joints)
    if locked:
        robot = load_robot(model, **asdict(replace(selection, joints=guess.joints)))
    gain = gains_of(torque_gain, len(guess.joints))
    read = read_recording(log, guess.joints, guess.columns, torque_gain=gain)
    raw = read if gains is None else replace(commanded(read, gains), velocity=None)
    known = any(link.datasheet.mass is not None for link in robot.links)
    clock = _clock(raw)
    start, stop = _moving(raw, clock)
    middle = start + _training(raw, stop - start)
    measured = tuple(guess.columns.torque_joints)
    torque_model = TorqueModel(robot, DEFAULT_DRIVE.terms, torque_joints=measured)
    cutoff, reason = _cutoff(torque_model, trimmed(raw, start, middle), clock)
    first, last, end = np.searchsorted(raw.time, [start, middle, stop]).tolist()
    return Draft(
        model=model,
        log=log,
        joints=guess.joints,
        locked=locked,
        base=selection.base,
        tip=selection.tip,
        columns=guess.columns,
        torque_gain=tuple(torque_gain),
        rate=own_rate(raw),
        resample=clock.resample,
        max_gap=clock.max_gap,
        cutoff=cutoff,
        cutoff_reason=reason,
        training=(first + 1, last),
        validation=(last + 1, end + 1),
        masses=masses if known else "free",
        raw=read,
        gains=gains,
        bodies=bodies,
        notes=guess.notes,
    )


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


class _Clock(NamedTuple):
    resample: float | None  # Hz
    max_gap: float | None  # s


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
    return list(given) if len(given) == joints else (*given, 1.0)[0]


def _clock(raw: Recording) -> _Clock:
    """Return what makes the log's clock uniform."""
    rate = own_rate(raw)
    gap = bool(np.diff(raw.time).max() > _GAP / rate)
    resample = None if is_uniform(raw) else float(f"{rate:.4g}")
    return _Clock(resample, float(f"{_GAP / rate:.3g}") if gap else None)


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
    model: TorqueModel, training: Recording, clock: _Clock
) -> tuple[float, str]:
    """Return the cut-off [Hz], and why it is that."""
    top = _SHARE * own_rate(training)
    fallback = float(f"{min(10.0, top):.2g}")
    try:
        chosen = _chosen(model, training, clock, top)
    except ConsistentIdError as cause:
        return fallback, f"{fallback:g} Hz, as none could be chosen ({cause})"
    tried = ", ".join(f"{f:g}" for f in chosen.motion)
    return chosen.motion_cutoff, (
        f"of {tried} Hz the one with which the training rows predict each other best"
    )


def _chosen(
    model: TorqueModel, training: Recording, clock: _Clock, top: float
) -> CutoffChoice:
    parts = [training]
    if clock.max_gap is not None:
        shortest = training.duration / _FOLDS
        parts = list(split_at_gaps(training, clock.max_gap, shortest=shortest))
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
