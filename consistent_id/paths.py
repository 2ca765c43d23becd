"""What a joint path must offer so that it can be sampled, bounded and played."""

from typing import Protocol

from numpy.typing import ArrayLike

from consistent_id._arrays import Array, Vector


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
