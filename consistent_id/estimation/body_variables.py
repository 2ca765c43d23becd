"""Free variables behind the parameters of a torque model: bodies by log-Cholesky.

In typical units, link ``k`` has the pseudo-inertia ``J(theta_k) + margin 1`` with
``theta_k`` of `log_cholesky`; drive parameters are variables themselves.  Masses,
centres of mass and drive parameters that are fixed are left out; the others may have
bounds.
"""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Matrix, Vector
from consistent_id.robot.inertia import inertial_vector, pseudo_inertia
from consistent_id.robot.log_cholesky import (
    COM,
    MASS,
    body_from_log_cholesky,
    log_cholesky_curvature,
    log_cholesky_from_body,
    log_cholesky_jacobian,
)

_BALL = inertial_vector(np.eye(4))  # the body whose pseudo-inertia is one
_THICKNESS = 0.03  # least thickness of a body to start from, in typical lengths


@dataclass(frozen=True, slots=True, eq=False)
class BodyVariables:
    """Parameters in typical units, ``u``, as a function of free variables ``v``.

    Parameters
    ----------
    margin : float
        Of `PhysicalConsistency`.
    known : ndarray, shape (parameters,)
        Values in ``u`` of masses and drive parameters that are fixed; elsewhere nan.
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
        # A fixed centre is that of the body with its margin; without, it is farther.
        grown = self.centres * (1.0 + self.margin * np.exp(-theta[:, MASS, None]))
        theta[:, COM] = np.where(np.isnan(self.centres), theta[:, COM], grown)
        return theta, everything[n:]

    def _inner(self, theta: Array) -> Array:
        """Return how variables move with each other: fixed centres with the mass."""
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
    """Raise mass and central second moments to what has a finite logarithm."""
    J = pseudo_inertia(body)
    mass = max(J[3, 3], _THICKNESS**2)
    c = J[:3, 3] / mass
    moments, axes = np.linalg.eigh(J[:3, :3] / mass - np.outer(c, c))
    sigma = axes @ np.diag(np.maximum(moments, _THICKNESS**2)) @ axes.T
    J[:3, :3] = mass * (sigma + np.outer(c, c))
    J[3, 3] = mass
    return np.asarray(inertial_vector(J))
