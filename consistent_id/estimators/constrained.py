"""The best fit among parameters that a real body could have.

In the standard parameters from the start, because that is where consistency lives:

1. the least weighted misfit ``||R x - z||`` over the constraints;
2. among all constrained ``x`` whose misfit is within a slack of it, the one nearest to
   the nominal robot, so that what the data leave open is settled by the prior and not
   by the solver's whim.

Both are cone programmes on the compressed regression; both optima are certified.
"""

from collections.abc import Sequence
from time import perf_counter
from typing import NamedTuple

import numpy as np

from consistent_id._arrays import Vector
from consistent_id.base import BaseParameters, base_parameters, parameter_origins
from consistent_id.certificate import FEASIBILITY_TOLERANCE, GAP_TOLERANCE, Optimality
from consistent_id.cone_program import ConeSolution, LeastNorm
from consistent_id.constraints import (
    Constraint,
    FixedMasses,
    NonNegativeDrive,
    PhysicalConsistency,
    lowered,
)
from consistent_id.errors import SolverError
from consistent_id.estimate import Certificate, Estimate
from consistent_id.estimators.best_fit import (
    REFERENCE,
    BestFit,
    best_fit,
    nominal_point,
    solved,
)
from consistent_id.estimators.least_squares import residual_sigma, solve_linear
from consistent_id.inertia import pseudo_inertia
from consistent_id.priors import PointToSet
from consistent_id.regression import Regression
from consistent_id.regressor import TorqueModel
from consistent_id.scaling import link_scales

DEFAULT_CONSTRAINTS: tuple[Constraint, ...] = (
    PhysicalConsistency(),
    FixedMasses(),
    NonNegativeDrive(),
)
"""Every link a body, masses of the datasheet, friction that dissipates."""

_WEIGHTS = 20  # weights of the prior tried, at the most
_STEP = np.log(30.0)  # by which the weight grows or shrinks until it is bracketed
_STILL = 0.01  # change of the robot, in distances, below which a weight is enough
_DISTANCE_GAP = 0.01  # relative gap of the squared distance (or of 0.01) allowed
_USED = 0.5  # share of the slack that must be used up


def constrained_least_squares(
    model: TorqueModel,
    regression: Regression,
    *,
    constraints: Sequence[Constraint] = DEFAULT_CONSTRAINTS,
    prior: PointToSet | None = None,
    base: BaseParameters | None = None,
    method: str = "constrained",
) -> Estimate:
    """Estimate all parameters under physical constraints.

    Parameters
    ----------
    model : TorqueModel
    regression : Regression
        Its `sigma` are the weights; see `joint_noise`.
    constraints : sequence of Constraint
        By default every link physically consistent, datasheet masses, and no negative
        friction or rotor inertia.
    prior : PointToSet, optional
        Settles what the data leave open.
    base : BaseParameters, optional
    method : str

    Returns
    -------
    Estimate
        Certified when feasibility, both optima and the slack have been verified from
        the problem's own data.

    Raises
    ------
    InfeasibleError
        If no parameters satisfy the constraints; names those to blame.
    NotExcitedError
        If the data excite nothing, or the torque is zero.
    SolverError
        If no solver returns a usable point.
    """
    started = perf_counter()
    base = base_parameters(model) if base is None else base
    prior = PointToSet() if prior is None else prior
    fit = best_fit(model, regression, constraints, base=base, distance=prior.distance)
    slack = prior.relative_slack(len(base), sum(regression.counts))
    near = _nearest(fit, slack)

    x = near.solution.u * fit.scaled.unit
    R, columns = regression.stacked(), list(base.independent)
    return Estimate(
        method=method,
        model=model,
        base=base,
        parameters=x,
        base_covariance=None,
        origins=parameter_origins(
            solve_linear(R[:, columns], R[:, -1]).row_space @ base.projection,
            lowered(constraints, model).A_eq,
            elsewhere="prior",
        ),
        undetermined=(),
        sigma=residual_sigma(regression, x, len(base)),
        certificate=_certificate(model, x, fit.optimality, near, slack),
        notes=(
            f"nearest to nominal ({prior.distance} distance) among estimates whose "
            f"misfit is within {slack:.2%} of the best constrained fit",
        ),
        seconds=perf_counter() - started,
    )


