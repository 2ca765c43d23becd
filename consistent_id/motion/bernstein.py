"""Polynomials by their Bernstein coefficients, and joint paths that are polynomials.

    p(u) = sum_i  binomial(n, i) u^i (1 - u)^(n - i) c_i,    0 <= u <= 1

is a weighted mean of the coefficients [Farouki2012]_, so its values lie between them: a
polynomial is proven to stay within a limit when they do.  Halving the interval again
and again brings them near.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import comb, perm

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Matrix, Vector, checked, freeze, frozen
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.recordings.joint_paths import freeze_path

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


@brief
@dataclass(frozen=True, slots=True, eq=False)
class PolynomialPath:
    """Joint paths that are polynomials of time, by their Bernstein coefficients.

    Parameters
    ----------
    joints : tuple of str
    control : array_like, shape (degree + 1, joints), [rad or m]
        Bernstein coefficients of the position over the whole duration; the first and
        the last are its positions at both ends.
    duration : float, [s]
    start : float, [s]

    Examples
    --------
    >>> path = PolynomialPath(("elbow",), [[0.0], [0.0], [1.0], [1.0]], duration=2.0)
    >>> path.evaluate([0.0, 1.0, 2.0], derivatives=1)[:, :, 0].tolist()
    [[0.0, 0.5, 1.0], [0.0, 0.75, 0.0]]
    """

    joints: tuple[str, ...]
    control: Matrix
    duration: float
    start: float = 0.0

    def __post_init__(self) -> None:
        freeze_path(self, "polynomial path")
        shape = (None, len(self.joints))
        control = frozen(self.control, shape, "polynomial path: control")
        if not 1 <= len(control) <= 10:
            raise ProblemError(
                f"polynomial path: {len(control)} coefficients, expected 1 to 10"
            )
        freeze(self, control=control)

    def evaluate(self, time: ArrayLike, derivatives: int = 2) -> Array:
        """Return position and derivatives, shape (derivatives + 1, samples, joints).

        Before the start and after the end, those at the start and at the end.

        Parameters
        ----------
        time : array_like, shape (samples,), [s]
        derivatives : int
            Highest one.
        """
        s = checked(time, (None,), "time") - self.start
        u = np.clip(s / self.duration, 0.0, 1.0)
        orders = range(derivatives + 1)
        return np.array([values(self._derivative(k), u) for k in orders])

    def derivative_bound(self, order: int) -> Vector:
        """Return a bound of each joint's derivative from start to end.

        In absolute value; at most a few thousandths above the largest value.
        """
        return np.asarray(abs(finer(self._derivative(order))).max(axis=0))

    def _derivative(self, order: int) -> Matrix:
        duration = np.array([self.duration])
        return derivative(self.control[:, None], duration, order)[:, 0]
