"""Free variables behind the parameters of a torque model: bodies by log-Cholesky.

In typical units, link ``k`` has the pseudo-inertia ``J(theta_k) + margin 1`` with
``theta_k`` of `log_cholesky`; drive parameters are variables themselves.  Masses,
centres of mass and drive parameters that are fixed are left out; the others may have
bounds.

Constraints eliminate variables or bound the others.  Their rows are read, not their
kinds: rows of the form ``low <= x_i <= high`` on a mass or drive parameter, or
``h = c m``, are supported; all others are refused.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, BoolArray, Matrix, Vector
from consistent_id.constraints import Constraint, PhysicalConsistency
from consistent_id.errors import InfeasibleError, ProblemError
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.inertia import inertial_vector, pseudo_inertia
from consistent_id.robot.log_cholesky import (
    _COLUMNS,
    _ROWS,
    COM,
    DIAGONAL,
    MASS,
    body_from_log_cholesky,
    log_cholesky_from_body,
    log_cholesky_jacobian,
)

# Z, shape (9,), with <Z, Sigma> = sum_i g_i x_i for bodies of which only Sigma moves.
_DUAL_BASIS = inertial_vector(
    [np.pad((E + E.T) / 2, (0, 1)) for E in np.eye(9).reshape(9, 3, 3)]
).T

_BALL = inertial_vector(np.eye(4))  # the body whose pseudo-inertia is one
_THICKNESS = 0.03  # least thickness of a body to start from, in typical lengths
_EQUAL = 1e-9  # difference of two typical parameters that counts as rounding


@dataclass(frozen=True, slots=True, eq=False)
class BodyVariables:
    """Parameters in typical units, ``u``, as a function of free variables ``v``.

    Parameters
    ----------
    margin : float
        Of `PhysicalConsistency`.
    known : ndarray, shape (parameters,)
        Values in ``u`` of fixed masses and drive parameters; elsewhere nan.
    centres : ndarray, shape (links, 3)
        Centres of mass that are fixed, in typical lengths; elsewhere nan.
    lower, upper : ndarray, shape (free,)
        Bounds of the free variables; infinite where there is none.
    free : ndarray of bool, shape (parameters,)
        Which of all variables are free.
    """

    links: int
    margin: float
    known: Vector
    centres: Array
    lower: Vector
    upper: Vector
    free: BoolArray

    def parameters(self, v: Vector) -> Vector:
        """Return ``u`` at ``v``, both dimensionless."""
        theta, drive = self._all(v)
        bodies = body_from_log_cholesky(theta) + self.margin * _BALL
        return np.concatenate([bodies.ravel(), drive])

    def jacobian(self, v: Vector) -> Matrix:
        """Return ``du/dv``, shape (parameters, free), exactly."""
        theta, _ = self._all(v)
        blocks = log_cholesky_jacobian(theta) @ self._inner(theta)
        return self._assembled(blocks, np.ones(len(self.known)))[:, self.free]

    def curvature(self, v: Vector, gradient: Vector) -> Matrix:
        """Return ``sum_i g_i d2u_i / dv dv``, shape (free, free), exactly.

        `gradient`, shape (parameters,), are the derivatives ``g`` of a function by `u`.
        """
        theta, _ = self._all(v)
        g = gradient[: 10 * self.links].reshape(-1, 10)
        inner = self._inner(theta)
        blocks = np.swapaxes(inner, 1, 2) @ log_cholesky_curvature(theta, g) @ inner
        by_centre = np.einsum("ki,kij->kj", g, log_cholesky_jacobian(theta))[:, COM]
        blocks[:, MASS, MASS] -= np.sum(by_centre * inner[:, COM, MASS], axis=1)
        whole = self._assembled(blocks, np.zeros(len(self.known)))
        return whole[np.ix_(self.free, self.free)]

    def variables(self, u: Vector) -> Vector:
        """Return ``v`` for the parameters nearby that have mass, thickness and bounds.

        Bodies thinner than 0.03 typical lengths are thickened: a search from a flat
        body does not leave it.
        """
        n = 10 * self.links
        theta = [
            log_cholesky_from_body(_thickened(body - self.margin * _BALL))
            for body in u[:n].reshape(-1, 10)
        ]
        everything = np.concatenate([np.ravel(theta), u[n:]])
        return np.asarray(np.clip(everything[self.free], self.lower, self.upper))

    def _all(self, v: Vector) -> tuple[Array, Vector]:
        """Return variables of all links, shape (links, 10), and drive parameters."""
        n = 10 * self.links
        everything = self.known.copy()
        everything[self.free] = v
        theta = everything[:n].reshape(-1, 10)
        masses = self.known[:n:10]
        fixed = ~np.isnan(masses)
        theta[fixed, MASS] = np.log(masses[fixed] - self.margin)
        # A fixed centre is that of the body with its margin; without it, it is farther.
        grown = self.centres * (1.0 + self.margin * np.exp(-theta[:, MASS, None]))
        theta[:, COM] = np.where(np.isnan(self.centres), theta[:, COM], grown)
        return theta, everything[n:]

    def _inner(self, theta: Array) -> Array:
        """Return how variables depend on each other: fixed centres on the mass."""
        inner = np.tile(np.eye(10), (self.links, 1, 1))
        inner[:, COM, MASS] = np.nan_to_num(
            -self.margin * np.exp(-theta[:, MASS, None]) * self.centres
        )
        return inner

    def _assembled(self, blocks: Array, drive: Vector) -> Matrix:
        """Return a square matrix of the links' blocks, then a diagonal."""
        whole = np.diag(drive)
        for k, block in enumerate(blocks):
            whole[10 * k : 10 * k + 10, 10 * k : 10 * k + 10] = block
        return whole


