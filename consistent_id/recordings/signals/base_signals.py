"""The motion of a floating base from measurements: an IMU, or its pose.

Derivatives do not bridge gaps in the log.  `quaternion_order` finds from the data
whether the real part of a quaternion is first or last.  Both orders have norm one; with
the right one, the accelerometer points upwards on average and the angular rate is that
of the gyroscope.  Without an inertial unit, the base is assumed to be roughly upright.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Matrix, Vector, checked
from consistent_id.errors import RecordingError
from consistent_id.recordings.beside import BaseMotion
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import (
    cubic_spline,
    interpolated_rotations,
    is_uniform,
    own_rate,
    resampled,
)
from consistent_id.recordings.signals.derivatives import differentiated
from consistent_id.recordings.signals.filters import low_passed
from consistent_id.recordings.time_stamps import SampleError

QuaternionOrder = Literal["xyzw", "wxyz"]
"""Position of the real part: last, as in ROS and Pinocchio, or first, as in MuJoCo."""

_UNIT = 0.01  # deviation of a quaternion's norm from one that rounding does not explain
_AXES = ("x", "y", "z")

SHORTEST = 4
"""Least number of samples for a second derivative, including the ends."""

_GAP = 10.0  # usual steps without a sample

# Largest error of the better order, relative to the worse one's, for a decision.
_CLEAR = 0.5
# rad; a base that tilts more on average is not upright, and gives no decision.
_TILT = 0.5


def rotations(quaternions: ArrayLike, order: QuaternionOrder) -> Array:
    """Return rotation matrices of unit quaternions.

    Parameters
    ----------
    quaternions : array_like, shape (samples, 4)
        Quaternions of the base frame in the world.
    order : {"xyzw", "wxyz"}

    Returns
    -------
    ndarray, shape (samples, 3, 3)

    Raises
    ------
    RecordingError
        If an order is unknown, or a norm is not one.
    """
    Q = checked(quaternions, (None, 4), "quaternions", RecordingError)
    if order not in ("xyzw", "wxyz"):
        raise RecordingError(
            f"quaternion order is {order!r}, expected 'xyzw' (ROS) or 'wxyz' (MuJoCo)"
        )
    norms = np.linalg.norm(Q, axis=1)
    if abs(norms - 1.0).max(initial=0.0) > _UNIT:
        worst = int(abs(norms - 1.0).argmax())
        raise RecordingError(
            f"quaternion of sample {worst} has norm {norms[worst]:.4g}, expected 1"
        )
    x, y, z, w = (Q if order == "xyzw" else np.roll(Q, -1, axis=1)).T / norms
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.moveaxis(np.array(rows), 2, 0)


def base_from_imu(
    time: Vector,
    gyroscope: ArrayLike,
    accelerometer: ArrayLike,
    *,
    cutoff: float | None,
    position: ArrayLike = (0.0, 0.0, 0.0),
    mounting: ArrayLike | None = None,
    rotation: Array | None = None,
) -> BaseMotion:
    """Return the motion of a base from an inertial measurement unit on it.

    With the unit at ``r`` the base's origin has ``a - dw x r - w x (w x r)``; ``dw`` is
    the derivative of the rate.  An accelerometer measures gravity upwards: at rest and
    upright it shows +9.81 along z.

    Parameters
    ----------
    time : ndarray, shape (samples,), [s]
        Uniform.
    gyroscope : array_like, shape (samples, 3), [rad/s]
    accelerometer : array_like, shape (samples, 3), [m/s^2]
    cutoff : float or None, [Hz]
        Cut-off of the zero-phase low-pass filter on both; the joints' motion should
        have the same.  None does not filter.
    position : array_like, shape (3,), [m]
        Position of the unit in the base frame.
    mounting : array_like, shape (3, 3), optional
        Orientation of the unit in the base frame; by default aligned.
    rotation : ndarray, shape (samples, 3, 3), optional
        Rotation of the base in the world, if it is known; see `rotations`.
    """
    turn = np.eye(3) if mounting is None else checked(mounting, (3, 3), "mounting")
    rate, felt = (
        checked(x, (len(time), 3), name, RecordingError) @ turn.T
        for x, name in ((gyroscope, "gyroscope"), (accelerometer, "accelerometer"))
    )
    w, dw = _with_derivative(time, rate, cutoff)
    a, _ = _with_derivative(time, felt, cutoff)
    r = checked(position, (3,), "position")
    a = a - np.cross(dw, r) - np.cross(w, np.cross(w, r))
    return BaseMotion(w, dw, a, rotation)


def base_from_pose(
    time: Vector,
    position: ArrayLike,
    quaternions: ArrayLike,
    *,
    order: QuaternionOrder,
    cutoff: float | None,
    gravity: ArrayLike = (0.0, 0.0, -9.81),
) -> BaseMotion:
    """Return the motion of a base from its pose, by motion capture or odometry.

    Rates are differences on the manifold: of the rotation between the samples before
    and after one.

    Parameters
    ----------
    time : ndarray, shape (samples,), [s]
        If it is not uniform, differences are those of a spline at uniform times.
    position : array_like, shape (samples, 3), [m]
        Position of the base frame's origin in the world.
    quaternions : array_like, shape (samples, 4)
        Quaternions of the base frame in the world.
    order : {"xyzw", "wxyz"}
    cutoff : float or None, [Hz]
        Cut-off of the zero-phase low-pass filter on position and rate.
    gravity : array_like, shape (3,), [m/s^2]
        In the world.
    """
    R = rotations(quaternions, order)
    x = checked(position, (len(R), 3), "position", RecordingError)
    g = checked(gravity, (3,), "gravity")
    place = _as_recording(time, x)
    if is_uniform(place):
        return _of_poses(place, R, cutoff, g)
    even = resampled(place, own_rate(place))
    moved = _of_poses(even, interpolated_rotations(time, R, even.time), cutoff, g)
    w, dw, felt = np.split(cubic_spline(even.time, moved.stacked, time), 3, axis=1)
    return BaseMotion(w, dw, felt, R)


def stretches(time: Vector) -> list[slice]:
    """Return the samples between gaps: steps longer than ten usual ones.

    Examples
    --------
    >>> stretches(np.array([0.0, 0.1, 0.2, 5.0, 5.1]))
    [slice(0, 3, None), slice(3, 5, None)]
    """
    if len(time) < 2:
        return [slice(0, len(time))] if len(time) else []
    steps = np.diff(time)
    cuts = np.flatnonzero(steps > _GAP * np.median(steps)) + 1
    ends = [0, *cuts.tolist(), len(time)]
    return [slice(a, b) for a, b in pairwise(ends)]


def moved_by_stretch(
    motion: Callable[[slice], BaseMotion], time: Vector, where: str
) -> BaseMotion:
    """Return a base's motion, each stretch between gaps separately.

    Parameters
    ----------
    motion : callable
        Function from samples of the log to the base's motion in them.
    time : ndarray, shape (samples,), [s]

    Raises
    ------
    RecordingError
        If a stretch is too short for derivatives.
    """
    parts = []
    for stretch in stretches(time):
        if stretch.stop - stretch.start < SHORTEST:
            raise SampleError(
                f"{where}: samples {stretch.start} to {stretch.stop - 1} stand between "
                "gaps, too few for the base's motion; remove those samples"
            )
        parts.append(motion(stretch))
    if len(parts) == 1:
        return parts[0]
    w, dw, felt = np.split(np.vstack([part.stacked for part in parts]), 3, axis=1)
    turned = [part.rotation for part in parts if part.rotation is not None]
    return BaseMotion(w, dw, felt, np.concatenate(turned) if turned else None)


class FoundOrder(NamedTuple):
    """An order, and its evidence."""

    order: QuaternionOrder
    reason: str


def quaternion_order(
    time: Vector,
    quaternions: Matrix,
    gyroscope: Matrix | None = None,
    accelerometer: Matrix | None = None,
) -> FoundOrder | None:
    """Return the order of unit quaternions; None if the data do not determine it.

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
        rates = {k: _measured_rates(time, R) - gyroscope for k, R in turned.items()}
        off = {k: float(np.linalg.norm(r - r.mean(axis=0))) for k, r in rates.items()}
        best = min(off, key=off.__getitem__)
        if norm > 0.0 and off[best] < _CLEAR * min(norm, max(off.values())):
            return FoundOrder(best, "from the gyroscope")
    if accelerometer is not None:
        mean = accelerometer / np.linalg.norm(accelerometer.mean(axis=0))
        up = {
            k: np.einsum("nij,nj->ni", R, mean).mean(axis=0) for k, R in turned.items()
        }
        off = {k: float(np.linalg.norm(v - [0, 0, 1])) for k, v in up.items()}
        best = min(off, key=off.__getitem__)
        if off[best] < _CLEAR * max(off.values()):
            return FoundOrder(best, "from measured gravity")
    tilt = {
        k: float(np.arccos(np.clip(R[:, 2, 2].mean(), -1, 1)))
        for k, R in turned.items()
    }
    best = min(tilt, key=tilt.__getitem__)
    if tilt[best] < _TILT and tilt[best] < _CLEAR * max(tilt.values()) > _CLEAR * _TILT:
        return FoundOrder(best, "because the base is then upright")
    return None


