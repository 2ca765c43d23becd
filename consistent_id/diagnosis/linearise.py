"""How the torque changes with parameters, joint zeros and lag, near an estimate."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.diagnosis.jackknife import Jackknife, jackknife, solution
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.butterworth import zero_phase
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import triangle
from consistent_id.regression.regressor import TorqueModel

_STEP = 1e-4  # rad or m, of the finite differences
_PAD = 15  # samples by which the filter continues either end
_BAND = 8.0  # times the motion's bandwidth: torque beyond it is noise and friction's
_POWER = 0.99  # of the velocity, within the bandwidth
_LEAST = 1e-3  # of a joint's torque, below which its misfit is not believed


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """Factors of all torque joints' rows, each joint's divided by its misfit.

    Parameters
    ----------
    factors : Jackknife
        Columns of the joints' zeros and of the lag; base parameters are eliminated.
    joints : int
        Number of joints.
    """

    factors: Jackknife
    joints: int


def linearised(
    model: TorqueModel, x: Vector, recording: Recording, base: BaseParameters
) -> Linearised:
    """Return how the torque changes with zeros and lag, beside the base parameters.

    Columns and torque go through one low-pass filter, so that it drops out, and noise
    and friction's edges, which preparation rounded in the torque alone, with it.

    Parameters
    ----------
    model : TorqueModel
    x : ndarray, shape (parameters,)
        About which to linearise: a constrained estimate.
    recording : Recording
        With velocity, acceleration and torque.
    base : BaseParameters
    """
    recording = recording.of(model.robot.joint_names)
    rate, states = recording.rate, _states(recording)
    columns = model.regressor(*states)
    torque = np.asarray(recording.of(model.torque_joints).torque).T
    lag = -np.gradient(np.einsum("jps,p->js", columns, x), 1.0 / rate, axis=1)
    slopes = _by_position(model, x, *states)
    rows = np.concatenate(
        [columns[:, list(base.independent)], slopes, lag[:, None], torque[:, None]],
        axis=1,
    )
    cutoff = _BAND * _bandwidth(states[1], rate)
    rows = np.swapaxes(_smooth(rows, cutoff, rate), 1, 2)
    rows = rows / _misfits(rows[:, :, : len(base)], rows[:, :, -1])[:, None, None]
    factors = jackknife(rows[:, :, :-1], rows[:, :, -1]).without(len(base))
    return Linearised(factors, len(model.robot))


def _states(recording: Recording) -> tuple[Array, Array, Array]:
    dq, ddq = recording.velocity, recording.acceleration
    return recording.position, np.asarray(dq), np.asarray(ddq)


def _by_position(
    model: TorqueModel, x: Vector, q: Array, dq: Array, ddq: Array
) -> Array:
    """Return the torque's slopes, shape (torque joints, joints, samples)."""
    steps = _STEP * np.eye(q.shape[1])
    moved = np.concatenate([q + step for step in (*steps, *-steps)])
    times = (2 * q.shape[1], 1)
    torque = model.predict(x, moved, np.tile(dq, times), np.tile(ddq, times))
    ahead, behind = torque.reshape(2, q.shape[1], len(q), -1)
    return np.moveaxis(ahead - behind, 2, 0) / (2 * _STEP)


def _bandwidth(velocity: Array, rate: float) -> float:
    """Return the frequency [Hz] within which nearly all of the motion's power lies."""
    spectrum = abs(np.fft.rfft(velocity - velocity.mean(axis=0), axis=0)) ** 2
    moving = spectrum[:, spectrum.any(axis=0)]
    if not moving.size:
        return rate
    shares = np.cumsum(moving, axis=0) / moving.sum(axis=0)
    places = np.argmax(shares >= _POWER, axis=0)
    return float(np.fft.rfftfreq(len(velocity), 1.0 / rate)[max(places.max(), 1)])


def _smooth(values: Array, cutoff: float, rate: float) -> Array:
    """Low-pass along samples, both ways; as it is where there is nothing to take."""
    if cutoff >= 0.4 * rate:
        return values
    columns = values.reshape(-1, values.shape[-1]).T
    pad = min(len(columns) - 1, _PAD)
    smooth = zero_phase(columns, cutoff=cutoff, rate=rate, order=4, pad=pad)
    return smooth.T.reshape(values.shape)


def _misfits(rows: Array, torque: Matrix) -> Vector:
    """Return each joint's misfit, by which its rows are weighted, [N m or N].

    Of two fits: the first weights joints by their torque.
    """
    scale = np.sqrt(np.mean(torque**2, axis=1))
    scale = np.where(scale > 0.0, scale, 1.0)
    weighted = np.concatenate([rows, torque[:, :, None]], axis=2)
    weighted = (weighted / scale[:, None, None]).reshape(-1, weighted.shape[2])
    R = triangle(np.asfortranarray(weighted))
    rest = torque - rows @ solution(R[:, :-1], R[:, -1])
    misfit = np.sqrt(np.mean(rest**2, axis=1))
    return np.asarray(np.maximum(misfit, _LEAST * scale))
