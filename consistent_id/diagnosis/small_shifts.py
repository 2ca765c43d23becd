"""Zeros that are a little off, and torque that lags: found by linearisation.

Near the truth the torque changes by ``d_j dtau/dq_j`` for a zero that is off by
``d_j``, and by ``-t dtau/dt`` for a torque that lags by ``t``.  Both are fitted beside
the parameters; what the parameters can take over is not theirs.
"""

from dataclasses import dataclass

import numpy as np

from consistent_id._arrays import Array, Matrix, Vector
from consistent_id.base import BaseParameters
from consistent_id.diagnosis.findings import Finding
from consistent_id.recording import Recording
from consistent_id.regressor import TorqueModel

_STEP = 1e-4  # rad or m, of the finite differences
_SEGMENTS = 20
_SURE = 8.0  # estimates over their standard errors that are reported
_ANGLE = np.radians(1.0)
_SLIDE = 0.005  # m
_LAG = 0.012  # s: less is what filters of currents do
_SAMPLES = 1500


@dataclass(frozen=True, slots=True, eq=False)
class Shifts:
    """Estimated zeros' offsets and lag, with standard errors (robust to segments)."""

    offsets: Vector
    offset_errors: Vector
    lag: float
    lag_error: float


def estimate_shifts(
    model: TorqueModel, x: Vector, recording: Recording, base: BaseParameters
) -> Shifts:
    """Fit offsets and lag beside the base parameters, joints weighted by their torque.

    Parameters
    ----------
    model : TorqueModel
    x : ndarray, shape (parameters,)
        About which to linearise: a constrained estimate.
    recording : Recording
        With velocity, acceleration and torque.
    base : BaseParameters
    """
    step = max(len(recording) // _SAMPLES, 1)
    rate = (len(recording) - 1) / recording.duration
    predicted = model.predict(x, *_states(recording))
    slopes = [_by_position(model, x, recording, j) for j in range(len(model.robot))]
    slopes.append(-np.gradient(predicted, 1.0 / rate, axis=0))
    thin = recording.of(model.torque_joints)
    tau = np.asarray(thin.torque)[::step]
    weight = np.sqrt(np.mean(tau**2, axis=0))
    weight = np.where(weight > 0.0, weight, 1.0)
    Y = model.regressor(*(a[::step] for a in _states(recording)))
    Y = np.swapaxes(Y[:, list(base.independent)], 1, 2)
    S = np.stack([s[::step].T for s in slopes], axis=2)
    A = np.concatenate([Y, S], axis=2) / weight[:, None, None]
    z = (tau / weight).T
    return _fitted(A, z, len(base))


def shift_findings(model: TorqueModel, shifts: Shifts) -> list[Finding]:
    """Report offsets and lags that are both sure and large."""
    found = []
    for joint, d, error in zip(
        model.robot.joints, shifts.offsets, shifts.offset_errors, strict=True
    ):
        slides = joint.kind == "prismatic"
        least = _SLIDE if slides else _ANGLE
        score = min(abs(d) / least, abs(d) / (_SURE * error))
        if score < 1.0:
            continue
        size = f"{d:.4f} m" if slides else f"{np.degrees(d):.2f} degrees"
        found.append(
            Finding(
                "offset zero",
                "fault",
                joint.name,
                f"{joint.name}: its torque fits a position {size} larger",
                f"add {size} to the position of {joint.name}, or calibrate its zero",
                score,
            )
        )
    lag, error = shifts.lag, shifts.lag_error
    score = min(abs(lag) / _LAG, abs(lag) / (_SURE * error))
    if score >= 1.0:
        later = "later" if lag > 0.0 else "earlier"
        found.append(
            Finding(
                "lag",
                "fault",
                "all joints",
                f"the torque is {1e3 * abs(lag):.3g} ms {later} than the motion",
                "shift one against the other before filtering",
                score,
            )
        )
    return found


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


def _fitted(A: Array, z: Matrix, base: int) -> Shifts:
    """Least squares, with a covariance from the scatter of segments' scores."""
    rows, right = A.reshape(-1, A.shape[2]), z.reshape(-1)
    norms = np.linalg.norm(rows, axis=0)
    unit = np.where(norms > 0.0, norms, 1.0)
    U, s, Vt = np.linalg.svd(rows / unit, full_matrices=False)
    inverse = np.where(s > 1e-6 * s[0], 1.0 / np.maximum(s, 1e-300), 0.0)
    solution = Vt.T @ (inverse * (U.T @ right)) / unit
    rest = (z - A @ solution)[:, :, None] * A
    cuts = np.array_split(np.arange(A.shape[1]), _SEGMENTS)
    scores = np.array([rest[:, c].sum(axis=(0, 1)) for c in cuts if len(c)])
    moves = ((scores / unit) @ Vt.T * inverse**2) @ Vt / unit
    errors = np.sqrt(np.sum(moves**2, axis=0))
    # A shift that parameters can take over is not determined at all.
    lost = np.sum(Vt[s <= 1e-6 * s[0]] ** 2, axis=0) > 1e-6
    errors = np.where(lost, np.inf, np.maximum(errors, 1e-300))
    offsets, lag = slice(base, -1), -1
    return Shifts(
        solution[offsets], errors[offsets], float(solution[lag]), float(errors[lag])
    )