def _thickened(body: Vector) -> Vector:
    """Raise mass and central second moments to values with a finite logarithm."""
    J = pseudo_inertia(body)
    mass = max(J[3, 3], _THICKNESS**2)
    c = J[:3, 3] / mass
    moments, axes = np.linalg.eigh(J[:3, :3] / mass - np.outer(c, c))
    sigma = axes @ np.diag(np.maximum(moments, _THICKNESS**2)) @ axes.T
    J[:3, :3] = mass * (sigma + np.outer(c, c))
    J[3, 3] = mass
    return np.asarray(inertial_vector(J))


def body_variables(
    model: TorqueModel, constraints: Sequence[Constraint], unit: Vector
) -> BodyVariables:
    """Return the variables that constraints leave free, with their bounds.

    Parameters
    ----------
    unit : ndarray, shape (parameters,)
        Typical sizes: those of `link_scales`, and of drive parameters.

    Raises
    ------
    ProblemError
        If a constraint has another form, if `PhysicalConsistency` is not stated exactly
        once, or if a mass has no logarithm.
    InfeasibleError
        If two of them contradict each other.
    """
    margins = [c.margin for c in constraints if isinstance(c, PhysicalConsistency)]
    if len(margins) != 1:
        raise ProblemError(
            f"PhysicalConsistency is stated {len(margins)} times, expected once: the "
            "search is among bodies; or use constrained_least_squares"
        )
    # Quantities that may be bounded: parameters first, then centres of mass.
    links, p = len(model.robot.links), len(model.layout)
    low, high = np.full((2, p + 3 * links), [[-np.inf], [np.inf]])
    for constraint in constraints:
        if isinstance(constraint, PhysicalConsistency):
            continue
        for fact in _facts(constraint, model, unit):
            low[fact.quantity] = max(low[fact.quantity], fact.low)
            high[fact.quantity] = min(high[fact.quantity], fact.high)
            if low[fact.quantity] > high[fact.quantity] + _EQUAL:
                raise InfeasibleError(
                    f"{fact.label!r} contradicts another constraint on the same "
                    "parameter; correct one of them"
                )
    return _within(low, high, margins[0], model)


class _Fact(NamedTuple):
    """``low <= quantity <= high``, in typical units."""

    quantity: int
    low: float
    high: float
    label: str


