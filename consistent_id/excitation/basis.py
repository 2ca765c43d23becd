"""Fourier paths, and their limits, as linear functions of an optimiser's variables.

Variables are coefficients of the velocity, relative to a typical speed of each joint,
in a null space, so that every choice of variables rests exactly at both ends.

Limits of position, velocity, acceleration and jerk are linear rows.  A real
trigonometric polynomial of degree ``H`` that stays within 1 at ``N > 2 H`` equidistant
points of its period stays within ``1 / cos(pi H / N)`` everywhere [EhlichZeller1964]_.
A programme has rows at few points, since each costs time; the resulting path is then
measured at many points, and scaled down by its excess.

Paths that do not repeat while they are played are bounded by Taylor's formula instead:
at an extreme the slope is zero, so the nearest of samples ``h`` apart differs from it
by at most ``h^2 / 8 max |f''|``.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, freeze, frozen
from consistent_id._support.singular import svd
from consistent_id.errors import ProblemError
from consistent_id.motion.limits import MotionLimits
from consistent_id.recordings.joint_paths import FourierTrajectory

_RANK = 1e-9  # share of the largest singular value below which one is zero
_DEPENDENT = 1e-6  # length below which a column depends on those before it

_COARSE = 12  # points per period of the highest frequency, for the programme
_FINE = 32  # for measuring: the bound is then within 0.5 % of the extreme
_FINER = 64  # the same for paths that do not repeat
_LONGEST = 20_000  # points


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class FourierBasis:
    """All Fourier paths of given frequencies and duration.

    Parameters
    ----------
    limits : MotionLimits
        Limits of the named joints; they determine the scales of the variables.
    frequencies : array_like, shape (terms,), [Hz]
    duration : float, [s]
        Of one repetition.
    rest : bool
        Whether velocity and acceleration are zero at both ends.
    smooth : bool
        Whether jerk is zero there, too.
    repeats : int
        How often a path repeats: limits and samples of one repetition are those of all.

    Attributes
    ----------
    free : ndarray, shape (2 terms, free)
        Allowed directions of velocity coefficients (sines, then cosines).
    unit : ndarray, shape (joints,), [rad/s or m/s]
        Velocity of a variable equal to one.

    Notes
    -----
    Variables have the shape (1 + free, joints): an offset relative to half the range,
    then the others.
    """

    limits: MotionLimits
    frequencies: Vector
    duration: float
    rest: bool
    smooth: bool = False
    repeats: int = 1
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
                "a path of one frequency cannot rest at both ends, expected two or "
                "more; give more harmonics, or rest = false"
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
        """Return the path of some variables, with all its repetitions."""
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
            self.repeats * self.duration,
        )

    def pull(self, order: int, columns: Matrix, slopes: Matrix) -> Matrix:
        """Return the gradient with respect to the variables.

        Parameters
        ----------
        columns : ndarray, shape (samples, size - 1)
            Columns of this order.
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
        """Speed with which a random path of unit variables nearly reaches a limit."""
        time = np.linspace(0.0, self.duration, 64)
        reach = np.full(len(self.limits.joints), np.inf)
        for order in range(4):
            typical = np.sqrt((self.columns(order, time) ** 2).sum(axis=1).max())
            reach = np.minimum(reach, self.limits.derivative(order) / typical)
        return reach


@dataclass(frozen=True, slots=True, eq=False)
class LimitRows:
    """Limits of Fourier paths, in relative form: ``|value / limit| <= 1``.

    Parameters
    ----------
    matrix : scipy.sparse.csr_array, shape (rows, variables)
        Rows at few points, on the flattened variables: ``-1 <= A x <= 1``.
    time : ndarray, shape (samples,), [s]
        At many points.
    excess : float
        Factor by which a path may exceed its values at these points in between.
    step : float, [s]
        Between them, for paths that do not repeat while they are played; else 0.
    """

    basis: FourierBasis
    matrix: Any
    time: Vector
    excess: float
    step: float

    def largest(self, variables: Matrix) -> Vector:
        """Return the largest share of a limit that each joint uses at any time."""
        motion = self.basis.motion(variables, self.time, derivatives=3)
        motion[0] -= self.basis.limits.middle
        extremes = abs(motion).max(axis=1)
        if self.step:
            path = self.basis.trajectory(variables)
            bend = np.array([path.derivative_bound(order + 2) for order in range(4)])
            extremes += self.step**2 / 8.0 * bend
        limits = np.array([self.basis.limits.derivative(order) for order in range(4)])
        return np.asarray((extremes / limits).max(axis=0) * self.excess)

    @property
    def fine(self) -> Any:
        """Rows like `matrix`, at the many points, including the excess in between."""
        return self.excess * _matrix(self.basis, self.time)

    def within(self, variables: Matrix) -> Matrix:
        """Return the path, scaled down for joints that exceed a limit."""
        return np.asarray(variables / np.maximum(1.0, self.largest(variables)))


