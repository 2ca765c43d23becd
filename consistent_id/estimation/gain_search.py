"""The search for drive gains, on compressed rows of parameters and currents."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix, Vector
from consistent_id.errors import SolverError
from consistent_id.regression.linear import column_sizes
from consistent_id.regression.regression import Regression

_OPEN = 1e-6  # singular value, of unit columns, below which a direction counts as open
_ROUNDS = 20  # of gains and noise in turn
_SETTLED = 1e-4  # relative change of the noise that ends them


class Fit(NamedTuple):
    """Everything at one set of gains."""

    x: Vector
    residual: Vector
    jacobian: Matrix  # of the residual by log gains, parameters following
    raw: Matrix  # the same with parameters held


class Likely(NamedTuple):
    """The most likely gains."""

    log_gains: Vector
    noise: Vector
    fit: Fit
    scale_open: bool


@dataclass(frozen=True, slots=True, eq=False)
class Currents:
    """Compressed rows of all joints, in amperes once divided by gains."""

    A: Matrix  # (rows, unknown parameters), [N m per unit]
    known: Vector  # (rows,), torque of what is known
    current: Vector  # (rows,)
    joint: IntArray  # (rows,), which joint a row is of

    def at(self, log_gains: Vector, noise: Vector) -> Fit:
        """Return the best parameters for given gains, and what is left."""
        j = self.joint
        weight = 1.0 / (np.exp(log_gains[j]) * noise[j])
        Q, x = _solved(
            self.A * weight[:, None], self.current / noise[j] - self.known * weight
        )
        torque = (self.A @ x + self.known) * weight
        residual = torque - self.current / noise[j]
        raw = np.zeros((len(j), len(log_gains)))
        raw[np.arange(len(j)), j] = -torque
        return Fit(x, residual, raw - Q @ (Q.T @ raw), raw)


def linear_gains(rows: Currents, joints: int) -> Vector:
    """Return the gains of least squares on ``Y x - K i = - known``."""
    currents = np.zeros((len(rows.joint), joints))
    currents[np.arange(len(rows.joint)), rows.joint] = -rows.current
    A = np.hstack([rows.A, currents])
    _, solution = _solved(A, -rows.known)
    return np.asarray(solution[-joints:])


def most_likely_gains(rows: Currents, regression: Regression, linear: Vector) -> Likely:
    """Minimise the misfit in amperes; gains and noise in turn until both settle."""
    from scipy.optimize import least_squares

    counts = np.array(regression.counts, dtype=np.float64)
    log_gains = _start(rows, linear)
    noise = regression.torque_rms  # of the currents, to begin with
    floor = 1e-6 * noise
    spent = (rows.A.shape[1] + len(counts)) / counts.sum()
    free = _told(rows.at(log_gains, noise))
    for _ in range(_ROUNDS):
        origin, sigma = log_gains, noise
        found = least_squares(
            lambda v, u=origin, s=sigma: rows.at(u + free @ v, s).residual,
            np.zeros(free.shape[1]),
            jac=lambda v, u=origin, s=sigma: rows.at(u + free @ v, s).jacobian @ free,
            xtol=1e-12,
            ftol=1e-12,
            gtol=1e-12,
        )
        log_gains = origin + free @ found.x
        squares = rows.at(log_gains, noise).residual ** 2
        left = np.bincount(rows.joint, squares) / counts / max(1.0 - spent, 1e-3)
        noise = np.maximum(noise * np.sqrt(left), floor)
        if (abs(noise - sigma) <= _SETTLED * sigma).all():
            fit = rows.at(log_gains, noise)
            return Likely(log_gains, noise, fit, free.shape[1] < len(counts))
    raise SolverError(
        f"gains and noise did not settle in {_ROUNDS} rounds; the runs do not tell "
        "the gains, those with the load and without are exchanged, or the model is far "
        "from the robot"
    )


def _start(rows: Currents, linear: Vector) -> Vector:
    """Return logarithms of the gains of least squares, as far as they are any."""
    # Where nothing fixes the scale, no torque at all fits best: gains of zero.
    torque = np.linalg.norm(linear[rows.joint] * rows.current)
    positive = linear > 0.0
    if not positive.any() or torque <= _OPEN * np.linalg.norm(rows.known):
        return np.zeros(len(linear))
    return np.log(np.where(positive, linear, np.median(linear[positive])))


def _told(fit: Fit) -> Matrix:
    """Return a basis of the directions of log gains that are identifiable."""
    sizes = column_sizes(fit.raw)
    _, s, Vt = np.linalg.svd(fit.jacobian / sizes, full_matrices=False)
    null = (Vt[s <= _OPEN] / sizes).T
    Q, _ = np.linalg.qr(np.hstack([null, np.eye(len(sizes))]))
    return Q[:, null.shape[1] :]


def _solved(A: Matrix, b: Vector) -> tuple[Matrix, Vector]:
    """Return an orthonormal basis of unit columns, and the least-squares solution."""
    unit = column_sizes(A)
    U, s, Vt = np.linalg.svd(A / unit, full_matrices=False)
    kept = s > 1e-10 * s[0]
    Q = U[:, kept]
    return Q, (Vt[kept].T / s[kept]) @ (Q.T @ b) / unit
