"""The best consistent fit once more, by a smooth search without a cone programme.

Links are physically consistent by construction [Rucker2022]_: what is estimated are
log-Cholesky variables.  The search shares no solver, cone or base parameter with the
semidefinite programme, so that each checks the other; nor does it need a model to be
linear.

The point found is judged by the same certificate.  Its multipliers are read off the
gradient: where ``<Z_k, J_k(x)>`` has the gradient's entries of link ``k``, optimality
is ``Z_k >= 0`` and ``Z_k J_k = 0``.
"""

from collections.abc import Sequence
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Matrix, Vector, frozen
from consistent_id._support.threads import single_threaded
from consistent_id.constraints import Constraint, lowered
from consistent_id.constraints.cones.certificate import (
    GAP_TOLERANCE,
    Optimality,
    certify,
)
from consistent_id.constraints.cones.least_norm import ConeSolution, LeastNorm
from consistent_id.constraints.cones.programmes import Multipliers
from consistent_id.estimation.body_variables import BodyVariables
from consistent_id.estimation.constrained import DEFAULT_CONSTRAINTS
from consistent_id.estimation.constraint_variables import body_variables
from consistent_id.estimation.determination import determinations
from consistent_id.estimation.estimate import Certificate, Estimate
from consistent_id.estimation.fit import fit_of
from consistent_id.estimation.scaled_fit import REFERENCE, ScaledFit, scaled_fit
from consistent_id.estimation.smooth_fit import SmoothFit, smooth_fit
from consistent_id.regression.base import (
    BaseParameters,
    base_parameters,
    open_combinations,
)
from consistent_id.regression.linear import solve_linear
from consistent_id.regression.noise import residual_sigma
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import residual_noise
from consistent_id.robot.inertia import PSEUDO_INERTIA_BASIS, pseudo_inertia
from consistent_id.robot.scaling import reference_bodies

_ACTIVE = 1e-9  # distance to a bound, in typical parameters, at which it holds


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
        `PhysicalConsistency`, once; else what fixes a centre of mass or fixes or bounds
        a single mass or drive parameter: `FixedMasses`, `MassBounds`,
        `FixedCentresOfMass`, `NonNegativeDrive`, `FixedParameters`, `ParameterBounds`.
    start : array_like, shape (parameters,), optional
        By default `reference_bodies`, without friction.
    base : BaseParameters, optional

    Returns
    -------
    Estimate
        Certified if no other parameters fit better, which is proven afterwards; what
        is not identifiable is near the start, but not the nearest: see
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
    R, columns = regression.stacked(), list(base.independent)
    fit = smooth_fit(
        R[:, :-1] * (scaled.unit / scaled.size),
        R[:, -1] / scaled.size,
        variables,
        _start(model, start) / scaled.unit,
    )
    x = fit.u * scaled.unit
    solution = solve_linear(R[:, columns], R[:, -1])
    return Estimate(
        method="log-Cholesky",
        model=model,
        base=base,
        parameters=x,
        base_covariance=None,
        origins=determinations(
            model,
            regression,
            base,
            residual_noise(regression, base),
            x,
            known=lowered(constraints, model).A_eq,
            elsewhere="prior",
        ),
        undetermined=open_combinations(solution, base.names),
        sigma=residual_sigma(regression, x, len(base)),
        certificate=_certificate(fit, _proof(scaled, variables, fit.u)),
        notes=("what the data do not determine is near the start of the search",),
        seconds=perf_counter() - started,
        fit=fit_of(model, regression, x, base),
    )


def _start(model: TorqueModel, start: ArrayLike | None) -> Vector:
    if start is not None:
        return frozen(start, (len(model.layout),), "start")
    bodies = reference_bodies(model.robot).ravel()
    return np.append(bodies, np.zeros(len(model.layout) - len(bodies)))


def _proof(scaled: ScaledFit, variables: BodyVariables, u: Vector) -> Optimality:
    """Certify a point as the cone programme's is, with multipliers of its own."""
    problem = scaled.problem
    centre = scaled.centre
    solution = ConeSolution(u, _multipliers(problem, variables, u), "smooth", 0.0, 0.0)
    return certify(problem, solution, centre, reference=REFERENCE)


def _multipliers(
    problem: LeastNorm, variables: BodyVariables, u: Vector
) -> Multipliers:
    """Multipliers that explain as much of the gradient as their signs allow."""
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
            f"best fit proven to a relative {proof.gap:.1e}; where the data leave "
            "parameters open, others fit as well",
            figures,
        )
    return Certificate(
        "uncertified",
        f"a smooth search ended here, but a gap of {proof.gap:.1e} to the best fit "
        f"(allowed {GAP_TOLERANCE:.0e}) was not excluded; cross_check compares it with "
        "the cone programme",
        figures,
    )
