"""Fourier paths as a linear function of an optimiser's variables.

Variables are coefficients of the velocity, in shares of a typical speed of each joint;
a null space takes care of rest at both ends, so that every choice of variables rests
there exactly.
"""

from dataclasses import dataclass, field

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, freeze, frozen
from consistent_id.errors import ProblemError
from consistent_id.motion.limits import MotionLimits
from consistent_id.recordings.trajectory import FourierTrajectory

_RANK = 1e-9  # share of the largest singular value below which one is zero
_DEPENDENT = 1e-6  # length below which a column adds nothing to those before it


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class FourierBasis:
    """All Fourier paths of given frequencies and duration.

    Parameters
    ----------
    limits : MotionLimits
        Names the joints; sets the sizes of the variables.
    frequencies : array_like, shape (terms,), [Hz]
    duration : float, [s]
    rest : bool
        Whether velocity and acceleration are zero at both ends.
    smooth : bool
        Whether jerk is zero there, too.

    Attributes
    ----------
    free : ndarray, shape (2 terms, free)
        Directions of velocity coefficients (sines, then cosines) that are allowed.
    unit : ndarray, shape (joints,), [rad/s or m/s]
        Velocity that a variable of one stands for.

    Notes
    -----
    Variables have the shape (1 + free, joints): an offset in shares of half the range,
    then the rest.
    """

    limits: MotionLimits
    frequencies: Vector
    duration: float
    rest: bool
    smooth: bool = False
    free: Matrix = field(init=False)
    unit: Vector = field(init=False)

    def __post_init__(self) -> None:
        frequencies = frozen(self.frequencies, (None,), "frequencies")
        freeze(self, frequencies=frequencies)
        terms = 2 * len(frequencies)
        free = np.eye(terms)
        if self.rest:
            ends = np.array([0.0, self.duration])
            orders = (1, 2, 3) if self.smooth else (1, 2)
            at_ends = np.vstack([self._coefficients(order, ends) for order in orders])
            free = null_space(at_ends)
        if not free.size:
            raise ProblemError(
                f"{len(frequencies)} frequencies leave no motion that rests at both "
                "ends; give more harmonics"
            )
        freeze(self, free=frozen(free, free.shape, "free"))
        freeze(self, unit=frozen(self._units(), (None,), "unit"))

    @property
    def size(self) -> int:
        """Number of variables of each joint."""
        return 1 + int(self.free.shape[1])

    def columns(self, order: int, time: Vector) -> Matrix:
        """Return the derivative per unit of velocity, shape (samples, size - 1)."""
        return self._coefficients(order, time) @ self.free

    def motion(self, variables: Matrix, time: Vector, derivatives: int = 2) -> Array:
        """Return the path's derivatives, (derivatives + 1, samples, joints)."""
        values = np.array(
            [self.columns(order, time) for order in range(derivatives + 1)]
        )
        motion = values @ (variables[1:] * self.unit)
        motion[0] += self.offset(variables)
        return motion

    def trajectory(self, variables: Matrix) -> FourierTrajectory:
        """Return the path of some variables."""
        rates = 2.0 * np.pi * self.frequencies[:, None]
        velocity = self.free @ (variables[1:] * self.unit)
        terms = len(self.frequencies)
        # v = a cos + b sin has the integral (a sin - b cos) / w.
        return FourierTrajectory(
            self.limits.joints,
            self.frequencies,
            self.offset(variables),
            velocity[terms:] / rates,
            -velocity[:terms] / rates,
            self.duration,
        )

    def pull(self, order: int, columns: Matrix, slopes: Matrix) -> Matrix:
        """Return the gradient with respect to the variables.

        Parameters
        ----------
        columns : ndarray, shape (samples, size - 1)
            Of this order.
        slopes : ndarray, shape (samples, joints)
            Derivatives with respect to the motion of this order.
        """
        gradient = np.zeros((self.size, len(self.unit)))
        gradient[1:] = (columns.T @ slopes) * self.unit
        if order == 0:
            gradient[0] = slopes.sum(axis=0) * self.limits.derivative(0)
        return gradient

    def offset(self, variables: Matrix) -> Vector:
        """Return the joints' offsets, [rad or m]."""
        return np.asarray(self.limits.middle + variables[0] * self.limits.derivative(0))

    def _coefficients(self, order: int, time: Vector) -> Matrix:
        """Return the derivative per unit coefficient of velocity sines and cosines."""
        rates = 2.0 * np.pi * self.frequencies
        angles = np.outer(time, rates)
        # The n-th derivative of -cos(x)/w and sin(x)/w, where x = w t.
        quarter = order * np.pi / 2.0
        size = rates ** (order - 1)
        return np.hstack(
            [-size * np.cos(angles + quarter), size * np.sin(angles + quarter)]
        )

    def _units(self) -> Vector:
        """Speed at which a random path of unit variables about reaches a limit."""
        time = np.linspace(0.0, self.duration, 64)
        reach = np.full(len(self.limits.joints), np.inf)
        for order in range(4):
            typical = np.sqrt((self.columns(order, time) ** 2).sum(axis=1).max())
            reach = np.minimum(reach, self.limits.derivative(order) / typical)
        return reach


def null_space(rows: Matrix) -> Matrix:
    """Return an orthonormal basis of what rows map to zero, as columns.

    The right singular vectors of a null space are not unique: they differ between
    processors and versions of LAPACK, and random paths would with them.  The projector
    onto it is unique, and so are its columns made orthonormal one after another.
    """
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    _, s, Vt = np.linalg.svd(rows / np.where(size > 0.0, size, 1.0))
    seen = Vt[: int((s > _RANK * s[0]).sum())]
    basis = np.zeros((rows.shape[1], 0))
    for column in (np.eye(len(basis)) - seen.T @ seen).T:
        left = column - basis @ (basis.T @ column)
        length = np.linalg.norm(left)
        if length > _DEPENDENT:
            left -= basis @ (basis.T @ left)  # twice is enough for rounding
            basis = np.column_stack([basis, left / np.linalg.norm(left)])
    return basis
