"""The best consistent fit by a smooth search, without a cone programme.

Links are physically consistent by construction [Rucker2022]_: the search is in
log-Cholesky variables.  The search shares no solver, cone or base parameter with the
semidefinite programme, so each checks the other; and the model need not be linear.

``1/2 ||A u(v) - z||^2 + pull/2 ||v - start||^2``

is minimised by Newton's method for one pull after another, each a hundredth of the one
before, the last of them too faint to matter.  The pull keeps bodies thick while they
are far from optimal: a body that has become flat too early has too small a gradient to
grow again. Gauss-Newton is not suitable: for flat bodies, residuals are linear in
``Lii^2 = exp(2 v)``; Gauss-Newton omits the curvature by ``v`` and converges slowly.
The curvature of the parametrisation is known exactly, so it is used.

The point found is judged by the same certificate.  Its multipliers are read off the
gradient: where ``<Z_k, J_k(x)>`` has the gradient's entries of link ``k``, optimality
is ``Z_k >= 0`` and ``Z_k J_k = 0``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import NamedTuple

import numpy as np
from body_variables import BodyVariables, body_variables
from numpy.typing import ArrayLike

from consistent_id._support.arrays import BoolArray, Matrix, Vector, frozen
from consistent_id._support.executors import single_threaded
from consistent_id.constraints import Constraint, lowered
from consistent_id.constraints.cones.certificate import (
    GAP_TOLERANCE,
    Certificate,
    Optimality,
    ball_about,
    certify,
)
from consistent_id.constraints.cones.least_norm import ConeSolution, LeastNorm
from consistent_id.constraints.cones.programmes import Multipliers
from consistent_id.estimation.best_fit import REFERENCE, ScaledFit, scaled_fit
from consistent_id.estimation.constrained_fit import DEFAULT_CONSTRAINTS
from consistent_id.estimation.determination import determinations, linear_errors
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.fit import fit_of
from consistent_id.regression.base import (
    BaseParameters,
    base_parameters,
    open_combinations,
)
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import residual_sigma, unconstrained_fit
from consistent_id.robot.inertia import PSEUDO_INERTIA_BASIS, pseudo_inertia
from consistent_id.robot.scaling import reference_bodies

_ACTIVE = 1e-9  # distance to a bound, in typical parameters, at which it is active

PULLS = 10.0 ** np.arange(0, -15, -2)
"""Weights of the pull towards the start, in units of the squared residual."""

_STEPS = 300  # most Newton steps for each pull
_STILL = 1e-4  # decrease, in pulls, below which the next pull is used
_REACH = 2.0  # longest step of a variable: a factor of 7 for a mass or a thickness
_TRIALS = 40  # number of shorter steps tried


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
        Contribution of the last pull to the misfit's square.
    steps : int
        Newton steps in all.
    """

    u: Vector
    misfit: float
    gradient: float
    pulled: float
    steps: int


@single_threaded
def smooth_least_squares(
    model: TorqueModel,
    regression: Regression,
    *,
    constraints: Sequence[Constraint] = DEFAULT_CONSTRAINTS,
    start: ArrayLike | None = None,
    base: BaseParameters | None = None,
) -> Estimate:
    """Estimate all parameters among bodies: ``min ||R x(theta) - z||``.

    Parameters
    ----------
    model : TorqueModel
    regression : Regression
        Its `sigma` are the weights; see `joint_noise`.
    constraints : sequence of Constraint
        `PhysicalConsistency`, once, and constraints that fix a centre of mass, or fix
        or bound a single mass or drive parameter: `FixedMasses`, `MassBounds`,
        `FixedCentresOfMass`, `NonNegativeDrive`, `FixedParameters`, `ParameterBounds`.
    start : array_like, shape (parameters,), optional
        By default `reference_bodies`, without friction.
    base : BaseParameters, optional

    Returns
    -------
    Estimate
        Certified if it is proven afterwards that no other parameters fit better.
        Unidentifiable parameters are near the start, but not the nearest: see
        `constrained_least_squares` for that.

    Raises
    ------
    ProblemError
        If a constraint is none of these; the message names it.
    InfeasibleError
        If two constraints contradict each other.
    NotExcitedError
        If the data excite nothing, or the torque is zero.
    """
    started = perf_counter()
    base = base_parameters(model) if base is None else base
    scaled = scaled_fit(model, regression, base, constraints)
    variables = body_variables(model, constraints, scaled.unit)
    R = regression.stacked()
    fit = smooth_fit(
        R[:, :-1] * (scaled.unit / scaled.size),
        R[:, -1] / scaled.size,
        variables,
        _start(model, start) / scaled.unit,
    )
    x = fit.u * scaled.unit
    free = unconstrained_fit(regression, base)
    known = lowered(constraints, model).A_eq
    return Estimate(
        method="log-Cholesky",
        model=model,
        base=base,
        parameters=x,
        base_covariance=None,
        origins=determinations(
            model,
            free,
            linear_errors(base, free.noise, known),
            x,
            elsewhere="prior",
        ),
        undetermined=open_combinations(free.solution, base.names),
        sigma=residual_sigma(regression, x, len(base)),
        certificate=_certificate(fit, _proof(scaled, variables, fit.u)),
        notes=("unidentifiable parameters are near the start of the search",),
        seconds=perf_counter() - started,
        fit=fit_of(model, free, x),
    )


