"""The sensors of a laboratory: encoders, a load cell, cameras."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Vector, array_default, freeze, frozen
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Encoders:
    """Joint positions, rounded to whole steps, on the controller's clock.

    Parameters
    ----------
    step : array_like, shape () or (joints,), [rad or m]
        Step of a reading; zero for an encoder without steps.
    """

    step: Vector = array_default(0.0)

    def __post_init__(self) -> None:
        freeze(self, step=_each(self.step, "encoders: step"))


@brief
@dataclass(frozen=True, slots=True, eq=False)
class LoadCell:
    """Joint torques, on the encoders' clock, ``torque + offset + white noise``.

    Parameters
    ----------
    noise : array_like, shape () or (joints,), [N m or N]
        Standard deviation.
    offset : array_like, shape () or (joints,), [N m or N]
    """

    noise: Vector = array_default(0.0)
    offset: Vector = array_default(0.0)

    def __post_init__(self) -> None:
        freeze(self, noise=_each(self.noise, "load cell: noise"))
        offset = frozen(self.offset, (None,) * np.ndim(self.offset), "offset")
        freeze(self, offset=offset)

    def reads(self, torque: Array, rng: np.random.Generator) -> Array:
        """Return its readings of torques, shape (samples, joints)."""
        return torque + self.offset + self.noise * rng.normal(size=torque.shape)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Cameras:
    """Joint positions and accelerations, on a clock of their own.

    The stamp of time ``t`` is ``(1 + drift) t + delay``.  Accelerations are second
    differences of true positions from picture to picture, with noise of their own: what
    shakes faster than pictures are taken is averaged, not folded back.

    Parameters
    ----------
    rate : float, [Hz]
        By their own clock.
    delay : float, [s]
        By which stamps come late; early if below zero.
    drift : float
        Relative error of their clock's rate.
    position_noise : array_like, shape () or (joints,), [rad or m]
        Standard deviation.
    acceleration_noise : array_like, shape () or (joints,), [rad/s^2 or m/s^2]
        Standard deviation.
    """

    rate: float = 300.0
    delay: float = 0.0
    drift: float = 0.0
    position_noise: Vector = array_default(0.0)
    acceleration_noise: Vector = array_default(0.0)

    def __post_init__(self) -> None:
        if not 0.0 < self.rate < np.inf:
            raise ProblemError(f"cameras: rate is {self.rate} Hz, expected more than 0")
        if not abs(self.delay) < np.inf:
            raise ProblemError(f"cameras: delay is {self.delay} s")
        if not abs(self.drift) < 0.1:
            raise ProblemError(
                f"cameras: drift is {self.drift}, expected a relative error of the "
                "clock, such as 1e-5"
            )
        for name in ("position_noise", "acceleration_noise"):
            values = _each(getattr(self, name), f"cameras: {name}")
            freeze(self, **{name: values})

    def stamps(self, start: float, stop: float) -> tuple[Vector, Vector]:
        """Return true times of the pictures between two, and their stamps, [s]."""
        first, last = ((1.0 + self.drift) * t + self.delay for t in (start, stop))
        count = int(np.floor((last - first) * self.rate * (1.0 + 1e-12))) + 1
        stamps = first + np.arange(count) / self.rate
        times = (stamps - self.delay) / (1.0 + self.drift)
        return np.clip(times, start, stop), stamps


def _each(values: ArrayLike, what: str) -> Vector:
    array = frozen(values, (None,) * np.ndim(values), what)
    if array.ndim > 1 or (array < 0.0).any():
        raise ProblemError(
            f"{what} is {array.tolist()}, expected numbers of 0 or more, one for all "
            "joints or one each"
        )
    return array
