"""A joint path that is one polynomial of time, with proven bounds."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Matrix, Vector, checked, freeze, frozen
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.motion import bernstein
from consistent_id.recordings.joint_paths import freeze_path


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
        return np.array([bernstein.values(self._derivative(k), u) for k in orders])

    def derivative_bound(self, order: int) -> Vector:
        """Return a bound of each joint's derivative from start to end.

        In absolute value; at most a few thousandths above the largest value.
        """
        return np.asarray(abs(bernstein.finer(self._derivative(order))).max(axis=0))

    def _derivative(self, order: int) -> Matrix:
        duration = np.array([self.duration])
        return bernstein.derivative(self.control[:, None], duration, order)[:, 0]
