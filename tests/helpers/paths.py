"""Paths of joints for tests."""

from dataclasses import dataclass, replace

import numpy as np

from consistent_id.recordings.joint_paths import FourierTrajectory, harmonics_of


def random_path(
    seed: int = 0,
    joints: int | tuple[str, ...] = 3,
    *,
    base=0.1,
    harmonics: int = 5,
    amplitude: float = 0.4,
    duration: float = 10.0,
    start: float = 0.0,
) -> FourierTrajectory:
    """A Fourier series of random coefficients."""
    rng = np.random.default_rng(seed)
    if isinstance(joints, int):
        joints = tuple(f"j{i}" for i in range(joints))
    frequencies = harmonics_of(base, harmonics)
    shape = (2, len(frequencies), len(joints))
    sine, cosine = amplitude * rng.normal(size=shape)
    offset = rng.normal(size=len(joints))
    return FourierTrajectory(
        joints, frequencies, offset, sine, cosine, duration, start=start
    )


def one_sine(joints: tuple[str, ...] = ("a",), **changes) -> FourierTrajectory:
    """All joints move as ``sin(2 pi t)``, for one second."""
    ones, zeros = np.ones((1, len(joints))), np.zeros((1, len(joints)))
    path = FourierTrajectory(joints, [1.0], zeros[0], ones, zeros, 1.0)
    return replace(path, **changes)


@dataclass(frozen=True)
class RestToRest:
    """``10 u^3 - 15 u^4 + 6 u^5`` of the way from 0 to 1, with `u` from 0 to 1."""

    joints: tuple[str, ...]
    start: float
    duration: float
    generous: float = 1.0

    def evaluate(self, time, derivatives=2):
        u = (np.asarray(time) - self.start) / self.duration
        way = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
        return np.stack(
            [
                np.tile(way.deriv(n)(u)[:, None] / self.duration**n, len(self.joints))
                for n in range(derivatives + 1)
            ]
        )

    def derivative_bound(self, order):
        way = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
        size = abs(way.deriv(order).coef).sum() / self.duration**order
        return np.full(len(self.joints), self.generous * size)
