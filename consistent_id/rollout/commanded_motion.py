"""One model's motion under the commands of a log.

Commands are constant between samples, delayed, and averaged over each time step.  An
exported file lacks what its format cannot express; so its error is another one than
that of the estimate in it, and it is read back to compute it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import brief
from consistent_id.errors import ConsistentIdError, RecordingError
from consistent_id.export.mjcf_bodies import require_mujoco
from consistent_id.recordings.recording import Recording, velocities
from consistent_id.recordings.signals import PDGains, resampled
from consistent_id.recordings.signals.clocks import is_uniform, own_rate
from consistent_id.rollout.drives_replay import drives_error
from consistent_id.rollout.replay_model import (
    ReplayModel,
    RobotFile,
    deflect,
    quiet,
    replay_model,
)

_FIRST = 5  # samples whose mean acceleration says how far springs are deflected


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """The motion of a model under the robot's commands.

    Parameters
    ----------
    log : Recording
        The robot's motion, on a uniform clock.
    position, velocity : ndarray, shape (samples, joints)
        The model's motion.
    """

    model: str
    log: Recording
    position: Matrix
    velocity: Matrix

    @property
    def errors(self) -> Matrix:
        """Position of the model less that of the robot, [rad or m]."""
        return np.asarray(self.position - self.log.position)

    @property
    def rmse(self) -> Vector:
        """Root-mean-square error of position, shape (joints,), [rad or m]."""
        return np.asarray(np.sqrt((self.errors**2).mean(axis=0)))

    @property
    def velocity_rmse(self) -> Vector:
        """Root-mean-square error of velocity, shape (joints,), [rad/s or m/s]."""
        measured = self.log.velocity
        if measured is None:
            measured = np.gradient(self.log.position, self.log.time, axis=0)
        error = self.velocity - measured
        return np.asarray(np.sqrt((error**2).mean(axis=0)))


def replayable(log: Recording) -> Recording:
    """Return a log on a uniform clock, to be replayed.

    Raises
    ------
    RecordingError
        If it has no commands of position.
    """
    if log.position_command is None:
        raise RecordingError(
            f"{log.name}: a rollout replays commands, but there is no "
            "position_command; name its columns"
        )
    return log if is_uniform(log) else resampled(log, own_rate(log))


def replay(
    model: ReplayModel,
    log: Recording,
    *,
    delay: float = 0.0,
    offsets: Vector | Matrix | None = None,
) -> Replay:
    """Give a model the robot's commands, from the robot's state at the start.

    Parameters
    ----------
    model : ReplayModel
        Its time step is a whole fraction of the log's.
    log : Recording
        See `replayable`.
    delay : float, [s]
        Delay of the commands.
    offsets : ndarray, shape (joints,) or (samples, joints), optional, [N m or N]
        Additional friction torque, with the sign of the term ``offset``: a positive one
        opposes positive motion.  It is constant, or linear between the log's samples.

    Raises
    ------
    RecordingError
        If the motion diverges.
    """
    require_type(model, ReplayModel, "model")
    require_type(log, Recording, "log")
    from mujoco import rollout

    mujoco = require_mujoco()
    log = log.of(model.joints)
    compiled = model.compiled
    per_sample = max(round(log.duration / (len(log) - 1) / compiled.opt.timestep), 1)
    steps = per_sample * (len(log) - 1)
    step = log.duration / steps
    # MuJoCo's velocities are those half a step before its positions: a time step is
    # about its start, and so is the mean of its command.
    late = delay + 0.5 * step
    control = drive_commands(log, model.gains, step, steps, delay=late)
    if offsets is not None:
        if np.ndim(offsets) == 2:
            at = log.time[0] + np.arange(steps) * step
            offsets = np.column_stack([np.interp(at, log.time, o) for o in offsets.T])
        control = control - offsets
    data = mujoco.MjData(compiled)
    with quiet():
        _begin_half_a_step_before(model, data, log, control[0])
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        start = np.zeros(mujoco.mj_stateSize(compiled, kind))
        mujoco.mj_getState(compiled, data, start, kind)
        states = np.asarray(rollout.rollout(compiled, data, start, control)[0])[0]
    states = np.vstack([start, states])
    after = states[1::per_sample]
    states = states[::per_sample]
    if not np.isfinite(states).all() or np.ptp(states[:, 0]) < 0.9 * log.duration:
        raise RecordingError(
            f"{model.name}: its motion under the commands of {log.name} diverges; "
            "check gains, units and the robot's inertias"
        )
    q = states[:, 1 : 1 + compiled.nq]
    dq = states[:, 1 + compiled.nq : 1 + compiled.nq + compiled.nv]
    dq[:-1] += after[:, 1 + compiled.nq : 1 + compiled.nq + compiled.nv]
    dq[:-1] *= 0.5  # of half a step before and after; the last one has none after it
    return Replay(model.name, log, q[:, model.positions], dq[:, model.velocities])


def _begin_half_a_step_before(
    model: ReplayModel, data: Any, log: Recording, control: Vector
) -> None:
    """Put a model in the robot's first state, with velocities of half a step before."""
    mujoco = require_mujoco()
    velocity = velocities(log)
    acceleration = np.gradient(velocity[:_FIRST], log.time[:_FIRST], axis=0)
    state = log.position[0], velocity[0], acceleration.mean(axis=0)
    begin(model, data, *state)
    now = data.qvel.copy()
    data.ctrl[:] = control
    mujoco.mj_step(model.compiled, data)
    before = now - 0.5 * (data.qvel - now)
    mujoco.mj_resetData(model.compiled, data)
    begin(model, data, *state)
    data.qvel[:] = before