def limit_rows(basis: FourierBasis, period: float | None) -> LimitRows:
    """Return the rows of all finite limits.

    Parameters
    ----------
    period : float, optional, [s]
        After which its paths repeat; None if they do not.
    """
    repeats = period is not None and period <= basis.duration * (1.0 + 1e-9)
    if period is None or not repeats:
        fine = _interval(basis, _FINER)
        step = float(fine[1] - fine[0])
        return LimitRows(
            basis, _matrix(basis, _interval(basis, _COARSE)), fine, 1.0, step
        )
    coarse, fine = (_cycle(basis, period, density) for density in (_COARSE, _FINE))
    degree = round(basis.frequencies[-1] * period)
    excess = between_samples(degree, len(fine))
    return LimitRows(basis, _matrix(basis, coarse), fine, excess, 0.0)


def between_samples(degree: int, samples: int) -> float:
    """Return the factor by which a trigonometric polynomial can exceed its samples.

    ``max |T| <= max_samples |T| / cos(pi H / N)`` for degree ``H`` and any ``N > 2 H``
    equidistant samples of its period.  A cosine reaches it where ``2 H`` divides ``N``.

    Parameters
    ----------
    degree : int
        Period times highest frequency.
    samples : int
        Over one period, its end not counted.

    Raises
    ------
    ProblemError
        With two samples per cycle or fewer, for which there is no bound.

    References
    ----------
    [EhlichZeller1964]_, for algebraic polynomials, which correspond to even
    trigonometric ones; ``docs/limits-for-all-time.md`` has the proof.

    Examples
    --------
    >>> round(between_samples(5, 60), 4)
    1.0353
    """
    if degree < 0 or not samples > 2 * degree:
        raise ProblemError(
            f"{samples} samples of a trigonometric polynomial of degree {degree}, "
            f"expected more than {2 * degree}; take more samples"
        )
    return float(1.0 / np.cos(np.pi * degree / samples))


def null_space(rows: Matrix) -> Matrix:
    """Return an orthonormal basis of the rows' null space, as columns.

    The right singular vectors of a null space are not unique: they differ between
    processors and versions of LAPACK, and random paths would differ with them. The
    projector onto it is unique, and so are its columns after successive
    orthonormalisation.
    """
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    _, s, Vt = svd(rows / np.where(size > 0.0, size, 1.0))
    seen = Vt[: int((s > _RANK * s[0]).sum())]
    basis = np.zeros((rows.shape[1], 0))
    for column in (np.eye(len(basis)) - seen.T @ seen).T:
        left = column - basis @ (basis.T @ column)
        length = np.linalg.norm(left)
        if length > _DEPENDENT:
            left -= basis @ (basis.T @ left)  # twice is enough for rounding
            basis = np.column_stack([basis, left / np.linalg.norm(left)])
    return basis


def _matrix(basis: FourierBasis, time: Vector) -> Any:
    from scipy import sparse

    joints = len(basis.unit)
    blocks = []
    for order in range(4):
        limits = basis.limits.derivative(order)
        columns = basis.columns(order, time)
        for j in np.flatnonzero(np.isfinite(limits)):
            row: Array = np.zeros((len(time), basis.size))
            row[:, 1:] = columns * (basis.unit[j] / limits[j])
            row[:, 0] = float(order == 0)
            place = sparse.csr_array(([1.0], ([0], [j])), shape=(1, joints))
            blocks.append(sparse.kron(row, place, format="csr"))
    return sparse.vstack(blocks, format="csr")


def _cycle(basis: FourierBasis, period: float, density: int) -> Vector:
    """Return times of one period, its end left out."""
    degree = max(1, round(basis.frequencies[-1] * period))
    count = max(min(density * degree, _LONGEST), 2 * degree + 1)
    return np.asarray(np.arange(count) * period / count)


def _interval(basis: FourierBasis, density: int) -> Vector:
    """Return times from start to end."""
    cycles = basis.frequencies[-1] * basis.duration
    count = min(max(2, int(np.ceil(density * cycles)) + 1), _LONGEST)
    return np.linspace(0.0, basis.duration, count)
