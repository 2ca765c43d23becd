"""Intervals: two arrays that bound a quantity.

Operations enclose the result for all values in between.  Ends are rounded to nearest,
not outwards; proofs must add a slack for rounding, see `torque_bounds`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array


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
