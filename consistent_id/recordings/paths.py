"""What a joint path must offer so that it can be sampled, bounded and played."""

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Vector, freeze, number
from consistent_id.errors import ProblemError
from consistent_id.recordings.recording import Recording


class JointPath(Protocol):
    """Positions of joints as a smooth function of time, from `start` on.

    `FourierTrajectory` is one, a polynomial from rest to rest another.
    """

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""

    @property
    def start(self) -> float:
        """When it begins [s]."""

    @property
    def duration(self) -> float:
        """How long it lasts [s]."""

    def evaluate(self, time: ArrayLike, derivatives: int = 2) -> Array:
        """Return position and its derivatives, (derivatives + 1, samples, joints)."""

    def derivative_bound(self, order: int) -> Vector:
        """Return a number per joint that the derivative of this order never exceeds.

        In absolute value, at any time from start to end.  It may be a generous one.
        """


def freeze_path(path: JointPath, where: str) -> None:
    """Make what every path states plain values, or refuse it.

    Raises
    ------
    ProblemError
        If names of joints are not distinct, or there is no time from start to end.
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


def sampled(path: JointPath, rate: float, name: str = "trajectory") -> Recording:
    """Sample position, velocity and acceleration; both ends belong to it.

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
