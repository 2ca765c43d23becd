"""How the logs of a draft are read: on one clock, with which velocity and cut-off.

A velocity that is late, smoothed or worse than differentiated positions is not read.
The cut-off is the one with which the training rows predict each other best.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from consistent_id._support.executors import in_halves
from consistent_id.errors import ConsistentIdError, RecordingError
from consistent_id.estimation.cutoff import CutoffChoice, best_cutoff
from consistent_id.problems.draft_rows import (
    SHARE,
    Clock,
    Split,
    clock_with,
    split_logs,
)
from consistent_id.problems.found_logs import RobotLogs, read_logs
from consistent_id.problems.log_entries import with_torque
from consistent_id.problems.overrides import StatedDrive, stated_drive
from consistent_id.problems.robot_logs import GivenLogs, wraps
from consistent_id.problems.stated_model import DEFAULT_DRIVE
from consistent_id.problems.statement import Statement
from consistent_id.recordings.recording import Recording, velocities
from consistent_id.recordings.signals import (
    Delay,
    Track,
    estimate_delay,
    resampled,
    split_at_gaps,
    unwrapped,
)
from consistent_id.recordings.signals.clocks import own_rate
from consistent_id.recordings.signals.derivatives import lost_acceleration
from consistent_id.regression.regressor import TorqueModel

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
_SAMPLES = 1.0  # sampling periods; less is below the resolution of the stamps


class DraftReading(NamedTuple):
    """Training logs by file: as recorded, with torque, and their rows in motion.

    `late` is the delay of a velocity that is not read for that reason, and `early` the
    time [s] by which the position is ahead of the other channels.  `held_out` are the
    logs for validation; nothing but their clocks, gaps and missing values is used.
    """

    logs: RobotLogs
    recordings: dict[Path, Recording]
    raws: dict[Path, Recording]
    clock: Clock
    split: Split
    late: Delay | None
    early: float
    held_out: dict[Path, Recording]


def read_draft_logs(
    logs: RobotLogs, given: GivenLogs, *, early: float = 0.0
) -> DraftReading:
    """Read logs; delayed velocities are read only if their columns are given.

    If the position is stated to be early, the velocity is not late.
    """
    logs, every = read_logs(logs, [*given.training, *given.validation])
    read = {file: every[file] for file in given.training}
    held_out = {file: every[file] for file in given.validation}
    late = None
    if early:
        note = (
            f"velocity and torque are both {1e3 * early:.3g} ms later than the "
            f"position: the position is moved, and the velocity is read"
        )
        logs = replace(logs, notes=(*logs.notes, note))
    elif logs.stated.velocity is None:
        logs, late = on_time(_filled(logs, read.values()), read.values())
        if logs.columns.velocity is None:
            read, held_out = (
                {file: replace(raw, velocity=None) for file, raw in some.items()}
                for some in (read, held_out)
            )
    raws = {file: with_torque(raw, logs.stated.gains) for file, raw in read.items()}
    clock = clock_with([*raws.values()], [*held_out.values()], logs.stated.max_gap)
    split = split_logs(raws, clock, logs.stated, whole=bool(given.validation))
    return DraftReading(logs, read, raws, clock, split, late, early, held_out)


def _filled(logs: RobotLogs, training: Iterable[Recording]) -> RobotLogs:
    """Return how logs are read: without a velocity that nobody wrote."""
    for raw in training:
        moves = np.ptp(raw.position, axis=0).max() > _MOVING
        if raw.velocity is not None and moves and not raw.velocity.any():
            note = (
                f"the velocity of {raw.name} is not read: it is zero throughout, but "
                "the joints move; positions are differentiated"
            )
            columns = replace(logs.columns, velocity=None)
            return replace(logs, columns=columns, notes=(*logs.notes, note))
    return logs


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


def smoothed_velocity(reading: DraftReading, stated: Statement) -> str | None:
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


def _lost(part: Recording, reading: DraftReading) -> Iterator[tuple[float, str, str]]:
    """Yield the share of acceleration that the velocity lacks, joint and recording."""
    longest = _longest(part, reading.clock)
    if part.velocity is None or len(longest) < _SPECTRUM:
        return
    if wraps(longest):  # a fault that is found later: jumps are no acceleration
        longest = unwrapped(longest)
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


def poor_velocity(reading: DraftReading, stated: Statement) -> str | None:
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
    logs, drive = reading.logs, drive_of(reading.logs, stated)
    measured = tuple(logs.columns.torque_joints)
    terms = drive.terms(logs.robot.joint_names)
    model = TorqueModel(logs.robot, terms, torque_joints=measured)
    top = usual_cutoff(parts)
    bare = [replace(part, velocity=None) for part in parts]

    def left_out_error(logs: Sequence[Recording]) -> float:
        return float(_chosen(model, logs, reading.clock, top, _COMPARED).error.min())

    try:
        samples = sum(map(len, parts))
        with_it, without = in_halves(left_out_error, [parts, bare], samples=samples)
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


def drive_of(logs: RobotLogs, stated: Statement) -> StatedDrive:
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


@dataclass(frozen=True, slots=True)
class DraftCutoff:
    """A cut-off [Hz], and the reason for it."""

    frequency: float
    reason: str


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
