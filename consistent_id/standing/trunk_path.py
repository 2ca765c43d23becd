"""The path of a trunk over its feet, and the search among a few tones for it.

A path is six sums of sinusoids, from rest to rest; no two tones have one frequency.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, freeze_arrays
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.recordings.beside import BaseMotion

COORDINATES = ("x", "y", "z", "roll", "pitch", "yaw")

HIGHEST = 5.0
"""Hz: below the band in which a controller of legs follows, and its flexibility."""

_LOWEST = 0.3  # Hz; slower sways reach no further, and take long to come round
_TONES = 4  # of each coordinate
_CROWD, _BEST = 16, 4  # candidates of a round, and those that the next is like
# Spreads to begin with: of a coordinate's level (logarithm), of the power of the
# frequency by which its amplitudes fall, of each tone's difference from that
# (logarithm), and of phases [rad].
_LEVEL, _SLOPE, _OWN, _PHASE = 1.0, 0.8, 0.3, 2.0
_FALL = 1.0  # power to begin with: velocities alike at all frequencies
_KEPT = 0.05  # of a spread, at which it no longer shrinks
_FORGET = 0.6  # of the spread of a round, in that of the next
_LARGEST = 0.15  # rad, of a candidate's largest tone before it is made to fit
_LEVER = 0.3  # m; how far a turn by one radian takes what a sway of this length does


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


@brief
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


@dataclass(frozen=True, slots=True, eq=False)
class Tried:
    """A path that keeps its limits, and the size of its errors.

    None, and infinite, if there is none.
    """

    path: TrunkPath | None
    error: float


@dataclass(frozen=True, slots=True, eq=False)
class Searched:
    """The best path, the least error of the first round, and how many were tried."""

    best: Tried
    first: float
    count: int


NOTHING_FOUND = Searched(Tried(None, np.inf), np.inf, 0)
"""The state of a search before the first path."""


def searched_tones(
    tried: Callable[[TrunkPath], Tried], duration: float, candidates: int, seed: int
) -> Iterator[Searched]:
    """Yield the best so far of many paths whose tones have different frequencies.

    Tones of different frequencies are perpendicular to each other, whatever their
    phases, so that no coordinate excuses another.  Each coordinate has a level and a
    power of the frequency by which amplitudes fall; each tone has a difference from
    that, and a phase. They are drawn about those of the best four of a round of
    sixteen, ever nearer to them (cross-entropy method).

    Parameters
    ----------
    tried : callable
        Makes a path as large as it may be, and says its error.
    duration : float, [s]
    """
    rng = np.random.default_rng(seed)
    frequencies = np.geomspace(_LOWEST, HIGHEST, _TONES * len(COORDINATES))
    spread = _spreads(len(frequencies))
    mean = np.where(spread == _SLOPE, -_FALL, 0.0)
    floor = _KEPT * spread
    best, first, done = NOTHING_FOUND.best, NOTHING_FOUND.first, NOTHING_FOUND.count
    point = mean
    while done < candidates:
        round_ = []
        for _ in range(min(_CROWD, candidates - done)):
            drawn = mean + spread * rng.normal(size=len(mean))
            one = tried(_path(frequencies, drawn, duration))
            round_.append((one.error, drawn))
            if one.error < best.error:
                best, point = one, drawn
            done += 1
            first = best.error if done <= _CROWD else first
            yield Searched(best, first, done)
        round_.sort(key=lambda pair: pair[0])
        kept = [drawn for error, drawn in round_[:_BEST] if np.isfinite(error)]
        elite = np.array([*kept, point])
        mean = elite.mean(axis=0)
        spread = np.maximum(_FORGET * spread + (1 - _FORGET) * elite.std(axis=0), floor)


def _spreads(tones: int) -> Vector:
    """Return the spread of each number that is drawn, to begin with."""
    kinds = (_LEVEL, len(COORDINATES)), (_SLOPE, len(COORDINATES))
    of_tones = (_OWN, tones), (_PHASE, tones)
    return np.concatenate([np.full(n, size) for size, n in (*kinds, *of_tones)])


def _path(frequencies: Vector, drawn: Vector, duration: float) -> TrunkPath:
    """Return the path of tones; its coordinates take turns in the frequencies."""
    coordinates, tones = len(COORDINATES), len(frequencies)
    ends = np.cumsum([coordinates, coordinates, tones])
    levels, slopes, others, phases = np.split(drawn, ends)
    tone = np.arange(tones)
    # Each four tones of a coordinate are shifted, so that none has all the slow ones.
    own = (tone + tone // coordinates) % coordinates
    sizes = levels[own] + slopes[own] * np.log(frequencies) + others
    sizes = _LARGEST * np.exp(sizes - sizes.max())
    lever = np.where(own < 3, _LEVER, 1.0)
    coefficients = np.zeros((2, tones, coordinates))
    coefficients[0, tone, own] = lever * sizes * np.cos(phases)
    coefficients[1, tone, own] = lever * sizes * np.sin(phases)
    return TrunkPath(frequencies, coefficients, duration)
