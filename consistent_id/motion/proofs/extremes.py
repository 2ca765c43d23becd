"""Interval arithmetic, and extremes of a joint's path, proven for all time.

Operations on an `Interval` enclose the result for all values in between.  Ends are
rounded to nearest, not outwards; proofs must add a slack for rounding, see
`torque_bounds`.

Over a stretch of time with middle ``m`` and half width ``r``, Taylor's theorem says

    f(m + s) <= f(m) + |f'(m)| r + B r^2 / 2,    |f''| <= B.

`peaks` finds the largest values of such functions, by dividing time where necessary.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, IntArray, Vector
from consistent_id.errors import ProblemError
from consistent_id.recordings.joint_paths import JointPath

_FINEST = 1e-3  # least scale of the tolerance, relative to the bound over all time
_COARSE = 0.1  # share of the scale: the remainder over the first stretches
_FEWEST, _MOST_CELLS = 16, 4096
_EVALUATION = 64.0 * np.finfo(float).eps  # rounding of a path, see `path_rounding`

_SPLIT = 4
_MOST = 100_000  # most stretches at once; others keep the bound they have
_ROUNDING = 4.0 * np.finfo(float).eps  # rounding of a time, relative to the latest one


@dataclass(frozen=True, slots=True, eq=False)
class Interval:
    """Numbers between `low` and `high`, arrays of one shape.

    Examples
    --------
    >>> x = Interval(np.array([-1.0]), np.array([2.0]))
    >>> product = x * (x + 1.0)
    >>> product.low.tolist(), product.high.tolist()
    ([-3.0], [6.0])
    """

    low: Array
    high: Array

    def __array_ufunc__(
        self, ufunc: Any, method: str, *inputs: Any, **options: Any
    ) -> Any:
        """Apply NumPy's elementary functions, and operators behind an array."""
        if method != "__call__" or options:
            return NotImplemented
        x, *others = (_interval(x) for x in inputs)
        if ufunc in _INCREASING:
            low = ufunc(x.low, *(y.low for y in others))
            return Interval(low, ufunc(x.high, *(y.high for y in others)))
        if ufunc in _METHODS:
            return getattr(x, _METHODS[ufunc])(*others)
        return NotImplemented

    @property
    def size(self) -> Array:
        """Largest absolute value."""
        return np.maximum(-self.low, self.high)

    def __add__(self, other: Any) -> "Interval":
        if isinstance(other, Interval):
            return Interval(self.low + other.low, self.high + other.high)
        return Interval(self.low + other, self.high + other)

    __radd__ = __add__

    def __neg__(self) -> "Interval":
        return Interval(-self.high, -self.low)

    def __sub__(self, other: Any) -> "Interval":
        return self.__add__(-other)

    def __rsub__(self, other: Any) -> "Interval":
        return self.__neg__().__add__(other)

    def __mul__(self, other: Any) -> "Interval":
        if not isinstance(other, Interval):
            return _hull(self.low * other, self.high * other)
        first = _hull(self.low * other.low, self.high * other.high)
        second = _hull(self.low * other.high, self.high * other.low)
        return first.union(second)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> "Interval":
        if isinstance(other, Interval):
            if not (other.low * other.high > 0.0).all():
                raise ValueError("division by an interval that may contain zero")
            return self * _hull(1.0 / other.low, 1.0 / other.high)
        return _hull(self.low / other, self.high / other)

    def __rtruediv__(self, other: Any) -> "Interval":
        return _interval(other) / self

    def __pow__(self, exponent: float) -> "Interval":
        """Raise to a positive power, which is an integer if the base is negative."""
        if not exponent > 0.0:
            raise ValueError(f"power {exponent} of an interval, expected above zero")
        if exponent % 2 == 1.0:
            return Interval(self.low**exponent, self.high**exponent)
        base = abs(self) if exponent % 2 == 0.0 else self
        if (base.low < 0.0).any():
            raise ValueError(f"power {exponent} of an interval that is negative")
        return Interval(base.low**exponent, base.high**exponent)

    def __abs__(self) -> "Interval":
        return Interval(np.maximum(np.maximum(self.low, -self.high), 0.0), self.size)

    def union(self, other: "Interval") -> "Interval":
        """Return the smallest interval that contains both."""
        return Interval(
            np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        )

    def columns(self) -> list["Interval"]:
        """Return the columns of a matrix."""
        return [Interval(x, y) for x, y in zip(self.low.T, self.high.T, strict=True)]

    def sin(self) -> "Interval":
        """Enclose the sine: ``sin(m + s) = sin m cos s + cos m sin s``."""
        return self._turned(np.sin, np.cos)

    def cos(self) -> "Interval":
        """Enclose the cosine."""
        return self._turned(np.cos, np.sin)

    def _turned(self, function: Any, other: Any) -> "Interval":
        middle, radius = (self.low + self.high) / 2.0, (self.high - self.low) / 2.0
        value = function(middle)
        # 1 - cos s <= s^2 / 2 and |sin s| <= |s|
        away = abs(other(middle)) * radius + abs(value) * radius**2 / 2.0
        return Interval(np.maximum(value - away, -1.0), np.minimum(value + away, 1.0))


_INCREASING = (
    np.add,
    np.maximum,
    np.minimum,
    np.sign,
    np.tanh,
    np.arctan,
    np.exp,
    np.sinh,
    np.arcsinh,
)
_METHODS = {
    np.subtract: "__sub__",
    np.multiply: "__mul__",
    np.divide: "__truediv__",
    np.negative: "__neg__",
    np.absolute: "__abs__",
    np.sin: "sin",
    np.cos: "cos",
}
"""NumPy's functions that can be enclosed; others are refused with a TypeError."""


def _interval(x: Any) -> Interval:
    return x if isinstance(x, Interval) else Interval(np.asarray(x), np.asarray(x))


def _hull(x: Array, y: Array) -> Interval:
    return Interval(np.minimum(x, y), np.maximum(x, y))


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
    highest, lowest = np.split(np.stack([one.bound for one in found]).max(axis=0), 2)
    return Bounds(-lowest, highest, -least, most, least_time, most_time)