class _Nearest(NamedTuple):
    """Result of the prior's stage; `share` bounds the relative gap of the distance."""

    solution: ConeSolution
    optimality: Optimality
    share: float


def _nearest(best: BestFit, slack: float) -> _Nearest:
    """Return the point nearest to nominal whose misfit is within `slack` of the best.

    The weight of the distance is raised until the misfit uses up the slack, or the
    nominal robot fits within it and raising brings nothing any more.  The optimum for a
    weight is the nearest point for its own misfit, and, unlike a bound on the misfit,
    it is a well-conditioned problem.
    """
    scaled, G, g = best.scaled, best.G, best.g
    centre = nominal_point(G, g)
    least = float(np.linalg.norm(scaled.M @ best.solution.u - scaled.z)) ** 2
    total = least + scaled.residual**2
    allowed = ((1.0 + slack) ** 2 - 1.0) * max(total, 1.0)
    low, high = -np.inf, np.inf
    log_weight, share = np.log(allowed), np.inf
    kept: tuple[ConeSolution, Optimality] | None = None
    for _ in range(_WEIGHTS):
        root = np.exp(log_weight / 2)
        problem = LeastNorm(
            np.vstack([scaled.M, root * G]),
            np.append(scaled.z, root * g),
            scaled.domain,
        )
        solution, optimality = solved(problem, centre)
        excess = float(np.linalg.norm(scaled.M @ solution.u - scaled.z)) ** 2 - least
        if excess <= allowed:
            moved = np.inf if kept is None else G @ (solution.u - kept[0].u)
            settled = excess >= _USED * allowed or np.linalg.norm(moved) <= _STILL
            if kept is None or optimality.verdict == "certified":
                kept, low = (solution, optimality), log_weight
                distance = float(np.linalg.norm(G @ solution.u - g)) ** 2
                share = _distance_gap(optimality, root**2) / max(distance, _STILL)
            if settled:
                break
        else:
            high = log_weight
        if np.isinf(low) or np.isinf(high):
            log_weight += _STEP if np.isinf(high) else -_STEP
        else:
            log_weight = (low + high) / 2
    if kept is None:
        raise SolverError("no weight of the prior keeps the misfit within its slack")
    return _Nearest(kept[0], kept[1], float(share))


def _distance_gap(optimality: Optimality, weight: float) -> float:
    """Bound on what the squared distance exceeds the least by, for its misfit."""
    total = optimality.gap * max(optimality.objective, REFERENCE)
    return 2.0 * total / weight


def _certificate(
    model: TorqueModel, x: Vector, fit: Optimality, near: "_Nearest", slack: float
) -> Certificate:
    scales = link_scales(model.robot).root
    links = x[: model.layout.inertial_size].reshape(-1, 10)
    least = min(
        float(np.linalg.eigvalsh(J / np.outer(root, root))[0])
        for J, root in zip(pseudo_inertia(links), scales, strict=True)
    )
    figures = {
        "fit: relative gap": fit.gap,
        "fit: violation": fit.violation,
        "prior: relative gap of the squared distance": near.share,
        "prior: violation": near.optimality.violation,
        "slack": slack,
        "least eigenvalue of J, per typical link": least,
    }
    violation = max(fit.violation, near.optimality.violation)
    fine = fit.verdict == "certified" and near.optimality.verdict == "certified"
    if fine and near.share <= _DISTANCE_GAP:
        reason = (
            f"best fit proven to a relative {fit.gap:.1e}, squared distance to nominal "
            f"to {near.share:.1e}, constraints violated by at most {violation:.1e}"
        )
        return Certificate("certified", reason, figures)
    reason = (
        f"relative gap of the best fit {fit.gap:.1e} (allowed {GAP_TOLERANCE:.0e}), of "
        f"the squared distance {near.share:.1e} (allowed {_DISTANCE_GAP:.0e}), "
        f"violation {violation:.1e} (allowed {FEASIBILITY_TOLERANCE:.0e}); the "
        "estimate is usable only as far as these figures say"
    )
    return Certificate("uncertified", reason, figures)
