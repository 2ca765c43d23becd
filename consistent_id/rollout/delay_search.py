"""The delay of commands with the least error of rollouts, and its standard error.

Near its least value the squared error is a parabola of the delay, so few delays are
tried.  The error is that of the delay's scatter between blocks of the motion: each has
a parabola of its own, and the blocks are left out one at a time (jackknife).

A delay that is found to be 0 has no such error: the parabola may be lowest below 0,
where no delay can be tried.  Its upper limit is the delay from which on the error rises
by more than the scatter of its slope between blocks.

The error may have a second least value, which is nearly as small, at another delay.
The parabola at the best one does not show it.  So delays are compared in pairs.  Those
outside of the best one's valley that no other one beats with certainty are as good.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from consistent_id._support.arrays import Matrix, Vector

MOST = 0.02
"""Longest delay of commands that is tried, [s]: networks and drives take less."""

FIRST = (0.0, 0.005, 0.01, 0.02)  # s, tried first where nothing is known
NEAR = 0.0025  # s, a neighbour of the best delay is at least as near as this
APART = 2.0 * NEAR
"""Distance of delays that are tried to find others that are as good, [s]."""

SAME = 0.0002
"""Difference of delays that are not distinguished, [s]."""

_PARABOLAS = 3
_QUANTILE = 0.975  # of Student's t, for 95 %
_FINE = 1e-5  # s, of an upper limit
_FLAT = 1e-12  # relative change of an error over 1 ms that is rounding
_CHANCE = 0.025  # of an error that is larger, one-sided


@dataclass(frozen=True, slots=True)
class FoundDelay:
    """A delay with the least error of rollouts.

    Parameters
    ----------
    delay : float, [s]
    error : float, [s]
        Standard error, from the scatter between blocks of the motion; infinite where
        the squared error has no least value in between, or at a bound.
    at_bound : bool
        Whether the error still falls at the longest delay that was tried, or towards
        delays below 0: then there is none, or commands are logged later than they act.
    blocks : int
        Number of blocks of the motion.
    limit : float, optional, [s]
        Upper limit (95 %) of a delay at the bound 0, from the scatter between blocks;
        None where it is not known, and for other delays.
    as_good : tuple of float, optional, [s]
        The least and the greatest delay that was tried, outside of the best one's
        valley, and that no other one beats with certainty (95 %); None where there is
        none.
    """

    delay: float
    error: float
    at_bound: bool
    blocks: int
    limit: float | None = None
    as_good: tuple[float, float] | None = None

    @property
    def interval(self) -> tuple[float, float] | None:
        """Its 95 % interval by the scatter between blocks [s]; None if not known.

        It contains the delays that are as good.
        """
        if self.at_bound:
            if self.limit is None:
                return None
            low, high = 0.0, self.limit
        elif np.isfinite(self.error):
            half = student(self.blocks) * self.error
            low, high = self.delay - half, self.delay + half
        else:
            return None
        ends = self.as_good or (low, high)
        return min(low, ends[0]), max(high, ends[1])


def found_delay(
    squares: Callable[[float], Vector],
    first: Sequence[float] = FIRST,
    most: float = MOST,
    *,
    beyond: bool = False,
) -> FoundDelay:
    """Return the delay from 0 to `most` at which the sum of squares is least.

    Parameters
    ----------
    squares : callable
        Returns the squared errors of blocks of the motion for a delay [s], shape
        (blocks,); infinite where rollouts diverge.
    first : sequence of float, [s]
        Delays that are tried before the first parabola.
    most : float, [s]
        Longest delay.
    beyond : bool
        Whether delays as good are looked for, beyond those that were tried for the
        best one.
    """
    tried: dict[float, Vector] = {}

    def total(delay: float) -> float:
        if delay not in tried:
            tried[delay] = np.asarray(squares(delay), dtype=float)
        return float(tried[delay].sum())

    for delay in sorted({round(min(max(d, 0.0), most), 6) for d in first}):
        total(delay)
    if len(tried) < 3:  # a parabola needs a third
        best = min(tried, key=total)
        total(2.0 * NEAR if best < 2.0 * NEAR else best - 2.0 * NEAR)
    for _ in range(_PARABOLAS):
        best = min(tried, key=total)
        lowest = _lowest([(d, total(d)) for d in _around(tried, best)])
        if min(abs(lowest - d) for d in tried) < SAME:
            break
        total(lowest)
    best = min(tried, key=total)
    for reach in (-NEAR, NEAR):
        while abs(reach) >= SAME:
            near = min(max(best + reach, 0.0), most)
            if abs(near - best) < SAME or _has_between(tried, best, best + 2.0 * reach):
                break
            if np.isfinite(total(round(near, 6))):
                break
            reach /= 2.0  # its motion diverges
    best = min(tried, key=total)
    places = _around(tried, best)
    points = [(d, total(d)) for d in places]
    error = _jackknifed(places, np.array([tried[d] for d in places]))
    # Below 0 a parabola is a poor guess: how far its lowest point is does not count,
    # nor whether it has one, if the error rises from 0 on.
    vertex = _vertex(points)
    early = round(vertex, 6) < 0.0 or (vertex == best == 0.0 and len(points) > 2)
    early |= best == 0.0 and not np.isfinite(error)
    at_bound = early or best >= most - SAME
    limit = _limit(tried, total, most) if early else None
    error, blocks = np.inf if at_bound else error, len(tried[best])
    as_good = _as_good(tried, total, most) if beyond else None
    return FoundDelay(_lowest(points), error, at_bound, blocks, limit, as_good)


def _has_between(tried: dict[float, Vector], best: float, end: float) -> bool:
    """Return whether a delay between the best one and an end has a finite error."""
    known = [d for d, squares in tried.items() if np.isfinite(squares).all()]
    return any(1e-6 < (d - best) / (end - best) < 1.0 - 1e-6 for d in known)


def _as_good(
    tried: dict[float, Vector], total: Callable[[float], float], most: float
) -> tuple[float, float] | None:
    """Return the least and the greatest delay that no other one beats, [s].

    Delays further out are tried until one is beaten.  None if no other one is as good.
    Those of the best one's own valley do not count: in between, the error is nowhere
    above a straight line.  There, the scatter of the parabola is more certain.
    """
    for end, step in ((min, -APART), (max, APART)):
        while not _beaten(last := end(tried), tried):
            further = round(min(max(last + step, 0.0), most), 6)
            if further in tried:
                break
            total(further)
    best = min(tried, key=total)

    def is_apart(delay: float) -> bool:
        slope = (total(delay) - total(best)) / (delay - best)
        between = [d for d in tried if 0.0 < (d - best) / (delay - best) < 1.0]
        return any(total(d) > total(best) + slope * (d - best) for d in between)

    others = [d for d in tried if d != best and not _beaten(d, tried)]
    good = [d for d in others if is_apart(d)]
    return (min(good), max(good)) if good else None


def _beaten(delay: float, tried: dict[float, Vector]) -> bool:
    """Return whether a delay has a larger error than another one with certainty."""
    squares = tried[delay]
    if not np.isfinite(squares).all():
        return True
    others = [other for other in tried.values() if np.isfinite(other).all()]
    return any(_larger(squares - other) for other in others)


def _larger(more: Vector) -> bool:
    """Return whether the sum of differences of blocks is above 0 by more than chance.

    If two delays are as good, the sign of each block's difference is chance.  So its
    signs are changed in all ways (sign-flip test).  It is exact, also where few blocks
    have most of the error, of which the scatter would hide what all blocks agree on.
    """
    signs = np.array(list(product((1.0, -1.0), repeat=len(more))))
    rounding = 1e-12 * abs(more).sum()
    return bool((signs @ more >= more.sum() - rounding).mean() <= _CHANCE)


def _limit(
    tried: dict[float, Vector], total: Callable[[float], float], most: float
) -> float | None:
    """Return the delay from which on the error rises with certainty (95 %), [s].

    Longer delays are tried until it does; None if it does nowhere.
    """
    if len(next(iter(tried.values()))) < 2:
        return None
    for longer in (*(NEAR * times for times in (1, 2, 4)), most):
        total(round(longer, 6))
        known = sorted(d for d, s in tried.items() if np.isfinite(s).all())
        if len(known) > 2 and (limit := _rising(known, tried)) is not None:
            return limit
    return None


def _rising(delays: list[float], tried: dict[float, Vector]) -> float | None:
    """Return the delay from which on the slope of the error is positive (95 %).

    Slopes between delays that were tried are those of each block in their middle; they
    are linear in between, and down to 0.
    """
    steps = np.diff(delays)[:, None]
    slopes = np.diff([tried[d] for d in delays], axis=0) / steps  # (middles, blocks)
    middles = (np.array(delays)[1:] + np.array(delays)[:-1]) / 2.0
    first = slopes[0] - middles[0] * (slopes[1] - slopes[0]) / (middles[1] - middles[0])
    middles, slopes = np.append(0.0, middles), np.vstack([first, slopes])
    places = np.linspace(0.0, middles[-1], round(middles[-1] / _FINE) + 1)
    there = np.column_stack([np.interp(places, middles, one) for one in slopes.T])
    error = there.std(axis=1, ddof=1) / np.sqrt(there.shape[1])
    rises = there.mean(axis=1) > student(there.shape[1]) * error
    flat = np.flatnonzero(~rises)
    if not len(flat):
        return 0.0
    return None if not rises[-1] else float(places[flat[-1] + 1])


def student(blocks: int) -> float:
    """Return the quantile of Student's t of a 95 % interval."""
    from scipy.special import stdtrit

    return float(stdtrit(blocks - 1, _QUANTILE))