def _facts(constraint: Constraint, model: TorqueModel, unit: Vector) -> Iterator[_Fact]:
    """Yield a constraint's rows, one quantity at a time, or refuse it."""
    says, n = constraint.lower(model).normalised(unit), model.layout.inertial_size
    labels = [*says.eq_labels, *says.in_labels]
    rows, limits = np.vstack([says.A_eq, says.A_in]), np.append(says.b_eq, says.b_in)
    for index, (row, limit, label) in enumerate(zip(rows, limits, labels, strict=True)):
        is_equal = index < len(says.b_eq)
        last = max(np.flatnonzero(row).tolist(), default=0)
        link, entry = divmod(last, 10)
        alone = np.count_nonzero(row) == 1
        if alone and (entry == MASS or last >= n):
            quantity, value = last, limit / row[last]
        elif is_equal and limit == 0.0 and last < n and _is_offset(row, link, entry):
            quantity = len(row) + 3 * link + entry - 1
            value = -row[10 * link] / row[last]
        else:
            raise _refusal(constraint, label)
        at_least, at_most = is_equal or row[last] < 0.0, is_equal or row[last] > 0.0
        yield _Fact(
            quantity,
            value if at_least else -np.inf,
            value if at_most else np.inf,
            label,
        )
    for block in says.blocks:
        raise _refusal(constraint, block.label)


def _is_offset(row: Vector, link: int, entry: int) -> bool:
    """Return whether a row is ``h_axis - c m`` of a link."""
    rest = np.delete(row, [10 * link, 10 * link + entry])
    return entry in (1, 2, 3) and not rest.any()


def _refusal(constraint: Constraint, label: str) -> ProblemError:
    return ProblemError(
        f"{type(constraint).__name__} says {label!r}, which neither fixes a centre of "
        "mass nor bounds a single mass or drive parameter; use "
        "constrained_least_squares"
    )


def _within(
    low: Vector, high: Vector, margin: float, model: TorqueModel
) -> BodyVariables:
    p, n = len(model.layout), model.layout.inertial_size
    masses = slice(MASS, n, 10)
    for name, most in zip(model.layout.links, high[masses], strict=True):
        if most <= margin:
            raise ProblemError(
                f"{name}: a mass of at most {most:.1e} typical masses, with a margin "
                f"of {margin:.1e}, has no logarithm; use constrained_least_squares"
            )
    known = np.where(high - low <= _EQUAL, high, np.nan)
    free = np.isnan(known[:p])
    for axis in range(3):
        free[1 + axis : n : 10] = np.isnan(known[p + axis :: 3])
    with np.errstate(divide="ignore"):
        low[masses] = np.log(np.maximum(low[masses] - margin, 0.0))
        high[masses] = np.log(high[masses] - margin)
    return BodyVariables(
        links=len(model.robot.links),
        margin=margin,
        known=known[:p],
        centres=known[p:].reshape(-1, 3),
        lower=low[:p][free],
        upper=high[:p][free],
        free=free,
    )


def log_cholesky_curvature(theta: ArrayLike, gradient: ArrayLike) -> Array:
    """Return ``sum_i g_i d2x_i / dtheta dtheta``, exactly.

    With ``<Z, J(x)> = g.x``, the second derivatives of ``<Z, J>`` are its first along
    ``log m``; ``2 m Z_ij`` between ``c_i`` and ``c_j``, and between entries ``i`` and
    ``j`` of one column of ``L``; a diagonal's logarithm adds its first derivative.

    Parameters
    ----------
    theta, gradient : array_like, shape (..., 10)
        Variables; the derivatives ``g`` of any function by the inertial parameters.

    Returns
    -------
    ndarray, shape (..., 10, 10)
    """
    theta, g = np.asarray(theta, dtype=float), np.asarray(gradient, dtype=float)
    slope = np.einsum("...i,...ij->...j", g, log_cholesky_jacobian(theta))
    Z = g @ _DUAL_BASIS  # of J's upper left block
    Z = 2.0 * np.exp(theta[..., MASS])[..., None, None] * Z.reshape(*g.shape[:-1], 3, 3)
    own = np.ones((*theta.shape[:-1], 6))  # dLij by its variable
    own[..., :3] = np.exp(theta[..., DIAGONAL])
    H = np.zeros((*theta.shape, 10))
    H[..., MASS, :] = H[..., :, MASS] = slope
    H[..., COM, COM] = Z
    for a, b in product(range(6), repeat=2):
        if _COLUMNS[a] == _COLUMNS[b]:
            between = Z[..., _ROWS[a], _ROWS[b]] * own[..., a] * own[..., b]
            H[..., 4 + a, 4 + b] = between
    H[..., range(4, 7), range(4, 7)] += slope[..., DIAGONAL]
    return H
