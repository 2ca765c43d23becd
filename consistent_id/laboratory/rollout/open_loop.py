"""Open loop: a model under the torque that the robot had, a short time at a stretch.

Without feedback errors grow without bound, in an arm above itself exponentially; so the
model begins again at the robot's state after every window.  In closed loop a stiff
drive hides what a model lacks; here nothing does.
"""

from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.export.mjcf_body import require_mujoco
from consistent_id.laboratory.rollout.replay import Replay, begin
from consistent_id.laboratory.rollout.replay_model import ReplayModel
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains, commanded

WINDOW = 0.2
"""Length of a window [s]: some tens of samples, in which legs and arms get away from a
wrong model by much more than encoders resolve."""

_THREADS = 2
_SPAN = 11  # samples of a cubic through positions, whose slope is where a window begins


def free_gains(gains: PDGains) -> PDGains:
    """Return gains without feedback, of drives with the same limits."""
    return replace(gains, kp=0.0 * gains.kp, kd=0.0 * gains.kd)


def open_loop(
    model: ReplayModel,
    log: Recording,
    gains: PDGains,
    *,
    delay: float = 0.0,
    offsets: Vector | None = None,
    window: float = WINDOW,
) -> Replay:
    """Give a model the torque that the robot's drives had; windows run side by side.

    Parameters
    ----------
    model : ReplayModel
        Made with `free_gains`.
    log : Recording
        See `replayable`.
    gains : PDGains
        Of the robot's drives.
    delay : float, [s]
        Of commands.
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
    torque = np.asarray(commanded(log, gains, delay=delay).torque)
    if offsets is not None:
        torque = torque - offsets
    # Between two samples the torque is taken for their mean.
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
    from scipy.signal import savgol_filter

    if len(log) <= _SPAN:
        return np.asarray(np.gradient(log.position, log.time, axis=0))
    step = 1.0 / log.rate
    return np.asarray(
        savgol_filter(log.position, _SPAN, 3, deriv=1, delta=step, axis=0)
    )
