"""The least value of a function of one number, without the import of scipy.optimize."""

from collections.abc import Callable
from math import sqrt

_GOLDEN = (3.0 - sqrt(5.0)) / 2.0
_STEEP = 1.5e-8  # of a number: function values nearer than that are alike


def bounded_minimum(
    f: Callable[[float], float], low: float, high: float, *, tolerance: float = 1e-5
) -> float:
    """Return where a function is least between two bounds, by Brent's method.

    A parabola through the best three points says where to look next; where it leads
    astray, the golden section does.  With several minima, one of them is found.

    Parameters
    ----------
    f : callable
    low, high : float
    tolerance : float
        Of the result, absolute.

    Examples
    --------
    >>> round(bounded_minimum(lambda x: (x - 0.3) ** 2, 0.0, 1.0), 4)
    0.3
    """
    best = second = third = low + _GOLDEN * (high - low)
    at_best = at_second = at_third = f(best)
    step = before = 0.0
    while True:
        middle = 0.5 * (low + high)
        least = _STEEP * abs(best) + tolerance / 3.0
        if abs(best - middle) <= 2.0 * least - 0.5 * (high - low):
            return best
        r = (best - second) * (at_best - at_third)
        q = (best - third) * (at_best - at_second)
        p, q = (best - third) * q - (best - second) * r, 2.0 * (q - r)
        p, q = (-p if q > 0.0 else p), abs(q)
        last, before = before, step
        if abs(p) < abs(0.5 * q * last) and q * (low - best) < p < q * (high - best):
            step = p / q
            if min(best + step - low, high - best - step) < 2.0 * least:
                step = least if best < middle else -least
        else:
            before = (low if best >= middle else high) - best
            step = _GOLDEN * before
        x = best + (step if abs(step) >= least else least if step > 0.0 else -least)
        at_x = f(x)
        if at_x <= at_best:
            low, high = (low, best) if x < best else (best, high)
            third, at_third, second, at_second = second, at_second, best, at_best
            best, at_best = x, at_x
            continue
        low, high = (x, high) if x < best else (low, x)
        if at_x <= at_second or second == best:
            third, at_third, second, at_second = second, at_second, x, at_x
        elif at_x <= at_third or third in (best, second):
            third, at_third = x, at_x
