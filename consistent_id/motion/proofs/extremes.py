"""Extremes of a joint's path and its derivatives, proven for all time.

Over a stretch of time with middle ``m`` and half width ``r``, Taylor's theorem says

    f(m + s) <= f(m) + |f'(m)| r + B r^2 / 2,    |f''| <= B.

`peaks` finds the largest values of such functions, by dividing time where necessary.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, IntArray, Vector
from consistent_id.errors import ProblemError
from consistent_id.motion.proofs.interval import Interval
from consistent_id.recordings.joint_paths import JointPath

_FINEST = 1e-3  # least scale of the tolerance, relative to the bound over all time
_COARSE = 0.1  # share of the scale: the remainder over the first stretches
_FEWEST, _MOST_CELLS = 16, 4096
_EVALUATION = 64.0 * np.finfo(float).eps  # rounding of a path, see `path_rounding`

_SPLIT = 4
_MOST = 100_000  # most stretches at once; others keep the bound they have
_ROUNDING = 4.0 * np.finfo(float).eps  # rounding of a time, relative to the latest one


@dataclass(frozen=True, slots=True, eq=False)
class Extremes:
    """Lowest and highest values of one derivative of each joint's path.

    Parameters
    ----------
    order : int
        0 for position, 1 for velocity, and so on.
    lowest, highest : ndarray, shape (joints,)
        Proven: never below, never above.
    least, most : ndarray, shape (joints,)
        Values that are reached, at `least_time` and `most_time` [s].
    """

    joints: tuple[str, ...]
    order: int
    lowest: Vector
    highest: Vector
    least: Vector
    most: Vector
    least_time: Vector
    most_time: Vector

    @property
    def size(self) -> Vector:
        """Proven bound of the absolute value."""
        return np.maximum(-self.lowest, self.highest)


class Bounds(NamedTuple):
    """Proven bounds, and values that are reached; arrays of shape (functions,)."""

    lowest: Vector
    highest: Vector
    least: Vector
    most: Vector
    least_time: Vector
    most_time: Vector


class Enclosed(NamedTuple):
    """Functions over stretches of time, each of shape (stretches, functions)."""

    value: Array
    """At the middle."""
    above: Array
    """A number that none of them exceeds in the stretch."""


class Enclosure(Protocol):
    """Encloses functions over stretches of time."""

    def __call__(self, middle: Vector, radius: float, cell: IntArray) -> Enclosed:
        """Enclose them over ``middle - radius`` to ``middle + radius`` [s].

        `cell` is the index of the first, equal stretch that contains each one.
        """


@dataclass(frozen=True, slots=True, eq=False)
class Peaks:
    """The largest values of functions; arrays of shape (functions,).

    Parameters
    ----------
    reached : ndarray
        A value that is taken, at time `at` [s].
    bound : ndarray
        Proven never to be exceeded.
    """

    reached: Vector
    at: Vector
    bound: Vector


def extremes(path: JointPath, order: int, *, tolerance: float = 1e-6) -> Extremes:
    """Enclose the extremes of a path's derivative over its whole duration.

    Parameters
    ----------
    path : JointPath
        With two continuous derivatives more than `order`, which is not checked; or with
        such `pieces`, as in a `Move`: each is proven separately.
    tolerance : float
        Largest difference of bound and value, relative to the range of the values.

    Examples
    --------
    >>> from consistent_id.recordings.joint_paths import FourierTrajectory
    >>> path = FourierTrajectory(("elbow",), [0.5], [0.1], [[0.2]], [[0.0]], 2.0)
    >>> position = extremes(path, 0)
    >>> position.highest.round(5).tolist(), position.most_time.round(3).tolist()
    ([0.3], [0.5])
    """
    if order < 0 or not 0.0 < tolerance < 1.0:
        raise ProblemError(
            f"extremes of derivative {order} with tolerance {tolerance}; expected 0 or "
            "more, and a tolerance between 0 and 1"
        )
    found = [_of_piece(piece, order, tolerance) for piece in smooth_pieces(path)]
    return Extremes(path.joints, order, *bounds_of(found))


def _of_piece(path: JointPath, order: int, tolerance: float) -> Peaks:
    curvature = path.derivative_bound(order + 2)
    slack = path_rounding(path, order)
    scale = _scale(path, order)

    def enclose(middle: Vector, radius: float, cell: IntArray) -> Enclosed:
        value, slope = path.evaluate(middle, order + 1)[order:]
        away = abs(slope) * radius + curvature * radius**2 / 2.0 + slack
        both = np.hstack([value, -value])
        return Enclosed(both, both + np.hstack([away, away]))

    return peaks(
        enclose,
        path.start,
        path.duration,
        _cells(path, curvature, scale),
        np.tile(tolerance * scale + 2.0 * slack, 2),
    )


def path_rounding(path: JointPath, order: int) -> Vector:
    """Return the largest rounding error of a derivative's values, shape (joints,).

    A sum is rounded relative to its terms; a phase, or a time, relative to itself,
    which is equivalent to a shift in time by some units in the last place of the latest
    time.
    """
    latest = abs(path.start) + path.duration
    size, rate = path.derivative_bound(order), path.derivative_bound(order + 1)
    return np.asarray(_EVALUATION * (size + latest * rate))


def path_interval(
    path: JointPath, middle: Vector, radius: float, orders: int
) -> list[Interval]:
    """Enclose a path's derivatives of order 0 to `orders` over stretches of time.

    Each has arrays of shape (stretches, joints).
    """
    values = path.evaluate(middle, orders + 1)
    return [_around(path, values, radius, order) for order in range(orders + 1)]


def _around(path: JointPath, values: Array, radius: float, order: int) -> Interval:
    away = abs(values[order + 1]) * radius + path_rounding(path, order)
    away = away + path.derivative_bound(order + 2) * radius**2 / 2.0
    return Interval(values[order] - away, values[order] + away)


def _scale(path: JointPath, order: int) -> Vector:
    """Return the range of the values at some samples."""
    time = path.start + path.duration * np.linspace(0.0, 1.0, 64)
    values = path.evaluate(time, order)[order]
    least = _FINEST * path.derivative_bound(order)
    return np.asarray(np.maximum(np.ptp(values, axis=0), least))


def _cells(path: JointPath, curvature: Vector, scale: Vector) -> int:
    """Return the number of stretches at the beginning."""
    rate = np.sqrt(curvature / np.where(scale > 0.0, scale, np.inf)).max()
    cells = path.duration * rate / (2.0 * np.sqrt(_COARSE))
    return int(np.clip(np.ceil(cells), _FEWEST, _MOST_CELLS))


@dataclass(slots=True)
class _FoundExtremes:
    """Best values so far, and the bound of all finished stretches."""

    reached: Vector
    at: Vector
    bound: Vector

    def see(self, time: Vector, value: Array) -> None:
        best = value.argmax(axis=0)
        top = value[best, np.arange(value.shape[1])]
        better = top > self.reached
        self.reached = np.where(better, top, self.reached)
        self.at = np.where(better, time[best], self.at)

    def close(self, above: Array, done: BoolArray) -> None:
        self.bound = np.maximum(self.bound, np.where(done, above, -np.inf).max(axis=0))


def peaks(
    enclose: Enclosure,
    start: float,
    duration: float,
    cells: int,
    tolerance: Vector,
) -> Peaks:
    """Bound the largest value of each function over all time from start to end.

    A stretch whose bound exceeds the best value so far by less than `tolerance`, shape
    (functions,), is finished; the others are divided.
    """
    margin = _ROUNDING * (abs(start) + duration)
    cell = np.arange(cells)
    after = duration * (cell + 0.5) / cells
    radius = duration / (2 * cells)
    ends = np.array([start, start + duration])
    value = enclose(ends, 0.0, cell[[0, -1]]).value
    nothing = np.full(value.shape[1], -np.inf)
    search = _FoundExtremes(nothing, nothing, nothing)
    search.see(ends, value)
    alive = np.ones((cells, value.shape[1]), dtype=bool)
    while True:
        found = enclose(start + after, radius + margin, cell)
        search.see(start + after, found.value)
        still = alive & (found.above > search.reached + tolerance)
        search.close(found.above, alive & ~still)
        rows = still.any(axis=1)
        if _SPLIT * rows.sum() > _MOST or radius < margin:
            search.close(found.above, still)
            break
        if not rows.any():
            break
        radius /= _SPLIT
        steps = radius * (2.0 * np.arange(_SPLIT) - (_SPLIT - 1))
        after = (after[rows, None] + steps).ravel()
        cell, alive = np.repeat(cell[rows], _SPLIT), np.repeat(still[rows], _SPLIT, 0)
    return Peaks(search.reached, search.at, search.bound)


def smooth_pieces(path: JointPath) -> tuple[JointPath, ...]:
    """Return the pieces of a path that has any, such as a `Move`; else the path.

    Between pieces, higher derivatives jump: both values are used, and no bound of a
    derivative is valid across the junction.
    """
    return tuple(getattr(path, "pieces", (path,)))


def bounds_of(found: Sequence[Peaks]) -> Bounds:
    """Return bounds from peaks of functions and their negatives over pieces."""
    reached = np.array([one.reached for one in found])
    piece, each = reached.argmax(axis=0), np.arange(reached.shape[1])
    most, least = np.split(reached[piece, each], 2)
    most_time, least_time = np.split(
        np.array([one.at for one in found])[piece, each], 2
    )
    highest, lowest = np.split(np.max([one.bound for one in found], axis=0), 2)
    return Bounds(-lowest, highest, -least, most, least_time, most_time)
