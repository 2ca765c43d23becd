"""Velocity and acceleration by a Kalman smoother whose noise levels the data choose.

Each joint's position and its first derivatives are a chain of integrators; white noise
enters the last one, the jerk or its rate, and each reading of the position has an
independent error:

    x[k+1] = F x[k] + w[k],       cov w = drive M
    z[k]   = first of x[k] + v[k],  var v = noise^2

The time step is taken as unit of time and the noise as unit of position, so that only
the ratio ``drive step^(2 order - 1) / noise^2`` remains.  All joints run side by side.
"""

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from math import factorial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Matrix, Vector, freeze, frozen
from consistent_id._support.tables import brief
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import uniform_rate
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.recordings.signals.masks import encoder_resolution

ORDERS = (3, 4, 5, 6)
"""Numbers of integrations tried: from white jerk to its third derivative."""

# Smoothing acts below ``ratio^(1 / (2 order))`` radians per sample: its decades.
_COARSE = np.arange(-3.25, 0.6, 0.25)
_ROUGHLY = 1e-4  # steady enough to compare likelihoods
_FINE = np.arange(-0.25, 0.26, 0.0625)  # refinements about the best of them

_DIFFUSE = 1e6  # variance of the unknown start
_STEADY = 1e-9
"""Relative change of covariances in a step below which gains are kept."""


@brief
@dataclass(frozen=True, slots=True, eq=False)
class MotionNoise:
    """Noise levels of the readings and of the motion.

    Parameters
    ----------
    joints : tuple of str
    order : int
        The derivative of the position that is modelled as white noise: 3 for jerk.
    position : array_like, shape (joints,), [rad or m]
        Standard deviation of a reading.
    drive : array_like, shape (joints,), [(rad or m)^2 / s^(2 order - 1)]
        Spectral density of that derivative.
    """

    joints: tuple[str, ...]
    order: int
    position: Vector
    drive: Vector

    def __post_init__(self) -> None:
        if self.order not in ORDERS:
            raise RecordingError(f"order is {self.order!r}, expected one of {ORDERS}")
        for name in ("position", "drive"):
            values = frozen(
                getattr(self, name), (len(self.joints),), name, RecordingError
            )
            if not (values > 0.0).all():
                raise RecordingError(f"{name} is {values}, expected positive numbers")
            freeze(self, **{name: values})


def motion_noise(
    recording: Recording,
    *,
    order: int | None = None,
    least: ArrayLike | None = None,
) -> MotionNoise:
    """Estimate both noise levels of each joint by maximum likelihood.

    The likelihood is that of the innovations, each predicted from the readings before.

    Parameters
    ----------
    recording : Recording
        As recorded, uniformly sampled: filtered signals do not have white noise.
    order : int, optional
        The derivative of the position that is modelled as white noise, 3 to 6; by
        default the one with the largest likelihood over all joints.
    least : array_like, shape (joints,), optional, [rad or m]
        Least noise of a reading; by default the encoder's step over ``sqrt(12)``, if
        there is one.
    """
    rate = uniform_rate(recording)
    if order is not None and order not in ORDERS:
        raise RecordingError(f"order is {order!r}, expected one of {ORDERS}")
    _enough(recording)
    if least is None:
        least = encoder_resolution(recording) / np.sqrt(12.0)
    size = abs(recording.position).max(axis=0)
    rounding = 4.0 * np.finfo(np.float64).eps * np.maximum(size, 1e-3)
    floor = np.maximum(frozen(least, size.shape, "least", RecordingError), rounding)
    z = recording.position - recording.position[0]
    fits = [_likeliest(z, n, floor) for n in (ORDERS if order is None else (order,))]
    best = min(fits, key=lambda fit: fit.cost)
    return MotionNoise(
        joints=recording.joints,
        order=best.order,
        position=np.sqrt(best.variance),
        drive=best.ratio * best.variance * rate ** (2 * best.order - 1),
    )


