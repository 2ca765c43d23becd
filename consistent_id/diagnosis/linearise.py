"""How the torque moves with parameters, zeros and lag, near an estimate."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.diagnosis.jackknife import jackknifed
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regressor import TorqueModel

_STEP = 1e-4  # rad or m, of the finite differences
_HELD = 20_000  # samples whose rows are filtered
_SAMPLES = 1500  # samples that are fitted
_BAND = 8.0  # times the motion's bandwidth: torque beyond it is noise and friction's
_POWER = 0.99  # of the velocity, within the bandwidth
_LEAST = 1e-3  # of a joint's torque, below which its misfit is not believed


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """Rows of all torque joints, divided by each joint's misfit.

    Parameters
    ----------
    rows : ndarray, shape (torque joints, samples, base + joints + 1)
        Columns of the base parameters, of the joints' zeros and of the lag.
    torque : ndarray, shape (torque joints, samples)
    base : int
        Number of base parameters.
    """

    rows: Array
    torque: Matrix
    base: int


def linearised(
    model: TorqueModel, x: Vector, recording: Recording, base: BaseParameters
) -> Linearised:
    """Return how the torque moves with base parameters, zeros and lag.

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
    # What is prepared is smooth: long logs are thinned before rows are held at once.
    recording = recording.samples(slice(None, None, max(len(recording) // _HELD, 1)))
    rate = recording.rate
    states = _states(recording)
    slopes = [_by_position(model, x, recording, j) for j in range(len(model.robot))]
    slopes.append(-np.gradient(model.predict(x, *states), 1.0 / rate, axis=0))
    columns = model.regressor(*states)[:, list(base.independent)]
    rows = np.concatenate(
        [np.swapaxes(columns, 1, 2), np.stack([s.T for s in slopes], axis=2)], axis=2
    )
    torque = np.asarray(recording.of(model.torque_joints).torque).T
    cutoff = _BAND * _bandwidth(states[1], rate)
    step = max(len(recording) // _SAMPLES, 1)
    rows, torque = (_smooth(a, cutoff, rate)[:, ::step] for a in (rows, torque))
    scale = _misfits(rows[:, :, : len(base)], torque)
    return Linearised(rows / scale[:, None, None], torque / scale[:, None], len(base))


def _states(recording: Recording) -> tuple[Array, Array, Array]:
    dq, ddq = recording.velocity, recording.acceleration
    return recording.position, np.asarray(dq), np.asarray(ddq)


def _by_position(model: TorqueModel, x: Vector, recording: Recording, j: int) -> Array:
    q, dq, ddq = _states(recording)
    shift = np.zeros(q.shape[1])
    shift[j] = _STEP
    ahead = model.predict(x, q + shift, dq, ddq)
    behind = model.predict(x, q - shift, dq, ddq)
    return (ahead - behind) / (2 * _STEP)


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
    from scipy.signal import butter, sosfiltfilt

    if cutoff >= 0.4 * rate:
        return values
    sections = butter(4, cutoff / (rate / 2.0), output="sos")
    return np.asarray(sosfiltfilt(sections, values, axis=1))


def _misfits(rows: Array, torque: Matrix) -> Vector:
    """Return each joint's misfit, by which its rows are weighted, [N m or N].

    Of two fits: the first weights joints by their torque.
    """
    scale = np.sqrt(np.mean(torque**2, axis=1))
    scale = np.where(scale > 0.0, scale, 1.0)
    fit = jackknifed(rows / scale[:, None, None], torque / scale[:, None])
    misfit = np.sqrt(np.mean((torque - rows @ fit.solution) ** 2, axis=1))
    return np.asarray(np.maximum(misfit, _LEAST * scale))