def _around(tried: dict[float, Vector], best: float) -> list[float]:
    """Return the best delay and its neighbours, three in all unless it is at an end."""
    order = sorted(d for d, s in tried.items() if np.isfinite(s).all())
    if best not in order:
        return [best]
    place = min(max(order.index(best), 1), max(len(order) - 2, 1))
    return order[place - 1 : place + 2]


def _lowest(points: list[tuple[float, float]]) -> float:
    """Return where a parabola through three points is lowest, within their delays."""
    delays = [d for d, _ in points]
    return round(float(np.clip(_vertex(points), min(delays), max(delays))), 6)


def _vertex(points: list[tuple[float, float]]) -> float:
    """Return where a parabola through three points is lowest; else the best point."""
    delays = np.array([d for d, _ in points])
    values = np.array([v for _, v in points])
    at = float(delays[values.argmin()])
    if len(points) < 3 or not np.isfinite(values).all():
        return at
    lowest = _lowest_of_parabola(delays, values, at)
    return at if lowest is None else lowest


def _lowest_of_parabola(delays: Vector, values: Vector, at: float) -> float | None:
    """Return where a parabola is lowest; None where it has no such point.

    `at` is a delay near it.
    """
    bend, slope, _ = np.polyfit((delays - at) * 1e3, values, 2)  # ms, for the condition
    if bend <= _FLAT * abs(values).max():
        return None
    return float(at - 1e-3 * slope / (2.0 * bend))


def _jackknifed(delays: list[float], squares: Matrix) -> float:
    """Return the standard error of the lowest point over blocks left out."""
    count = squares.shape[1]
    if len(delays) < 3 or count < 2:
        return np.inf
    at = delays[1]
    left_out = []
    for block in range(count):
        rest = np.delete(squares, block, axis=1).sum(axis=1)
        lowest = _lowest_of_parabola(np.array(delays), rest, at)
        if lowest is None:
            return np.inf
        left_out.append(lowest)
    return float(np.sqrt((count - 1) * np.var(left_out)))