def _start(model: TorqueModel, start: ArrayLike | None) -> Vector:
    if start is not None:
        return frozen(start, (len(model.layout),), "start")
    bodies = reference_bodies(model.robot).ravel()
    return np.append(bodies, np.zeros(len(model.layout) - len(bodies)))


def _proof(scaled: ScaledFit, variables: BodyVariables, u: Vector) -> Optimality:
    """Certify a point like the cone programme's, with its own multipliers."""
    problem = scaled.problem
    centre = scaled.centre
    solution = ConeSolution(u, _multipliers(problem, variables, u), "smooth", 0.0, 0.0)
    return certify(problem, solution, ball_about(centre), reference=REFERENCE)


def _multipliers(
    problem: LeastNorm, variables: BodyVariables, u: Vector
) -> Multipliers:
    """Multipliers that explain the gradient as far as their signs allow."""
    domain, n = problem.domain, 10 * variables.links
    rest = problem.G.T @ (problem.G @ u - problem.g)
    blocks = []
    for k, body in enumerate(u[:n].reshape(-1, 10)):
        own = slice(10 * k, 10 * k + 10)
        J = pseudo_inertia(body) - variables.margin * np.eye(4)
        Z = _block_multiplier(rest[own], J[:3, 3] / J[3, 3])
        rest[own] -= np.tensordot(PSEUDO_INERTIA_BASIS, Z, axes=2)
        blocks.append(Z)
    active = domain.b_in - domain.A_in @ u <= _ACTIVE
    # Rows are of unit size and of one parameter each.
    at_most = np.where(active, np.maximum(-domain.A_in @ rest, 0.0), 0.0)
    return Multipliers(np.zeros(len(domain.b_eq)), at_most, tuple(blocks))


def _block_multiplier(gradient: Vector, c: Vector) -> Matrix:
    """Return ``Z >= 0`` with ``Z (c, 1) = 0`` and the gradient by second moments.

    ``dI = tr(dSigma) 1 - dSigma`` makes ``Z = tr(G) 1 - G`` with ``G`` the gradient by
    the inertia, as a symmetric matrix.
    """
    G = np.array(gradient[[4, 5, 7, 5, 6, 8, 7, 8, 9]]).reshape(3, 3)
    G[~np.eye(3, dtype=bool)] /= 2.0
    values, axes = np.linalg.eigh(np.trace(G) * np.eye(3) - G)
    down = np.vstack([np.eye(3), -c])
    root = down @ axes * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(root @ root.T)


def _certificate(fit: SmoothFit, proof: Optimality) -> Certificate:
    figures = {
        "misfit, in residuals of least squares": fit.misfit,
        "gradient": fit.gradient,
        "share of the pull to the start": fit.pulled / max(fit.misfit**2, 1.0),
        "steps": float(fit.steps),
        "fit: relative gap": proof.gap,
        "fit: violation": proof.violation,
    }
    if proof.verdict == "certified":
        return Certificate(
            "certified",
            f"best fit proven to a relative {proof.gap:.1e}; if the data do not "
            f"determine all parameters, others fit equally well",
            figures,
        )
    return Certificate(
        "uncertified",
        f"a smooth search ended here, but a gap of {proof.gap:.1e} to the best fit "
        f"(allowed {GAP_TOLERANCE:.0e}) was not excluded by its proof",
        figures,
    )


def smooth_fit(
    A: Matrix, z: Vector, variables: BodyVariables, start: Vector
) -> SmoothFit:
    """Search for the least ``||A u - z||``, from a point in typical units.

    Parameters
    ----------
    A : ndarray, shape (rows, parameters)
    z : ndarray, shape (rows,)
        In units of a significant misfit.
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

    ``-(|H| + damping)^-1 g`` over the variables without an active bound, ``|H|`` with
    the eigenvalues' magnitudes, so that it descends where the objective is not convex.
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