def kalman_differentiated(
    recording: Recording, noise: MotionNoise | None = None
) -> Recording:
    """Return the most likely motion at every sample, given all readings.

    Position, velocity and acceleration all come of the recorded position, by a Kalman
    filter and the smoother of Rauch, Tung and Striebel [Rauch1965]_.

    Parameters
    ----------
    recording : Recording
        As recorded, uniformly sampled.
    noise : MotionNoise, optional
        By default `motion_noise` of the recording.
    """
    noise = motion_noise(recording) if noise is None else noise
    return altered(recording, partial(_smoothed_motion, noise=noise))


def _smoothed_motion(recording: Recording, noise: MotionNoise) -> Recording:
    rate = uniform_rate(recording)
    if noise.joints != recording.joints:
        raise RecordingError(
            f"noise is that of joints {noise.joints}, {recording.name} has "
            f"{recording.joints}"
        )
    order = noise.order
    _enough(recording)
    ratio = noise.drive / rate ** (2 * order - 1) / noise.position**2
    start = recording.position[0]
    z = (recording.position - start) / noise.position
    states = smoothed(z, ratio, order) * noise.position
    return replace(
        recording,
        position=states[:, 0] + start,
        velocity=states[:, 1] * rate,
        acceleration=states[:, 2] * rate**2,
    )


def _enough(recording: Recording) -> None:
    if len(recording) < 8 * ORDERS[-1]:
        raise RecordingError(
            f"{recording.name}: {len(recording)} samples, expected {8 * ORDERS[-1]} or "
            "more for a smoother"
        )


class _LikeliestNoise(NamedTuple):
    """``-2 log`` likelihood, and the noise levels of each joint that attain it."""

    order: int
    cost: float
    ratio: Vector
    variance: Vector


class Gains(NamedTuple):
    """Filter gains until they converge, then the last one.

    Shapes: gain (steps, order, columns), variance (steps, columns) of the innovations,
    covariance (steps, order, order, columns) of the predicted state,
    or the last alone.
    """

    gain: Array
    variance: Matrix
    covariance: Array


def _likeliest(z: Matrix, order: int, floor: Vector) -> _LikeliestNoise:
    """Return the noise levels of largest likelihood for one order."""
    tried = np.tile(_COARSE[:, None], z.shape[1])
    for finer in (_FINE, None):
        cost, variance = _costs(z, 10.0 ** (2 * order * tried), order, floor)
        best = cost.argmin(axis=0)[None]
        near = np.take_along_axis(tried, best, axis=0)[0]
        if finer is not None:
            tried = near + finer[:, None]
    return _LikeliestNoise(
        order=order,
        cost=float(cost.min(axis=0).sum()),
        ratio=10.0 ** (2 * order * near),
        variance=np.take_along_axis(variance, best, axis=0)[0],
    )


def _costs(
    z: Matrix, ratios: Matrix, order: int, floor: Vector
) -> tuple[Matrix, Matrix]:
    """Return ``-2 log`` likelihoods and the best noise variance for ratios tried."""
    different, where = np.unique(ratios, return_inverse=True)
    found = _rough_gains(tuple(different.tolist()), order, len(z))
    found = Gains(
        found.gain[..., where.ravel()],
        found.variance[..., where.ravel()],
        found.covariance,
    )
    innovation = _innovations(np.tile(z, len(ratios)), found)
    last = np.minimum(np.arange(len(z)), len(found.variance) - 1)
    # The first innovations depend only on the start; as many for every order.
    S = found.variance[last[ORDERS[-1] :]]
    n = len(S)
    power = (innovation[ORDERS[-1] :] ** 2 / S).sum(axis=0).reshape(ratios.shape)
    variance = np.maximum(power / n, floor**2)
    size = np.log(S).sum(axis=0).reshape(ratios.shape)
    return n * np.log(variance) + power / variance + size, variance


@lru_cache(maxsize=8)  # two for each order; logs of one length have the same
def _rough_gains(ratios: tuple[float, ...], order: int, samples: int) -> Gains:
    return gains(np.array(ratios), order, samples, steady=_ROUGHLY, covariances=False)


