"""Joint paths over time: the protocol, Fourier series, and sums of sinusoids.

There is one convention for Fourier series,

    q(t) = offset + sum_k  sine_k sin(w_k s) + cosine_k cos(w_k s),
    s = t - start,    w_k = 2 pi frequency_k

Coefficients are in units of position, for any variables of an optimiser.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import reduce
from math import gcd, lcm
from typing import Any, Protocol, Self, runtime_checkable

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
    number,
)
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.recordings.recording import Recording

_COMMON = 1e-9  # relative difference below which frequencies share a base
_FINEST = 10_000  # largest denominator of a frequency in terms of the lowest


@runtime_checkable
class JointPath(Protocol):
    """Positions of joints as a smooth function of time, from `start` on.

    `FourierTrajectory` is one, a polynomial from rest to rest another.
    """

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""

    @property
    def start(self) -> float:
        """Start time [s]."""

    @property
    def duration(self) -> float:
        """Duration [s]."""

    def evaluate(self, time: ArrayLike, derivatives: int = 2) -> Array:
        """Return position and its derivatives, (derivatives + 1, samples, joints)."""

    def derivative_bound(self, order: int) -> Vector:
        """Return a bound of each joint's derivative of this order.

        It is a bound of the absolute value at any time from start to end, not
        necessarily tight.
        """


@brief
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
        Time for which it is played: one period, several, or a part of one.
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
            Number of derivatives: 2 for velocity and acceleration, 3 for jerk, too.

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

        It bounds the absolute value; order 0 is the position.
        """
        size = np.hypot(self.sine, self.cosine)
        bound = self.rates**order @ size
        return bound + abs(self.offset) if order == 0 else bound

    def begun_later(self, by: float) -> Self:
        """Return the trajectory that begins some seconds later, with the same duration.

        For a periodic one that lasts whole periods, it is the same motion in another
        phase.
        """
        sine, cosine = (trig(by * self.rates)[:, None] for trig in (np.sin, np.cos))
        return replace(
            self,
            sine=self.sine * cosine - self.cosine * sine,
            cosine=self.sine * sine + self.cosine * cosine,
        )

    def recording(self, rate: float, name: str = "trajectory") -> Recording:
        """Sample position, velocity and acceleration, including both ends.

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


def sinusoids(
    s: Vector, rates: Vector, sine: Matrix, cosine: Matrix, derivatives: int
) -> Array:
    """Return ``sum_k sine_k sin(w_k s) + cosine_k cos(w_k s)``, and its derivatives.

    The shape is (derivatives + 1, samples, columns).
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


@dataclass(frozen=True, slots=True)
class Sinusoid:
    """``(start + (end - start) t / T) sin(2 pi frequency t + phase)``.

    Parameters
    ----------
    start, end : float, [rad or m]
        Amplitude at the beginning and the end of a motion of duration ``T``.
    frequency : float, [Hz]
    phase : float, [rad]
    """

    start: float
    end: float
    frequency: float
    phase: float = 0.0

    def evaluate(self, t: Vector, duration: float) -> Array:
        """Return position, velocity and acceleration, shape (3, samples)."""
        rate = 2.0 * np.pi * self.frequency
        slope = (self.end - self.start) / duration
        amplitude = self.start + slope * t
        angle = rate * t + self.phase
        s, c = np.sin(angle), np.cos(angle)
        return np.array(
            [
                amplitude * s,
                slope * s + amplitude * rate * c,
                2.0 * slope * rate * c - amplitude * rate**2 * s,
            ]
        )


@dataclass(frozen=True, slots=True)
class SinusoidalMotion:
    """A motion whose joints follow sums of sinusoids.

    Parameters
    ----------
    duration : float, [s]
    rate : float, [Hz]
        Sampling rate; both ends are sampled.
    joints : tuple of tuple of Sinusoid
        Terms of each joint, in the robot's order.

    Examples
    --------
    >>> motion = SinusoidalMotion(1.0, 100.0, ((Sinusoid(0.5, 0.5, 1.0),),))
    >>> motion.recording(("elbow",)).position[25].item()
    0.5
    """

    duration: float
    rate: float
    joints: tuple[tuple[Sinusoid, ...], ...]

    def __post_init__(self) -> None:
        for name in ("duration", "rate"):
            value = getattr(self, name)
            if not 0.0 < value < np.inf:
                raise ProblemError(f"motion: {name} is {value}, expected more than 0")

    def recording(self, joints: Sequence[str], name: str = "motion") -> Recording:
        """Sample position, velocity and acceleration for the named joints."""
        if len(joints) != len(self.joints):
            raise ProblemError(
                f"{name}: sinusoids for {len(self.joints)} joints, but the robot has "
                f"{len(joints)}"
            )
        t = np.arange(round(self.duration * self.rate) + 1) / self.rate
        values = np.zeros((3, len(t), len(joints)))
        for j, terms in enumerate(self.joints):
            for term in terms:
                values[:, :, j] += term.evaluate(t, self.duration)
        q, dq, ddq = values
        return Recording(tuple(joints), t, q, dq, ddq, name=name)


def sampled(path: JointPath, rate: float, name: str = "trajectory") -> Recording:
    """Sample position, velocity and acceleration, including both ends.

    Parameters
    ----------
    rate : float, [Hz]
        Lowered to the next that divides the duration into equal steps.
    """
    if not 0.0 < number(rate, "rate") < np.inf:
        raise ProblemError(f"rate is {rate} Hz, expected more than 0")
    steps = max(1, int(np.floor(path.duration * rate * (1.0 + 1e-12))))
    time = path.start + path.duration * np.arange(steps + 1) / steps
    q, dq, ddq = path.evaluate(time)
    return Recording(path.joints, time, q, dq, ddq, name=name)


def freeze_path(path: JointPath, where: str) -> None:
    """Convert the common fields of paths to plain values, or refuse them.

    Raises
    ------
    ProblemError
        If names of joints are not distinct, or the duration is not positive.
    """
    joints = tuple(path.joints)
    if not joints or len(set(joints)) != len(joints):
        raise ProblemError(f"{where}: joints are {joints!r}, expected distinct names")
    duration = number(path.duration, f"{where}: duration")
    if not 0.0 < duration < np.inf:
        raise ProblemError(f"{where}: duration is {duration} s, expected more than 0")
    start = number(path.start, f"{where}: start")
    if not abs(start) < np.inf:
        raise ProblemError(f"{where}: start is {start} s")
    freeze(path, joints=joints, duration=duration, start=start)
