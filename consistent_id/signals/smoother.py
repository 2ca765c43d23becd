"""Velocity and acceleration by a Kalman smoother whose noise levels the data choose."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._arrays import Matrix, Vector, frozen
from consistent_id.errors import RecordingError
from consistent_id.recording import Recording
from consistent_id.signals.clocks import uniform_rate
from consistent_id.signals.kalman import filtered, gains, smoothed
from consistent_id.signals.resolution import encoder_resolution

_DECADES = np.arange(-18.0, 5.0)  # of the ratio of drive to noise, first tried
_FINE = np.arange(-1.0, 1.01, 0.25)  # decades about the best of them

Driven = Literal["jerk", "snap"]
_ORDER = {"jerk": 3, "snap": 4}


@dataclass(frozen=True, slots=True, eq=False)
class MotionNoise:
    """How far readings are off, and how lively the motion is.

    Parameters
    ----------
    joints : tuple of str
    driven : {"jerk", "snap"}
        Which derivative of the position is taken for white noise.
    position : array_like, shape (joints,), [rad or m]
        Standard deviation of a reading.
    drive : array_like, shape (joints,), [(rad or m)^2 / s^5 or / s^7]
        Spectral density of jerk or snap.
    """

    joints: tuple[str, ...]
    driven: Driven
    position: Vector
    drive: Vector

    def __post_init__(self) -> None:
        if self.driven not in _ORDER:
            raise RecordingError(
                f"driven is {self.driven!r}, expected one of {', '.join(_ORDER)}"
            )
        for name in ("position", "drive"):
            values = frozen(
                getattr(self, name), (len(self.joints),), name, RecordingError
            )
            if not (values > 0.0).all():
                raise RecordingError(f"{name} is {values}, expected positive numbers")
            object.__setattr__(self, name, values)


def motion_noise(
    recording: Recording,
    *,
    driven: Driven = "snap",
    least: ArrayLike | None = None,
) -> MotionNoise:
    """Estimate both noise levels of each joint by maximum likelihood.

    The likelihood is that of the innovations, each predicted from the readings before.

    Parameters
    ----------
    recording : Recording
        As recorded, uniformly sampled: what was filtered has no white noise left.
    driven : {"jerk", "snap"}
        Which derivative of the position is taken for white noise.
    least : array_like, shape (joints,), optional, [rad or m]
        Below which the noise of a reading cannot lie; by default the encoder's step
        over ``sqrt(12)``, where there is one.
    """
    rate, order = uniform_rate(recording), _order(driven)
    _enough(recording, order)
    if least is None:
        least = encoder_resolution(recording) / np.sqrt(12.0)
    size = abs(recording.position).max(axis=0)
    rounding = 4.0 * np.finfo(np.float64).eps * np.maximum(size, 1e-3)
    floor = np.maximum(frozen(least, size.shape, "least", RecordingError), rounding)
    z = recording.position - recording.position[0]
    exponent = np.tile(_DECADES[:, None], len(size))
    for finer in (_FINE, None):
        cost, variance = _costs(z, exponent, order, floor)
        best = cost.argmin(axis=0)
        near = np.take_along_axis(exponent, best[None], axis=0)[0]
        noise2 = np.take_along_axis(variance, best[None], axis=0)[0]
        if finer is not None:
            exponent = near + finer[:, None]
    drive = 10.0**near * noise2 * rate ** (2 * order - 1)
    return MotionNoise(recording.joints, driven, np.sqrt(noise2), drive)


def kalman_differentiated(
    recording: Recording, noise: MotionNoise | None = None
) -> Recording:
    """Return the most likely motion behind the readings, at every sample given all.

    Position, velocity and acceleration all come of the recorded position, by a Kalman
    filter and the smoother of Rauch, Tung and Striebel [Rauch1965]_.

    Parameters
    ----------
    recording : Recording
        As recorded, uniformly sampled.
    noise : MotionNoise, optional
        By default `motion_noise` of the recording.
    """
    rate = uniform_rate(recording)
    noise = motion_noise(recording) if noise is None else noise
    if noise.joints != recording.joints:
        raise RecordingError(
            f"noise is that of joints {noise.joints}, {recording.name} has "
            f"{recording.joints}"
        )
    order = _order(noise.driven)
    _enough(recording, order)
    ratio = noise.drive / rate ** (2 * order - 1) / noise.position**2
    start = recording.position[0]
    z = (recording.position - start) / noise.position
    states = smoothed(z, gains(ratio, order, len(z))) * noise.position
    return replace(
        recording,
        position=states[:, 0] + start,
        velocity=states[:, 1] * rate,
        acceleration=states[:, 2] * rate**2,
    )


def _costs(
    z: Matrix, exponent: Matrix, order: int, floor: Vector
) -> tuple[Matrix, Matrix]:
    """Return ``-2 log`` likelihoods and the best noise variance for ratios tried."""
    tried, joints = exponent.shape
    found = gains(10.0 ** exponent.ravel(), order, len(z))
    _, innovation = filtered(np.tile(z, tried), found)
    last = np.minimum(np.arange(len(z)), len(found.variance) - 1)
    S = found.variance[last[order:]]
    n = len(S)
    power = (innovation[order:] ** 2 / S).sum(axis=0).reshape(tried, joints)
    variance = np.maximum(power / n, floor**2)
    size = np.log(S).sum(axis=0).reshape(tried, joints)
    return n * np.log(variance) + power / variance + size, variance


def _order(driven: str) -> int:
    if driven not in _ORDER:
        raise RecordingError(
            f"driven is {driven!r}, expected one of {', '.join(_ORDER)}"
        )
    return _ORDER[driven]


def _enough(recording: Recording, order: int) -> None:
    if len(recording) < 8 * order:
        raise RecordingError(
            f"{recording.name}: {len(recording)} samples, expected {8 * order} or more "
            "for a smoother"
        )
