"""How the base of a floating robot moves: what its bodies feel of it."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    Array,
    IntArray,
    Matrix,
    checked,
    freeze_arrays,
)
from consistent_id.errors import RecordingError

_CHANNELS = ("angular_velocity", "angular_acceleration", "specific_force")


@dataclass(frozen=True, slots=True, eq=False)
class BaseMotion:
    """Motion of a base, in the axes of its own frame.

    That is all that dynamics ask of it: neither place nor heading matter.

    Parameters
    ----------
    angular_velocity : array_like, shape (samples, 3), [rad/s]
    angular_acceleration : array_like, shape (samples, 3), [rad/s^2]
    specific_force : array_like, shape (samples, 3), [m/s^2]
        Acceleration of the frame's origin less gravity: what an accelerometer at the
        origin measures.  At rest and upright it is (0, 0, 9.81).
    rotation : array_like, shape (samples, 3, 3), optional
        Of the base frame in the world: turns wrenches that are given in world axes.

    Raises
    ------
    RecordingError
        If shapes differ or a value is not finite.

    Examples
    --------
    >>> at_rest = BaseMotion.at_rest(2)
    >>> at_rest.specific_force[0].tolist(), len(at_rest)
    ([0.0, 0.0, 9.81], 2)
    """

    angular_velocity: Matrix
    angular_acceleration: Matrix
    specific_force: Matrix
    rotation: Array | None = None

    def __post_init__(self) -> None:
        n = len(np.asarray(self.angular_velocity))
        shapes: dict[str, tuple[int | None, ...]] = dict.fromkeys(_CHANNELS, (n, 3))
        freeze_arrays(self, shapes, "base motion", RecordingError)
        if self.rotation is not None:
            freeze_arrays(self, {"rotation": (n, 3, 3)}, "base motion", RecordingError)

    def __len__(self) -> int:
        return len(self.angular_velocity)

    @classmethod
    def at_rest(cls, samples: int, gravity: ArrayLike = (0.0, 0.0, -9.81)) -> Self:
        """Return the motion of a base that stands still, its axes those of gravity."""
        still = np.zeros((samples, 3))
        g = checked(gravity, (3,), "gravity")
        return cls(still, still, still - g, np.tile(np.eye(3), (samples, 1, 1)))

    @classmethod
    def from_world(
        cls,
        rotation: ArrayLike,
        angular_velocity: ArrayLike,
        angular_acceleration: ArrayLike,
        acceleration: ArrayLike,
        *,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
    ) -> Self:
        """Convert a motion that is given in world axes.

        Parameters
        ----------
        rotation : array_like, shape (samples, 3, 3)
            Of the base frame in the world.
        angular_velocity, angular_acceleration : array_like, shape (samples, 3)
        acceleration : array_like, shape (samples, 3), [m/s^2]
            Of the base frame's origin, without gravity: zero at rest.
        gravity : array_like, shape (3,), [m/s^2]
        """
        R = checked(rotation, (None, 3, 3), "rotation")
        into = np.swapaxes(R, 1, 2)
        w, dw, a = (
            checked(x, (len(R), 3), "base motion")
            for x in (angular_velocity, angular_acceleration, acceleration)
        )
        felt = a - checked(gravity, (3,), "gravity")
        w, dw, felt = ((into @ x[..., None])[..., 0] for x in (w, dw, felt))
        return cls(w, dw, felt, R)

    def samples(self, keep: slice | IntArray) -> "BaseMotion":
        """Return a run of samples."""
        return BaseMotion(
            self.angular_velocity[keep],
            self.angular_acceleration[keep],
            self.specific_force[keep],
            None if self.rotation is None else self.rotation[keep],
        )

    @property
    def stacked(self) -> Matrix:
        """The three channels beside each other, shape (samples, 9)."""
        return np.hstack([getattr(self, channel) for channel in _CHANNELS])
