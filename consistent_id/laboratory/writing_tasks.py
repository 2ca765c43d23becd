"""Writing tasks: a curve in space, and when the robot is where on it.

``x(t) = c(u(t))``, so ``v = c' du`` and ``a = c'' du^2 + c' ddu``; the law ``u(t)``
goes from 0 to 1, at rest at both ends.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    Array,
    Matrix,
    Vector,
    array_default,
    checked,
    freeze,
    frozen,
)
from consistent_id.errors import ProblemError
from consistent_id.laboratory.curves import Curve, arc_length
from consistent_id.robot.places import turns

TimeLaw = Literal["quintic", "septic", "cycloidal"]

# Coefficients of s^0, s^1, ...: velocity and acceleration are zero at both ends, and of
# the septic law the jerk, too.
_POLYNOMIALS = {
    "quintic": (0.0, 0.0, 0.0, 10.0, -15.0, 6.0),
    "septic": (0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0),
}
_ORTHONORMAL = 1e-9


def time_law(law: TimeLaw, s: ArrayLike, derivatives: int = 2) -> Array:
    """Return a motion from 0 to 1 and its derivatives by ``s``, itself from 0 to 1.

    Parameters
    ----------
    law : {"quintic", "septic", "cycloidal"}
        ``10 s^3 - 15 s^4 + 6 s^5``; ``35 s^4 - 84 s^5 + 70 s^6 - 20 s^7``, whose jerk
        is zero at the ends, too; ``s - sin(2 pi s) / (2 pi)``.
    s : array_like, shape (samples,)
        Before 0 and after 1 it stands still.

    Returns
    -------
    ndarray, shape (derivatives + 1, samples)

    Examples
    --------
    >>> time_law("quintic", [0.0, 0.5, 1.0]).tolist()
    [[0.0, 0.5, 1.0], [0.0, 1.875, 0.0], [0.0, 0.0, 0.0]]
    """
    if law not in get_args(TimeLaw):
        known = ", ".join(get_args(TimeLaw))
        raise ProblemError(f"time law is {law!r}, expected one of {known}")
    s = checked(s, (None,), "s")
    moving = (s > 0.0) & (s < 1.0)
    inside = np.clip(s, 0.0, 1.0)
    values = np.empty((derivatives + 1, len(s)))
    for order in range(derivatives + 1):
        values[order] = _law(law, inside, order)
        if order:
            values[order] = np.where(moving, values[order], 0.0)
    return values


def _law(law: TimeLaw, s: Vector, order: int) -> Vector:
    if law in _POLYNOMIALS:
        polynomial = np.polynomial.Polynomial(_POLYNOMIALS[law])
        return np.asarray(polynomial.deriv(order)(s) if order else polynomial(s))
    w = 2.0 * np.pi
    # The n-th derivative of sin(ws) is w^n sin(ws + n pi / 2).
    wave = w ** (order - 1) * np.sin(w * s + order * np.pi / 2.0)
    straight = (s, np.ones_like(s))[order] if order < 2 else 0.0
    return np.asarray(straight - wave)


@dataclass(frozen=True, slots=True, eq=False)
class Orientation:
    """How a tool is held while it writes: still, or turning about one axis.

    ``R(u) = exp(angle u [axis]) start``, so ``w = axis angle du``.

    Parameters
    ----------
    start : array_like, shape (3, 3)
        Rotation of the frame in the base, where the curve begins.
    axis : array_like, shape (3,)
        In the base; made a unit vector.
    angle : float, [rad]
        By which it has turned where the curve ends.
    """

    start: Matrix
    axis: Vector = array_default((0.0, 0.0, 1.0))
    angle: float = 0.0

    def __post_init__(self) -> None:
        start = frozen(self.start, (3, 3), "orientation: start")
        off = abs(start.T @ start - np.eye(3)).max()
        if off > _ORTHONORMAL or np.linalg.det(start) < 0.0:
            raise ProblemError(
                f"orientation: start is no rotation (R^T R is off by {off:.2g}, "
                f"determinant {np.linalg.det(start):.3g})"
            )
        axis = frozen(self.axis, (3,), "orientation: axis")
        length = float(np.linalg.norm(axis))
        if length == 0.0:
            raise ProblemError("orientation: axis is zero, expected a direction")
        freeze(self, start=start, axis=frozen(axis / length, (3,), "axis"))

    def at(self, u: Vector) -> Array:
        """Return rotations at `u`, shape (samples, 3, 3)."""
        return np.asarray(turns(self.axis, self.angle * u) @ self.start)


@dataclass(frozen=True, slots=True, eq=False)
class WritingTask:
    """A curve written from rest to rest.

    Parameters
    ----------
    curve : Curve
    duration : float, [s]
    law : {"quintic", "septic", "cycloidal"}
        See `time_law`.
    orientation : Orientation, optional
        Without it, the frame may turn as it likes.
    start : float, [s]
        When it begins to move.

    Examples
    --------
    >>> from consistent_id.laboratory.curves import circle
    >>> task = WritingTask(circle(0.1, centre=[0.4, 0, 0.3]), duration=2.0)
    >>> round(task.length, 6)
    0.628319
    >>> task.evaluate([1.0])[1].round(6).tolist()  # half round, at its fastest
    [[-0.0, -0.589049, 0.0]]
    """

    curve: Curve
    duration: float
    law: TimeLaw = "quintic"
    orientation: Orientation | None = None
    start: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.duration < np.inf:
            raise ProblemError(
                f"writing task: duration is {self.duration} s, expected more than 0"
            )
        if not abs(self.start) < np.inf:
            raise ProblemError(f"writing task: start is {self.start} s")
        time_law(self.law, [0.0])

    @property
    def length(self) -> float:
        """Length of the whole curve [m]."""
        return float(arc_length(self.curve, [1.0])[0])

    def progress(self, time: ArrayLike) -> Array:
        """Return ``u``, ``du/dt`` and ``d2u/dt2``, shape (3, samples)."""
        time = checked(time, (None,), "time")
        values = time_law(self.law, (time - self.start) / self.duration)
        return values / self.duration ** np.arange(3.0)[:, None]

    def evaluate(self, time: ArrayLike) -> Array:
        """Return position, velocity and acceleration, shape (3, samples, 3)."""
        u, du, ddu = self.progress(time)
        c, dc, ddc = self.curve.evaluate(u)
        v = dc * du[:, None]
        return np.array([c, v, ddc * du[:, None] ** 2 + dc * ddu[:, None]])

    def time_at(self, u: float) -> float:
        """Return when the curve's parameter is `u`, [s]."""
        from scipy.optimize import brentq

        if not 0.0 < u < 1.0:
            return self.start + self.duration * (u >= 1.0)
        share = brentq(lambda s: float(time_law(self.law, [s], 0)[0, 0]) - u, 0.0, 1.0)
        return self.start + self.duration * float(share)
