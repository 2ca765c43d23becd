"""Comparison of models: their motion errors under the same commands.

In open loop, models move in short windows under the robot's torque.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.executors import worker_threads
from consistent_id._support.given_values import require_type, require_types
from consistent_id._support.tables import Table, brief
from consistent_id.errors import RecordingError
from consistent_id.estimation.estimate import Estimate
from consistent_id.export.mjcf_bodies import require_mujoco
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains, commanded
from consistent_id.recordings.signals.derivatives import sliding_polynomials
from consistent_id.rollout.commanded_motion import Replay, begin, replay, replayable
from consistent_id.rollout.replay_model import ReplayModel, quiet, replay_model

WINDOW = 0.2
"""Length of a window [s]: some tens of samples, in which the error of a wrong model is
much larger than the resolution of encoders.
"""

_THREADS = 2
_SPAN = 11  # samples of a cubic through positions, whose slope is where a window begins

_WORKERS = 2
_MOST = 0.5  # share of the squared error by which one joint is named
_PASSES = 4  # of the search of offsets; each leaves a small share of the rest


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Rollout:
    """Replays of several models.

    Parameters
    ----------
    replays : mapping of str to tuple of Replay
        By model, one for each log; the first model is the estimate's.
    offsets : mapping of str to tuple of Replay
        The same with torque offsets found for each model on training motion, because
        files cannot state them.  The estimate has its own.
    delay : float, [s]
        Delay of the commands, for the estimate and for all.
    open_loop : mapping of str to tuple of Replay
        Windows under the torque of the robot's drives, with offsets; see `open_loop`.
        None for a model that diverges in a window.
    """

    replays: Mapping[str, tuple[Replay, ...]]
    offsets: Mapping[str, tuple[Replay, ...]]
    delay: float = 0.0
    open_loop: Mapping[str, tuple[Replay, ...]] = field(default_factory=dict)

    def rmse(self, model: str, *, offsets: bool = False) -> float:
        """Return a model's root-mean-square error of position over all [rad or m]."""
        found = (self.offsets if offsets else self.replays)[model]
        return _over_all([r.errors for r in found])

    def _open_cell(self, model: str) -> str:
        if model not in self.open_loop:
            return "diverges"
        return f"{1e3 * _over_all([r.errors for r in self.open_loop[model]]):.2f}"

    @property
    def sentence(self) -> str:
        """The first model's error, in words."""
        name, replays = next(iter(self.replays.items()))
        logs = ", ".join(replay.log.name for replay in replays)
        return (
            f"closed-loop replay of {logs}: {1e3 * self.rmse(name):.2f} mrad (mm), "
            f"root mean square of all joints{self._mostly(name)}, commands "
            f"{1e3 * self.delay:.2f} ms late"
        )

    def _mostly(self, model: str) -> str:
        """Return the joint that has most of a model's squared error, if one has."""
        replays = self.replays[model]
        squares = (np.vstack([r.errors for r in replays]) ** 2).mean(axis=0)
        worst, joints = int(squares.argmax()), replays[0].log.joints
        if len(joints) < 3 or squares[worst] <= _MOST * squares.sum():
            return ""
        others = np.sqrt(np.delete(squares, worst).mean())
        error = 1e3 * np.sqrt(squares[worst])
        return f" ({joints[worst]} {error:.2f}, the others {1e3 * others:.2f})"

    def tables(self) -> list[Table]:
        """Return the errors of all models, and those of their joints, for people."""
        rows = []
        for model, replays in self.replays.items():
            velocity = np.sqrt(np.mean([r.velocity_rmse**2 for r in replays]))
            given = self.rmse(model, offsets=True) if model in self.offsets else None
            rows.append(
                (
                    model,
                    f"{1e3 * self.rmse(model):.2f}",
                    "" if given is None else f"{1e3 * given:.2f}",
                    f"{1e3 * velocity:.0f}",
                    self._open_cell(model),
                )
            )
        logs = ", ".join(r.log.name for r in next(iter(self.replays.values())))
        whole = Table(
            f"Closed-loop replay of {logs}: root-mean-square errors",
            ("model", "position", "with offsets", "velocity", "open loop"),
            tuple(rows),
            (
                "in mrad (mm) and mrad/s (mm/s)",
                f"commands delayed by {1e3 * self.delay:.2f} ms for the first model; "
                f"the others as in their files, with offsets also with that delay, "
                f"if it lowers their error on the training motion",
                f"open loop: position, windows of {WINDOW:g} s under the torque of "
                f"the robot's drives, with offsets",
            ),
        )
        return [whole, self._of_joints()]

    def _of_joints(self) -> Table:
        shown = self.offsets or self.replays
        joints = next(iter(shown.values()))[0].log.joints
        errors = [
            np.sqrt(np.mean([r.rmse**2 for r in replays], axis=0))
            for replays in shown.values()
        ]
        return Table(
            "Position error of each joint" + (", with offsets" if self.offsets else ""),
            ("joint", *shown),
            tuple(
                (joint, *(f"{1e3 * error[j]:.2f}" for error in errors))
                for j, joint in enumerate(joints)
            ),
            ("in mrad (mm)",),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the errors by name, for JSON."""
        return {
            "delay": self.delay,
            "models": {
                model: {
                    "position_rmse": self.rmse(model),
                    "position_rmse_with_offsets": (
                        self.rmse(model, offsets=True)
                        if model in self.offsets
                        else None
                    ),
                    "position_rmse_open_loop": (
                        _over_all([r.errors for r in self.open_loop[model]])
                        if model in self.open_loop
                        else None
                    ),
                    "logs": {
                        r.log.name: {
                            joint: {"position": float(q), "velocity": float(dq)}
                            for joint, q, dq in zip(
                                r.log.joints, r.rmse, r.velocity_rmse, strict=True
                            )
                        }
                        for r in replays
                    },
                }
                for model, replays in self.replays.items()
            },
        }


def rollout(
    estimate: Estimate,
    logs: Recording | Sequence[Recording],
    gains: PDGains,
    *,
    against: Sequence[str | Path] = (),
    training: Sequence[Recording] = (),
    delay: float = 0.0,
    locked: Mapping[str, float] | None = None,
) -> Rollout:
    """Replay logs by an estimate and by files of the robot, in closed and open loop.

    Parameters
    ----------
    logs : Recording or sequence of Recording
        With commands, as they were logged: not filtered.
    gains : PDGains
        Gains of the robot's joints, in its order.
    against : sequence of str or Path
        MJCF or URDF files of the robot.
    training : sequence of Recording
        Training logs for the torque offsets of these files; without them there are
        none.
    delay : float, [s]
        Delay of the commands.
    locked : mapping of str to float, optional
        Positions at which other joints of the files are held.

    Raises
    ------
    ModelError
        If MuJoCo is not installed, or refuses a robot.
    RecordingError
        If a log has no commands, or a motion diverges.
    """
    require_type(estimate, Estimate, "estimate")
    require_type(gains, PDGains, "gains")
    require_types(training, Recording, "training")
    joints = estimate.model.robot.joint_names
    given = [logs] if isinstance(logs, Recording) else logs
    require_types(given, Recording, "logs")
    if not given:
        raise RecordingError("there is no log to replay")
    known = [replayable(log.of(joints)) for log in given]
    learnt = [replayable(log.of(joints)) for log in training]
    period = min(1.0 / log.rate for log in known)

    def made(robot: Estimate | str | Path, given: PDGains) -> ReplayModel:
        held = None if isinstance(robot, Estimate) else locked
        return replay_model(robot, joints, given, locked=held, period=min(period, 1.0))

    own = made(estimate, gains)
    name = f"identified ({estimate.method})"
    replays = {name: replayed(own, known, delay)}
    offsets = {name: replays[name]} if learnt else {}
    settings: dict[str, tuple[float, Vector | None]] = {name: (delay, None)}
    for file in against:
        model = made(file, gains)
        replays[str(file)] = replayed(model, known, 0.0)
        settings[str(file)] = (0.0, None)
        if learnt:
            choices = (found_offsets(model, learnt, late) for late in {0.0, delay})
            _, late, found = min(choices, key=lambda choice: choice[0])
            offsets[str(file)] = replayed(model, known, late, found)
            settings[str(file)] = (late, found)
    free = {}
    for robot, (key, (late, torque)) in zip(
        (estimate, *against), settings.items(), strict=True
    ):
        model = made(robot, free_gains(gains))
        with suppress(RecordingError):  # a model that diverges has no windows
            free[key] = tuple(
                open_loop(model, commanded(log, gains, delay=late), offsets=torque)
                for log in known
            )
    return Rollout(replays, offsets, delay, free)


def replayed(
    model: ReplayModel,
    logs: Sequence[Recording],
    delay: float,
    offsets: Vector | None = None,
) -> tuple[Replay, ...]:
    """Return replays of several logs, side by side."""
    with worker_threads(_WORKERS) as pool:
        return tuple(
            pool.map(lambda log: replay(model, log, delay=delay, offsets=offsets), logs)
        )


def found_offsets(
    model: ReplayModel, logs: Sequence[Recording], delay: float
) -> tuple[float, float, Vector]:
    """Return the error, the delay and the torque offsets of a model's best replay.

    An offset moves a joint by itself over the drive's stiffness, nearly.
    """
    offsets = np.zeros(len(model.joints))
    best = (np.inf, delay, offsets)
    for _ in range(_PASSES):
        errors = [r.errors for r in replayed(model, logs, delay, offsets)]
        size = _over_all(errors)
        if size < best[0]:
            best = (size, delay, offsets)
        offsets = offsets + model.gains.kp * np.vstack(errors).mean(axis=0)
    return best


def _over_all(errors: Sequence[Any]) -> float:
    return float(np.sqrt((np.vstack(errors) ** 2).mean()))


def free_gains(gains: PDGains) -> PDGains:
    """Return gains without feedback, of drives with the same limits."""
    return replace(gains, kp=0.0 * gains.kp, kd=0.0 * gains.kd)


def open_loop(
    model: ReplayModel,
    log: Recording,
    *,
    offsets: Vector | None = None,
    window: float = WINDOW,
) -> Replay:
    """Give a model the torque that the robot's drives had; windows run side by side.

    Parameters
    ----------
    model : ReplayModel
        Made with `free_gains`.
    log : Recording
        On a uniform clock, with the torque of the robot's drives; see `commanded`.
    offsets : ndarray, shape (joints,), optional, [N m or N]
        See `replay`.
    window : float, [s]

    Raises
    ------
    RecordingError
        If the log is shorter than a window, or the motion diverges.
    """
    from mujoco import rollout

    mujoco = require_mujoco()
    log = log.of(model.joints)
    length = max(round(window * log.rate), 1)
    count = (len(log) - 1) // length
    if count == 0:
        raise RecordingError(f"{log.name} is shorter than a window of {window} s")
    compiled, data = model.compiled, mujoco.MjData(model.compiled)
    per_sample = max(round(1.0 / log.rate / compiled.opt.timestep), 1)
    torque = np.asarray(log.torque)
    if offsets is not None:
        torque = torque - offsets
    # Between two samples the torque is their mean.
    steps = np.repeat(0.5 * (torque[:-1] + torque[1:]), per_sample, axis=0)
    control = steps[: count * length * per_sample].reshape(count, -1, torque.shape[1])
    velocity = _velocity(log)
    acceleration = np.gradient(velocity, log.time, axis=0)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    starts = np.zeros((count, mujoco.mj_stateSize(compiled, kind)))
    for k, start in enumerate(starts):
        at = k * length
        begin(model, data, log.position[at], velocity[at], acceleration[at])
        mujoco.mj_getState(compiled, data, start, kind)
    workers = [mujoco.MjData(compiled) for _ in range(_THREADS)]
    with quiet():
        states = np.asarray(rollout.rollout(compiled, workers, starts, control)[0])
    ends = states[:, per_sample - 1 :: per_sample].reshape(count * length, -1)
    if not np.isfinite(ends).all():
        raise RecordingError(
            f"{model.name}: without feedback its motion under the torque of "
            f"{log.name} diverges within {window} s; check gains, units and inertias"
        )
    q = ends[:, 1 : 1 + compiled.nq][:, model.positions]
    dq = ends[:, 1 + compiled.nq : 1 + compiled.nq + compiled.nv][:, model.velocities]
    seen = log.samples(slice(1, 1 + count * length))
    return Replay(model.name, seen, q, dq)


def _velocity(log: Recording) -> Matrix:
    """Return the slope of positions: an error of it grows for a whole window."""
    if len(log) <= _SPAN:
        return np.asarray(np.gradient(log.position, log.time, axis=0))
    return log.rate * sliding_polynomials(log.position, _SPAN, 3, derivative=1)