def transition(order: int) -> Matrix:
    """Return ``F`` of unit step: a Taylor series in each row."""
    return np.array(
        [
            [1.0 / factorial(j - i) if j >= i else 0.0 for j in range(order)]
            for i in range(order)
        ]
    )


def drive_covariance(order: int) -> Matrix:
    """Return ``M`` of unit step: what white noise gives after 1, 2, ... integrals."""
    top = order - 1
    return np.array(
        [
            [
                1.0 / (factorial(top - i) * factorial(top - j) * (2 * top + 1 - i - j))
                for j in range(order)
            ]
            for i in range(order)
        ]
    )


def gains(
    ratio: Vector,
    order: int,
    samples: int,
    *,
    steady: float = _STEADY,
    covariances: bool = True,
) -> Gains:
    """Run the covariances, which do not depend on data, until they converge.

    Only `smoothed` needs them afterwards; they take memory.
    """
    F, M, one = transition(order), drive_covariance(order), np.eye(order)
    P = np.tile(_DIFFUSE * one, (len(ratio), 1, 1))
    gain, variance, covariance = [], [], []
    for _ in range(samples):
        S = P[:, 0, 0] + 1.0
        K = P[:, :, 0] / S[:, None]
        gain.append(K)
        variance.append(S)
        if covariances:
            covariance.append(P)
        kept = one - K[:, :, None] * one[0]
        # Joseph's form keeps covariances positive.
        updated = kept @ P @ kept.transpose(0, 2, 1) + K[:, :, None] * K[:, None, :]
        new = F @ updated @ F.T + ratio[:, None, None] * M
        new = 0.5 * (new + new.transpose(0, 2, 1))
        change = abs(new - P) <= steady * abs(new)
        P = new
        if change.all():
            break
    return Gains(
        gain=np.array(gain).transpose(0, 2, 1),
        variance=np.array(variance),
        covariance=np.moveaxis(np.array(covariance), 1, -1)
        if covariances
        else np.empty(0),
    )


def _innovations(z: Matrix, found: Gains, states: Array | None = None) -> Matrix:
    """Return each reading less its prediction, shape (samples, columns).

    Readings are in units of the noise; predicted states are written to `states`, if
    given, shape (samples, order, columns).
    """
    order = found.gain.shape[1]
    F, steady = transition(order), len(found.gain) - 1
    innovation = np.empty(z.shape)
    x = _first_state(z, order)
    for k in range(len(z)):
        if states is not None:
            states[k] = x
        e = innovation[k] = z[k] - x[0]
        x = F @ (x + found.gain[min(k, steady)] * e)
    return innovation


def smoothed(z: Matrix, ratio: Vector, order: int) -> Array:
    """Return states given all readings, shape (samples, order, columns).

    The backward pass is that of Bryson and Frazier [Bierman1973]_: no inverse.
    """
    found = gains(ratio, order, len(z))
    P = found.covariance
    steady = len(found.gain) - 1
    states = np.empty((len(z), order, z.shape[1]))
    innovation = _innovations(z, found, states)
    back = transition(order).T
    adjoint = np.empty(states.shape)
    a = np.zeros(states.shape[1:])
    for k in range(len(z) - 1, -1, -1):
        i = min(k, steady)
        a[0] -= (found.gain[i] * a).sum(axis=0) + innovation[k] / found.variance[i]
        adjoint[k] = a
        a = back @ a
    states[:steady] -= np.einsum("kijc,kjc->kic", P[:steady], adjoint[:steady])
    states[steady:] -= np.einsum("ijc,kjc->kic", P[-1], adjoint[steady:])
    return states


def _first_state(z: Matrix, order: int) -> Matrix:
    """Return the state before the first reading, from a polynomial through a few."""
    few = min(4 * order, len(z))
    powers = np.vander(np.arange(few, dtype=np.float64), order, increasing=True)
    coefficients = np.linalg.lstsq(powers, z[:few], rcond=None)[0]
    return np.asarray(coefficients * [[factorial(i)] for i in range(order)])