def begin(
    model: ReplayModel, data: Any, q: Vector, dq: Vector, acceleration: Vector
) -> None:
    """Put a model in a state of the robot, springs in equilibrium.

    Parameters
    ----------
    q, dq, acceleration : ndarray, shape (joints,)
        Motion of the motors.
    """
    data.qpos[model.positions] = q
    data.qvel[model.velocities] = dq
    whole = np.zeros(model.compiled.nv)
    whole[model.velocities] = acceleration
    deflect(model.compiled, data, whole)


def drive_commands(
    log: Recording, gains: PDGains, step: float, steps: int, delay: float = 0.0
) -> Matrix:
    """Return ``kp q_command + kd dq_command + tau_command`` for each time step.

    A command is constant from its sample to the next.  A time step in which it changes
    has the mean, so that a motion depends smoothly on the delay.

    Parameters
    ----------
    log : Recording
        With a command of position.
    gains : PDGains
        One each.
    step : float, [s]
    delay : float, [s]

    Returns
    -------
    ndarray, shape (steps, joints), [N m or N]
    """
    command = gains.kp * _known(log.position_command)
    command = command + gains.kd * _known(log.velocity_command)
    command = command + _known(log.torque_command)
    edges = log.time[0] + np.arange(steps + 1) * step - delay
    return np.diff(_integral(log.time, command, edges), axis=0) / step


def _known(values: Matrix | None) -> Matrix:
    return np.zeros((1, 1)) if values is None else values


def _integral(time: Vector, values: Matrix, until: Vector) -> Matrix:
    """Return the integral of held values from the first time on."""
    whole = np.cumsum(values[:-1] * np.diff(time)[:, None], axis=0)
    whole = np.vstack([np.zeros(values.shape[1]), whole])
    place = np.searchsorted(time, until, side="right") - 1
    place = np.clip(place, 0, len(time) - 1)
    return np.asarray(whole[place] + values[place] * (until - time[place])[:, None])


FILES = ("mjcf", "urdf")
"""Formats that MuJoCo reads back."""


@dataclass(frozen=True, slots=True)
class FileError:
    """Root-mean-square error of a file's rollouts [rad or m].

    Parameters
    ----------
    plain : float
        As the file is.
    delayed : float
        With the delay of commands, which the file does not have.
    delay : float, [s]
    drives : str, optional
        Name of a file beside it that has drives with the delay.
    of_drives : float, optional
        Error of that file.
    """

    plain: float
    delayed: float
    delay: float
    drives: str | None = None
    of_drives: float | None = None

    def lines(self) -> list[str]:
        """Return the error and how to add the delay, for people."""
        plain = (
            "rollout error of the file, read back, with the problem's gains: "
            f"{1e3 * self.plain:.2f} mrad (mm)"
        )
        if self.delay == 0.0:
            return [plain]
        ms = 1e3 * self.delay
        late = f"{plain}; {1e3 * self.delayed:.2f} with commands {ms:.2f} ms late"
        if self.of_drives is not None:
            return [
                late,
                f"rollout error of {self.drives}, read back, with its own drives and "
                f"delay: {1e3 * self.of_drives:.2f} mrad (mm); its history filled with "
                "the first command, contacts and joint limits off",
            ]
        return [
            late,
            "the file has no delay of commands; in Python: "
            f"n = round({self.delay:g} / model.opt.timestep); "
            "late = collections.deque([command] * (n + 1), maxlen=n + 1); in each step "
            "late.append(command), and give late[0] to the drive",
        ]


def file_error(
    robot: RobotFile,
    logs: Sequence[Recording],
    gains: PDGains,
    *,
    delay: float = 0.0,
    drives: Path | None = None,
) -> FileError:
    """Return the error of a file's rollouts, read back from where it was written.

    Parameters
    ----------
    robot : RobotFile
    logs : sequence of Recording
        With commands, as they were logged.
    delay : float, [s]
        Delay of commands.
    drives : Path, optional
        The same robot with drives that have gains and delay.

    Raises
    ------
    ModelError
        If MuJoCo is not installed or refuses the file.
    RecordingError
        If a log has no commands, or the motion diverges.
    """
    path, joints, locked = robot
    known = [replayable(log.of(joints)) for log in logs]
    period = min(1.0 / log.rate for log in known)
    model = replay_model(path, joints, gains, locked=locked, period=period)

    def error(late: float) -> float:
        errors = [replay(model, log, delay=late).errors for log in known]
        return float(np.sqrt((np.vstack(errors) ** 2).mean()))

    plain = error(0.0)
    found = FileError(plain, error(delay) if delay else plain, delay)
    if drives is None:
        return found
    own = drives_error(robot._replace(path=drives), known)
    return replace(found, drives=drives.name, of_drives=own)


def error_lines(
    form: str,
    robot: RobotFile,
    logs: Sequence[Recording],
    gains: PDGains,
    *,
    delay: float,
    drives: Path | None = None,
) -> list[str]:
    """Return sentences on the error of a written file; a reason if there is none."""
    if form not in FILES:
        return []
    try:
        found = file_error(robot, logs, gains, delay=delay, drives=drives)
    except ConsistentIdError as cause:
        return [f"the rollout error of the file is not known: {cause}"]
    return found.lines()
