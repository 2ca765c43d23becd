"""Joint motion as a Fourier series: one type, one convention, exact derivatives.

    q(t) = offset + sum_k  sine_k sin(w_k s) + cosine_k cos(w_k s),
    s = t - start,    w_k = 2 pi frequency_k

Coefficients are in units of position, whatever variables an optimiser prefers.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import reduce
from math import gcd, lcm
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    Array,
    Matrix,
    Vector,
    checked,
    freeze,
    freeze_arrays,
    frozen,
)
from consistent_id.errors import ProblemError
from consistent_id.recordings.paths import freeze_path, sampled
from consistent_id.recordings.recording import Recording

_COMMON = 1e-9  # relative difference below which frequencies share a base
_FINEST = 10_000  # largest denominator of a frequency in terms of the lowest


@dataclass(frozen=True, slots=True, eq=False)
class FourierTrajectory:
    """Joint paths that are sums of sines and cosines of the same frequencies.

    Parameters
    ----------
    joints : tuple of str
    frequencies : array_like, shape (terms,), [Hz]
        Positive and increasing: harmonics of one base frequency, or of several.
    offset : array_like, shape (joints,), [rad or m]
    sine, cosine : array_like, shape (terms, joints), [rad or m]
    duration : float, [s]
        How long it is played: one period, several, or none in full.
    start : float, [s]
        When it begins; all angles are zero then.

    Examples
    --------
    >>> path = FourierTrajectory(("elbow",), [0.5], [0.1], [[0.2]], [[0.0]], 2.0)
    >>> path.evaluate([0.5])[:, 0, 0].round(3).tolist()
    [0.3, 0.0, -1.974]
    >>> path.period
    2.0
    """

    joints: tuple[str, ...]
    frequencies: Vector
    offset: Vector
    sine: Matrix
    cosine: Matrix
    duration: float
    start: float = 0.0

    def __post_init__(self) -> None:
        freeze_path(self, "trajectory")
        n = len(self.joints)
        frequencies = frozen(self.frequencies, (None,), "trajectory: frequencies")
        if not (np.diff(frequencies, prepend=0.0) > 0.0).all():
            raise ProblemError(
                f"trajectory: frequencies are {frequencies.tolist()} Hz, expected "
                "positive and increasing ones"
            )
        freeze(self, frequencies=frequencies)
        shape = (len(frequencies), n)
        shapes = {"offset": (n,), "sine": shape, "cosine": shape}
        freeze_arrays(self, shapes, "trajectory")

    def __len__(self) -> int:
        """Return the number of frequencies."""
        return len(self.frequencies)

    @property
    def rates(self) -> Vector:
        """Angular frequencies [rad/s]."""
        return 2.0 * np.pi * self.frequencies

    @property
    def period(self) -> float | None:
        """Time after which it repeats [s], or None if its frequencies share no base."""
        if not len(self):
            return None
        lowest = float(self.frequencies[0])
        shares = [
            Fraction(float(f) / lowest).limit_denominator(_FINEST)
            for f in self.frequencies
        ]
        exact = np.array([float(share) for share in shares]) * lowest
        if (abs(exact - self.frequencies) > _COMMON * self.frequencies).any():
            return None
        below = lcm(*(share.denominator for share in shares))
        above = reduce(gcd, (int(share * below) for share in shares))
        return below / (above * lowest)

    def evaluate(self, time: ArrayLike, derivatives: int = 2) -> Array:
        """Return position and its derivatives at any times.

        Parameters
        ----------
        time : array_like, shape (samples,), [s]
        derivatives : int
            How many: with 2, position, velocity and acceleration; with 3, jerk too.

        Returns
        -------
        ndarray, shape (derivatives + 1, samples, joints)
        """
        s = checked(time, (None,), "time") - self.start
        values = sinusoids(s, self.rates, self.sine, self.cosine, derivatives)
        values[0] += self.offset
        return values

    def derivative_bound(self, order: int) -> Vector:
        """Return a bound of each joint's derivative over all time, ``sum_k w^n |c_k|``.

        In absolute value; of order 0, of the position.
        """
        size = np.hypot(self.sine, self.cosine)
        bound = self.rates**order @ size
        return bound + abs(self.offset) if order == 0 else bound

    def begun_later(self, by: float) -> Self:
        """Return the trajectory from so many seconds after its start, as long as it is.

        Of a periodic one, which lasts whole periods, it is the same motion in another
        phase.
        """
        sine, cosine = (trig(by * self.rates)[:, None] for trig in (np.sin, np.cos))
        return replace(
            self,
            sine=self.sine * cosine - self.cosine * sine,
            cosine=self.sine * sine + self.cosine * cosine,
        )

    def recording(self, rate: float, name: str = "trajectory") -> Recording:
        """Sample position, velocity and acceleration; both ends belong to it.

        Parameters
        ----------
        rate : float, [Hz]
            Lowered to the next that divides the duration into equal steps.
        name : str
        """
        return sampled(self, rate, name)

    def casadi(self) -> Any:
        """Return the trajectory as a CasADi function of time.

        Returns
        -------
        casadi.Function
            ``t -> (q, dq, ddq, dddq)``, each of shape (joints,), SX.
        """
        import casadi as ca

        t = ca.SX.sym("t")
        angles = ca.DM(self.rates) * (t - self.start)
        sines, cosines = ca.sin(angles).T, ca.cos(angles).T
        values = []
        a, b = self.sine, self.cosine
        for _ in range(4):
            values.append((sines @ ca.DM(a) + cosines @ ca.DM(b)).T)
            a, b = -self.rates[:, None] * b, self.rates[:, None] * a
        values[0] += ca.DM(self.offset)
        return ca.Function("trajectory", [t], values, ["t"], ["q", "dq", "ddq", "dddq"])

    def to_dict(self) -> dict[str, Any]:
        """Return the coefficients as plain values, for JSON."""
        return {
            "joints": list(self.joints),
            "frequencies_hz": self.frequencies.tolist(),
            "offset": self.offset.tolist(),
            "sine": self.sine.tolist(),
            "cosine": self.cosine.tolist(),
            "duration_s": self.duration,
            "start_s": self.start,
        }


def sinusoids(
    s: Vector, rates: Vector, sine: Matrix, cosine: Matrix, derivatives: int
) -> Array:
    """Return ``sum_k sine_k sin(w_k s) + cosine_k cos(w_k s)``, and its derivatives.

    Of shape (derivatives + 1, samples, columns).
    """
    angles = np.outer(s, rates)
    sines, cosines = np.sin(angles), np.cos(angles)
    values = np.empty((derivatives + 1, len(s), sine.shape[1]))
    a, b = sine, cosine
    for order in range(derivatives + 1):
        values[order] = sines @ a + cosines @ b
        # d/ds (a sin ws + b cos ws) = -w b sin ws + w a cos ws
        a, b = -rates[:, None] * b, rates[:, None] * a
    return values


def harmonics_of(base: ArrayLike, harmonics: int) -> Vector:
    """Return the harmonics of one or several base frequencies, each once [Hz].

    Examples
    --------
    >>> harmonics_of([0.1, 0.15], 3).round(3).tolist()
    [0.1, 0.15, 0.2, 0.3, 0.45]
    """
    bases = checked(np.atleast_1d(base), (None,), "base frequencies", finite=False)
    positive = np.isfinite(bases).all() and (bases > 0.0).all()
    if not len(bases) or not positive or harmonics < 1:
        raise ProblemError(
            f"base frequencies {bases.tolist()} Hz with {harmonics} harmonics, "
            "expected positive ones, and at least one of either"
        )
    every = np.sort(np.outer(np.arange(1, harmonics + 1), bases).ravel())
    distinct = np.diff(every, prepend=0.0) > _COMMON * every
    return np.asarray(every[distinct])
