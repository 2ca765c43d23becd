"""Jets: a function of time and its derivatives, on which the recursion can run.

Taylor coefficients ``f, f', f''/2, ...`` of any scalar: arrays, for values at instants,
or `Interval`, for all values that they take over stretches of time.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import factorial
from typing import Any, ClassVar

import numpy as np


@dataclass(frozen=True, slots=True, eq=False)
class Jet:
    """Taylor coefficients with respect to time, up to some order.

    Examples
    --------
    >>> t = Jet((np.array([3.0]), 1.0, 0.0))
    >>> [float(c) for c in np.ravel((t * t * 2.0 + 1.0).coefficients)]
    [19.0, 12.0, 2.0]
    """

    coefficients: tuple[Any, ...]
    __array_ufunc__: ClassVar[None] = None  # an array times a jet is ours

    def __add__(self, other: Any) -> "Jet":
        a = self.coefficients
        if isinstance(other, Jet):
            return Jet(tuple(x + y for x, y in zip(a, other.coefficients, strict=True)))
        return Jet((a[0] + other, *a[1:]))

    __radd__ = __add__

    def __neg__(self) -> "Jet":
        return Jet(tuple(-x for x in self.coefficients))

    def __sub__(self, other: Any) -> "Jet":
        return self.__add__(-other)

    def __rsub__(self, other: Any) -> "Jet":
        return self.__neg__().__add__(other)

    def __mul__(self, other: Any) -> "Jet":
        a = self.coefficients
        if not isinstance(other, Jet):
            return Jet(tuple(x * other for x in a))
        b = other.coefficients
        return Jet(tuple(_convolved(a, b, k) for k in range(len(a))))

    __rmul__ = __mul__


def jet(derivatives: Sequence[Any]) -> Jet:
    """Return the jet of a function from its value and derivatives."""
    return Jet(tuple(x * (1.0 / factorial(k)) for k, x in enumerate(derivatives)))


def sine_and_cosine(x: Jet) -> tuple[Jet, Jet]:
    """Return the jets of ``sin x`` and ``cos x``: ``s' = c x'`` and ``c' = -s x'``."""
    q = x.coefficients
    s, c = [_sine(q[0])], [_cosine(q[0])]
    slopes = [k * q[k] for k in range(1, len(q))]
    for k in range(1, len(q)):
        s.append(_convolved(slopes, c, k - 1) * (1.0 / k))
        c.append(_convolved(slopes, s, k - 1) * (-1.0 / k))
    return Jet(tuple(s)), Jet(tuple(c))


def _convolved(a: Sequence[Any], b: Sequence[Any], k: int) -> Any:
    total = a[0] * b[k]
    for i in range(1, k + 1):
        total = total + a[i] * b[k - i]
    return total


def _sine(x: Any) -> Any:
    return np.sin(x) if isinstance(x, np.ndarray) else x.sin()


def _cosine(x: Any) -> Any:
    return np.cos(x) if isinstance(x, np.ndarray) else x.cos()
