"""Motions given by formulas, with exact derivatives."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.errors import ProblemError
from consistent_id.recordings.recording import Recording


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