def _measured_rates(time: Vector, rotation: Array) -> Matrix:
    return _body_rates(rotation) / float(np.median(np.diff(time)))


def _of_poses(
    place: Recording, R: Array, cutoff: float | None, gravity: Vector
) -> BaseMotion:
    """Return the motion of uniformly sampled poses."""
    step = float(np.mean(np.diff(place.time)))
    w, dw = _with_derivative(place.time, _body_rates(R) / step, cutoff)
    if cutoff is not None:
        place = low_passed(place, motion_cutoff=cutoff)
    felt = np.asarray(differentiated(place).acceleration) - gravity
    return BaseMotion(w, dw, (np.swapaxes(R, 1, 2) @ felt[..., None])[..., 0], R)


def _body_rates(R: Array) -> Matrix:
    """Return rotation vectors per sample, in body axes, by central differences."""
    before = np.concatenate([R[:1], R[:-1]])
    after = np.concatenate([R[1:], R[-1:]])
    apart = np.swapaxes(before, 1, 2) @ after
    vee = np.stack(
        [
            apart[:, 2, 1] - apart[:, 1, 2],
            apart[:, 0, 2] - apart[:, 2, 0],
            apart[:, 1, 0] - apart[:, 0, 1],
        ],
        axis=1,
    )
    sine = np.linalg.norm(vee, axis=1) / 2.0
    cosine = (np.trace(apart, axis1=1, axis2=2) - 1.0) / 2.0
    angle = np.arctan2(sine, cosine)
    steps = np.full(len(R), 2.0)
    steps[[0, -1]] = 1.0
    # Half a turn within two samples cannot be resolved by differences.
    factor = np.where(sine > 0.0, angle / np.where(sine > 0.0, 2.0 * sine, 1.0), 0.5)
    middle = vee * (factor / steps)[:, None]
    # Both ends of the turn see its axis alike, and so does the sample between them to
    # second order of the step.
    return np.asarray(middle)


def _with_derivative(
    time: Vector, values: Matrix, cutoff: float | None
) -> tuple[Matrix, Matrix]:
    """Return three signals and their derivatives, filtered first."""
    if cutoff is None:
        return values, np.gradient(values, time, axis=0, edge_order=2)
    signal = low_passed(_as_recording(time, values), motion_cutoff=cutoff)
    return signal.position, np.asarray(differentiated(signal).velocity)


def _as_recording(time: Vector, values: Matrix) -> Recording:
    return Recording(_AXES, time, values, name="base")
