"""The least misfit among bodies, by Newton's method in log-Cholesky variables.

``1/2 ||A u(v) - z||^2 + pull/2 ||v - start||^2``

is minimised for one pull after another, each a hundredth of the one before, the last
of them too faint to matter.  The pull keeps bodies thick while they are far from
optimal: one that has become flat too early has hardly a gradient left to grow again by.

Gauss-Newton does not do: where a body gets flat, residuals become linear in
``Lii^2 = exp(2 v)``, whose curvature by ``v`` Gauss-Newton omits, and it crawls.  The
curvature of the parametrisation is known exactly, so it is used.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import BoolArray, Matrix, Vector
from consistent_id.estimation.body_variables import BodyVariables

PULLS = 10.0 ** np.arange(0, -15, -2)
"""Weights of the pull towards the start, in units of the squared residual."""

_STEPS = 300  # Newton steps for each pull, at the most
_STILL = 1e-4  # decrease, in pulls, at which the next pull's turn has come
_REACH = 2.0  # longest step of a variable: a factor of 7 for a mass or a thickness
_TRIALS = 40  # shorter and shorter steps tried


@dataclass(frozen=True, slots=True, eq=False)
class SmoothFit:
    """The end of the search.

    Parameters
    ----------
    u : ndarray, shape (parameters,)
        In typical units.
    misfit : float
        ``||A u - z||``.
    gradient : float
        Norm of the derivatives of ``1/2 misfit^2`` by the variables, but for those
        whose bounds stop them.
    pulled : float
        What the last pull adds to the misfit's square.
    steps : int
        Newton steps in all.
    """

    u: Vector
    misfit: float
    gradient: float
    pulled: float
    steps: int


def smooth_fit(
    A: Matrix, z: Vector, variables: BodyVariables, start: Vector
) -> SmoothFit:
    """Search for the least ``||A u - z||``, from a point in typical units.

    Parameters
    ----------
    A : ndarray, shape (rows, parameters)
    z : ndarray, shape (rows,)
        In units of a misfit that matters.
    start : ndarray, shape (parameters,)
    """
    origin = variables.variables(start)
    v, steps = origin, 0
    for pull in PULLS:
        problem = _Pulled(A, z, variables, origin, float(pull))
        v, taken = _minimised(problem, v)
        steps += taken
    u = variables.parameters(v)
    residual = A @ u - z
    gradient = (A @ variables.jacobian(v)).T @ residual
    return SmoothFit(
        u=u,
        misfit=float(np.linalg.norm(residual)),
        gradient=float(np.linalg.norm(gradient[~_at_bound(variables, v, gradient)])),
        pulled=float(PULLS[-1] * (v - origin) @ (v - origin)),
        steps=steps,
    )


class _Pulled(NamedTuple):
    """The objective with one pull."""

    A: Matrix
    z: Vector
    variables: BodyVariables
    origin: Vector
    pull: float

    def value(self, v: Vector) -> float:
        residual = self.A @ self.variables.parameters(v) - self.z
        away = v - self.origin
        return float(residual @ residual + self.pull * away @ away) / 2

    def derivatives(self, v: Vector) -> tuple[Vector, Matrix]:
        by_u = self.A.T @ (self.A @ self.variables.parameters(v) - self.z)
        J = self.A @ self.variables.jacobian(v)
        gradient = self.variables.jacobian(v).T @ by_u + self.pull * (v - self.origin)
        hessian = J.T @ J + self.variables.curvature(v, by_u)
        return gradient, hessian + self.pull * np.eye(len(v))


def _minimised(problem: _Pulled, v: Vector) -> tuple[Vector, int]:
    """Return a minimum near `v`, and the steps taken to it."""
    value, damping = problem.value(v), 0.0
    for steps in range(_STEPS):
        trial = _step(problem, v, value, damping)
        if trial is None:
            return v, steps
        decrease, v, value = value - trial.value, trial.v, trial.value
        if decrease <= _STILL * problem.pull:
            return v, steps + 1
        damping = trial.damping
    return v, _STEPS


class _Trial(NamedTuple):
    """A better point, and the damping to begin the next step with."""

    v: Vector
    value: float
    damping: float


def _step(problem: _Pulled, v: Vector, value: float, damping: float) -> _Trial | None:
    """Return a step that lowers the value, if there is one.

    ``-(|H| + damping)^-1 g`` over the variables that no bound holds, ``|H|`` with the
    eigenvalues' magnitudes, so that it descends where the objective is not convex.
    """
    bounds = problem.variables
    gradient, hessian = problem.derivatives(v)
    free = ~_at_bound(bounds, v, gradient)
    curvatures, axes = np.linalg.eigh(hessian[np.ix_(free, free)])
    along = axes.T @ gradient[free]
    for _ in range(_TRIALS):
        new = v.copy()
        new[free] -= axes @ (along / np.maximum(abs(curvatures) + damping, 1e-300))
        new = np.clip(new, bounds.lower, bounds.upper)
        step = new - v
        near = abs(step).max(initial=0.0) <= _REACH
        if near and (better := problem.value(new)) < value:
            expected = -float(gradient @ step + step @ hessian @ step / 2)
            trust = (value - better) / expected if expected > 0.0 else 1.0
            factor = 0.1 if trust > 0.75 else 3.0 if trust < 0.25 else 1.0
            return _Trial(new, better, factor * damping)
        damping = max(4.0 * damping, problem.pull / 10)
    return None


def _at_bound(bounds: BodyVariables, v: Vector, gradient: Vector) -> BoolArray:
    """Return which variables are at a bound and would go beyond."""
    below = (v <= bounds.lower) & (gradient > 0.0)
    return np.asarray(below | ((v >= bounds.upper) & (gradient < 0.0)))
