"""Where the real part of a log's quaternions stands: first or last, by the data.

Both orders have norm one.  Turned by the right one, what the accelerometer feels is on
average upwards, and the rate of turning is the gyroscope's; without an inertial unit,
the base is more or less upright.
"""

from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.recordings.signals.base_signals import (
    QuaternionOrder,
    body_rates,
    rotations,
)

# How far off the better order may be, in the worse one's, to be called the right one.
_CLEAR = 0.5
# rad; a base that tilts more on average is not upright, and says nothing of the order.
_TILT = 0.5


class FoundOrder(NamedTuple):
    """An order, and what shows it."""

    order: QuaternionOrder
    reason: str


def quaternion_order(
    time: Vector,
    quaternions: Matrix,
    gyroscope: Matrix | None = None,
    accelerometer: Matrix | None = None,
) -> FoundOrder | None:
    """Return the order of unit quaternions; None if the data do not tell.

    Parameters
    ----------
    time : ndarray, shape (samples,), [s]
    quaternions : ndarray, shape (samples, 4)
    gyroscope : ndarray, shape (samples, 3), optional, [rad/s]
        In the axes of the base.
    accelerometer : ndarray, shape (samples, 3), optional, [m/s^2]

    Raises
    ------
    RecordingError
        If norms are not one.
    """
    turned: dict[QuaternionOrder, Array] = {
        "xyzw": rotations(quaternions, "xyzw"),
        "wxyz": rotations(quaternions, "wxyz"),
    }
    if gyroscope is not None:
        norm = float(np.linalg.norm(gyroscope - gyroscope.mean(axis=0)))
        rates = {k: _rates(time, R) - gyroscope for k, R in turned.items()}
        off = {k: float(np.linalg.norm(r - r.mean(axis=0))) for k, r in rates.items()}
        best = min(off, key=off.__getitem__)
        if norm > 0.0 and off[best] < _CLEAR * min(norm, max(off.values())):
            return FoundOrder(best, "as the gyroscope turns")
    if accelerometer is not None:
        mean = accelerometer / np.linalg.norm(accelerometer.mean(axis=0))
        up = {
            k: np.einsum("nij,nj->ni", R, mean).mean(axis=0) for k, R in turned.items()
        }
        off = {k: float(np.linalg.norm(v - [0, 0, 1])) for k, v in up.items()}
        best = min(off, key=off.__getitem__)
        if off[best] < _CLEAR * max(off.values()):
            return FoundOrder(best, "as gravity is felt")
    tilt = {
        k: float(np.arccos(np.clip(R[:, 2, 2].mean(), -1, 1)))
        for k, R in turned.items()
    }
    best = min(tilt, key=tilt.__getitem__)
    if tilt[best] < _TILT and tilt[best] < _CLEAR * max(tilt.values()) > _CLEAR * _TILT:
        return FoundOrder(best, "as the base is then upright")
    return None


def _rates(time: Vector, rotation: Array) -> Matrix:
    return body_rates(rotation) / float(np.median(np.diff(time)))
