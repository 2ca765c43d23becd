"""The way of a trunk over its feet: six sums of sinusoids, from rest to rest."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, freeze_arrays
from consistent_id.errors import ProblemError
from consistent_id.recordings.base_motion import BaseMotion

COORDINATES = ("x", "y", "z", "roll", "pitch", "yaw")


class TrunkMotion(NamedTuple):
    """Where a trunk is, beside where it stands, and how it moves there.

    Attributes
    ----------
    place, velocity, acceleration : ndarray, shape (samples, 3)
        In the world's axes [m, m/s, m/s^2].
    base : BaseMotion
        The same as the trunk's bodies feel it, and its rotation.
    """

    place: Matrix
    velocity: Matrix
    acceleration: Matrix
    base: BaseMotion


@dataclass(frozen=True, slots=True, eq=False)
class TrunkPath:
    """Six coordinates of a trunk as sums of sinusoids that fade in and out.

    ``y(t) = e(t) sum_k a_k sin(2 pi f_k t) + b_k cos(2 pi f_k t)``; the envelope ``e``
    rises from 0 to 1 and falls again as quintics, so that the trunk begins and ends at
    rest where it stands.

    Parameters
    ----------
    frequencies : array_like, shape (frequencies,), [Hz]
    coefficients : array_like, shape (2, frequencies, 6), [m], [rad]
        ``a``, then ``b``, of `COORDINATES`: place, and roll, pitch, yaw.
    duration : float, [s]
    ramp : float, [s]
        How long the envelope rises.
    """

    frequencies: Vector
    coefficients: Array
    duration: float
    ramp: float = 1.0

    def __post_init__(self) -> None:
        where = "trunk path"
        freeze_arrays(self, {"frequencies": (None,)}, where, ProblemError)
        shape = (2, len(self.frequencies), len(COORDINATES))
        freeze_arrays(self, {"coefficients": shape}, where, ProblemError)
        if not 0.0 < 2.0 * self.ramp < self.duration:
            raise ProblemError(
                f"trunk path: ramps of {self.ramp} s at either end of "
                f"{self.duration} s; expected shorter ones, or a longer path"
            )

    def scaled(self, factor: float) -> "TrunkPath":
        """Return the path with its amplitudes multiplied."""
        return replace(self, coefficients=factor * self.coefficients)

    def evaluate(self, time: Vector) -> Array:
        """Return coordinates and two derivatives, shape (3, samples, 6)."""
        rate = 2.0 * np.pi * self.frequencies
        angle = np.asarray(time)[:, None] * rate
        s, c = np.sin(angle), np.cos(angle)
        a, b = self.coefficients
        y = s @ a + c @ b
        dy = (rate * c) @ a - (rate * s) @ b
        ddy = -((rate**2 * s) @ a) - (rate**2 * c) @ b
        e, de, dde = (x[:, None] for x in self._envelope(np.asarray(time)))
        return np.array([e * y, de * y + e * dy, dde * y + 2 * de * dy + e * ddy])

    def motion(self, time: Vector, gravity: Vector) -> TrunkMotion:
        """Return how the trunk moves [gravity in m/s^2, in the world]."""
        y, dy, ddy = self.evaluate(time)
        R, w, dw = _turning(y[:, 3:], dy[:, 3:], ddy[:, 3:])
        felt = np.einsum("nij,ni->nj", R, ddy[:, :3] - gravity)
        return TrunkMotion(y[:, :3], dy[:, :3], ddy[:, :3], BaseMotion(w, dw, felt, R))

    def _envelope(self, time: Vector) -> Array:
        """Return ``e`` and two derivatives, shape (3, samples)."""
        falling = time > 0.5 * self.duration
        u = np.where(falling, self.duration - time, time) / self.ramp
        u = np.clip(u, 0.0, 1.0)
        sign = np.where(falling, -1.0, 1.0)
        return np.array(
            [
                u**3 * (10 - 15 * u + 6 * u**2),
                sign * 30 * u**2 * (1 - u) ** 2 / self.ramp,
                60 * u * (1 - u) * (1 - 2 * u) / self.ramp**2,
            ]
        )


def _turning(
    angles: Matrix, rates: Matrix, bends: Matrix
) -> tuple[Array, Matrix, Matrix]:
    """Return ``R = Rz(yaw) Ry(pitch) Rx(roll)``, its rate in body axes, and that's."""
    (r, p, y), (dr, dp, dy), (ddr, ddp, ddy) = (x.T for x in (angles, rates, bends))
    sr, cr, sp, cp = np.sin(r), np.cos(r), np.sin(p), np.cos(p)
    sy, cy = np.sin(y), np.cos(y)
    R = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    w = [dr - dy * sp, dp * cr + dy * sr * cp, -dp * sr + dy * cr * cp]
    dw = [
        ddr - ddy * sp - dy * dp * cp,
        ddp * cr - dp * dr * sr + ddy * sr * cp + dy * dr * cr * cp - dy * dp * sr * sp,
        -ddp * sr
        - dp * dr * cr
        + ddy * cr * cp
        - dy * dr * sr * cp
        - dy * dp * cr * sp,
    ]
    return np.moveaxis(R, 2, 0), np.array(w).T, np.array(dw).T
