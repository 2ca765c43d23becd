"""Polynomials by their Bernstein coefficients, between which their values lie.

    p(u) = sum_i  binomial(n, i) u^i (1 - u)^(n - i) c_i,    0 <= u <= 1

is a weighted mean of the coefficients [Farouki2012]_; so a polynomial is proven to stay
within a limit when they do.  Halving the interval again and again brings them near.
"""

from functools import lru_cache
from math import comb, perm

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector

_HALVINGS = 6  # the error of coefficients is then some thousandths of the polynomial


def values(control: Matrix, u: Vector) -> Matrix:
    """Return the polynomials' values, shape (samples, joints).

    Parameters
    ----------
    control : ndarray, shape (degree + 1, joints)
    u : ndarray, shape (samples,)
    """
    n = len(control) - 1
    i = np.arange(n + 1)
    binomial = np.array([comb(n, k) for k in range(n + 1)], dtype=float)
    return np.asarray(binomial * u[:, None] ** i * (1.0 - u[:, None]) ** (n - i)) @ (
        control
    )


def derivative(control: Array, duration: Vector, order: int = 1) -> Array:
    """Return the coefficients of a derivative with respect to time.

    Parameters
    ----------
    control : ndarray, shape (degree + 1, durations, joints)
    duration : ndarray, shape (durations,), [s]
    """
    for _ in range(order):
        n = len(control) - 1
        if n == 0:
            return np.zeros_like(control)
        control = n * np.diff(control, axis=0) / duration[:, None]
    return control


def hermite(begin: Matrix, end: Matrix, duration: Vector) -> Array:
    """Return the coefficients of the polynomials with given values at both ends.

    Parameters
    ----------
    begin, end : ndarray, shape (orders, joints)
        Value, first derivative, second derivative, ... with respect to time.
    duration : ndarray, shape (durations,), [s]

    Returns
    -------
    ndarray, shape (orders of begin + orders of end, durations, joints)
    """
    n = len(begin) + len(end) - 1
    T = duration[:, None]

    def first(derivatives: Matrix, sign: float) -> Array:
        # The r-th difference of the first coefficients is p^(r) T^r (n - r)! / n!.
        differences = [
            (sign * T) ** r * value / perm(n, r) for r, value in enumerate(derivatives)
        ]
        return np.array(
            [
                sum(comb(i, r) * differences[r] for r in range(i + 1))
                for i in range(len(derivatives))
            ]
        )

    # From its end a polynomial runs backwards: odd derivatives change sign.
    return np.concatenate([first(begin, 1.0), first(end, -1.0)[::-1]])


def finer(control: Array) -> Array:
    """Return the coefficients over all 64 parts of the interval.

    Parameters
    ----------
    control : ndarray, shape (degree + 1, ...)

    Returns
    -------
    ndarray, shape (64 (degree + 1), ...)
    """
    return np.tensordot(_parts(len(control) - 1), control, axes=1)


@lru_cache(maxsize=16)
def _parts(degree: int) -> Matrix:
    """Return the map to coefficients over parts; exact, as all numbers are dyadic."""
    left = np.array(
        [[comb(i, j) / 2.0**i for j in range(degree + 1)] for i in range(degree + 1)]
    )
    right = left[::-1, ::-1]
    parts = [np.eye(degree + 1)]
    for _ in range(_HALVINGS):
        parts = [half @ part for part in parts for half in (left, right)]
    return np.concatenate(parts)
