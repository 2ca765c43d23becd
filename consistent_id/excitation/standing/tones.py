"""Search among a few tones for each coordinate of a trunk, no two of one frequency."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.excitation.standing.trunk_path import COORDINATES, TrunkPath

HIGHEST = 5.0
"""Hz: below the band in which a controller of legs follows, and its flexibility."""

_LOWEST = 0.3  # Hz; slower sways reach no further, and take long to come round
_TONES = 4  # of each coordinate
_CROWD, _BEST = 16, 4  # candidates of a round, and those that the next is like
# Spreads to begin with: of a coordinate's level (logarithm), of the power of the
# frequency by which its amplitudes fall, of what each tone differs from that
# (logarithm), and of phases [rad].
_LEVEL, _SLOPE, _OWN, _PHASE = 1.0, 0.8, 0.3, 2.0
_FALL = 1.0  # power to begin with: velocities alike at all frequencies
_KEPT = 0.05  # of a spread, at which it no longer shrinks
_FORGET = 0.6  # of the spread of a round, in that of the next
_LARGEST = 0.15  # rad, of a candidate's largest tone before it is made to fit
_LEVER = 0.3  # m; how far a turn by one radian takes what a sway of this length does


@dataclass(frozen=True, slots=True, eq=False)
class Tried:
    """A path that keeps its limits, and the size of its errors.

    None, and infinite, if there is none.
    """

    path: TrunkPath | None
    error: float


@dataclass(frozen=True, slots=True, eq=False)
class Searched:
    """The best path, and the least error of the first round, of random paths."""

    best: Tried
    first: float


def searched_tones(
    tried: Callable[[TrunkPath], Tried],
    duration: float,
    candidates: int,
    seed: int,
    tell: Callable[[int, float], None] | None = None,
) -> Searched:
    """Return the best of many paths whose tones have different frequencies.

    Tones of different frequencies are perpendicular to each other, whatever their
    phases, so that no coordinate excuses another.  Each coordinate has a level and a
    power of the frequency by which amplitudes fall, each tone what it differs from
    that, and a phase: they are drawn about those of the best four of a round of
    sixteen, ever nearer to them (cross-entropy method).

    Parameters
    ----------
    tried : callable
        Makes a path as large as it may be, and says its error.
    duration : float, [s]
    tell : callable, optional
        Given how many candidates were tried, and the least error so far.
    """
    rng = np.random.default_rng(seed)
    frequencies = np.geomspace(_LOWEST, HIGHEST, _TONES * len(COORDINATES))
    spread = _spreads(len(frequencies))
    mean = np.where(spread == _SLOPE, -_FALL, 0.0)
    floor = _KEPT * spread
    best, first, done = Tried(None, np.inf), np.inf, 0
    point = mean
    while done < candidates:
        round_ = []
        for _ in range(min(_CROWD, candidates - done)):
            drawn = mean + spread * rng.normal(size=len(mean))
            one = tried(_path(frequencies, drawn, duration))
            round_.append((one.error, drawn))
            if one.error < best.error:
                best, point = one, drawn
        done += len(round_)
        first = best.error if done <= _CROWD else first
        round_.sort(key=lambda pair: pair[0])
        kept = [drawn for error, drawn in round_[:_BEST] if np.isfinite(error)]
        elite = np.array([*kept, point])
        mean = elite.mean(axis=0)
        spread = np.maximum(_FORGET * spread + (1 - _FORGET) * elite.std(axis=0), floor)
        if tell is not None:
            tell(done, best.error)
    return Searched(best, first)


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
