"""Intervals: two arrays between which a quantity lies.

Operations enclose the result for all values in between.  Ends are rounded to nearest,
not outwards; who claims a proof adds a slack for that, see `torque_bounds`.
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
        if method != "__call__" or options or ufunc not in _METHODS:
            return NotImplemented
        first, *others = inputs
        if isinstance(first, Interval):
            return getattr(first, _METHODS[ufunc])(*others)
        first = np.asarray(first)
        return getattr(Interval(first, first), _METHODS[ufunc])(*others)

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
                raise ValueError("division by an interval that may hold zero")
            return self * _hull(1.0 / other.low, 1.0 / other.high)
        return _hull(self.low / other, self.high / other)

    def __rtruediv__(self, other: Any) -> "Interval":
        return Interval(np.asarray(other), np.asarray(other)).__truediv__(self)

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
        """Return the smallest interval that holds both."""
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

    def sign(self) -> "Interval":
        """Enclose the sign."""
        return Interval(np.sign(self.low), np.sign(self.high))

    def tanh(self) -> "Interval":
        """Enclose the hyperbolic tangent."""
        return Interval(np.tanh(self.low), np.tanh(self.high))

    def exp(self) -> "Interval":
        """Enclose the exponential."""
        return Interval(np.exp(self.low), np.exp(self.high))


_METHODS = {
    np.add: "__add__",
    np.subtract: "__sub__",
    np.multiply: "__mul__",
    np.divide: "__truediv__",
    np.negative: "__neg__",
    np.power: "__pow__",
    np.absolute: "__abs__",
    np.sin: "sin",
    np.cos: "cos",
    np.sign: "sign",
    np.tanh: "tanh",
    np.exp: "exp",
}
"""What encloses each of NumPy's functions; others are refused with a TypeError."""


def _hull(x: Array, y: Array) -> Interval:
    return Interval(np.minimum(x, y), np.maximum(x, y))
