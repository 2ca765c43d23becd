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
from consistent_id._threads import single_threaded
from consistent_id.base import BaseParameters, base_parameters, parameter_origins
from consistent_id.certificate import FEASIBILITY_TOLERANCE, GAP_TOLERANCE
from consistent_id.constraints import (
    Constraint,
    FixedMasses,
    NonNegativeDrive,
    PhysicalConsistency,
    lowered,
)
from consistent_id.distances import nominal_distance
from consistent_id.estimate import Certificate, Estimate
from consistent_id.estimators.best_fit import BestFit, best_fit
from consistent_id.estimators.least_squares import residual_sigma, solve_linear
from consistent_id.estimators.nearest import nearest_within
from consistent_id.estimators.penalised import PenalisedFit, penalised_fit
from consistent_id.link_condition import LinkCondition, link_conditions
from consistent_id.mass_matrix import POSES, least_mass_eigenvalue, random_poses
from consistent_id.priors import Penalty, PointToSet, Prior
from consistent_id.regression import Regression
from consistent_id.regressor import TorqueModel

DEFAULT_CONSTRAINTS: tuple[Constraint, ...] = (
    PhysicalConsistency(),
    FixedMasses(),
    NonNegativeDrive(),
)
"""Every link a body, masses of the datasheet, friction that dissipates."""

_DISTANCE_GAP = 0.01  # relative gap of the squared distance (or of 0.01) allowed
_SEED = 0  # of the poses at which mass matrices are examined


@single_threaded
def constrained_least_squares(
    model: TorqueModel,
    regression: Regression,
    *,
    constraints: Sequence[Constraint] = DEFAULT_CONSTRAINTS,
    prior: Prior | None = None,
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
    prior : PointToSet or Penalty, optional
        Settles what the data leave open; by default `PointToSet`.
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
    fit = best_fit(model, regression, constraints, base=base)
    settled = _settled(model, regression, fit, prior, len(base))

    x = settled.fit.solution.u * fit.scaled.unit
    links = link_conditions(model, x)
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
        certificate=_certificate(model, x, links, fit, settled),
        notes=(
            settled.words,
            *(
                f"{link.link} is at the edge: {link.edge}"
                for link in links
                if link.edge
            ),
        ),
        seconds=perf_counter() - started,
    )


class _Settled(NamedTuple):
    """Result of the prior's stage.

    `slack` is the relative misfit given up, at the most; `share` bounds the relative
    excess of the squared distance, where the prior is `PointToSet`.
    """

    fit: PenalisedFit
    slack: float
    share: float
    words: str


def _settled(
    model: TorqueModel, regression: Regression, fit: BestFit, prior: Prior, base: int
) -> _Settled:
    distance = nominal_distance(model, prior.distance, fit.scaled.unit)
    if isinstance(prior, Penalty):
        found = penalised_fit(fit.scaled, distance, prior.weight)
        total = fit.scaled.residual**2 + np.array(
            [found.excess, fit.scaled.excess(fit.solution.u)]
        )
        given = float(np.sqrt(total[0] / max(total[1], 1e-300)) - 1.0)
        words = (
            f"compromise of misfit and {prior.distance} distance to nominal, weight "
            f"{prior.weight:.3g}; its misfit is {given:.2%} above the best constrained"
        )
        return _Settled(found, given, 0.0, words)
    slack = prior.relative_slack(base, sum(regression.counts))
    near = nearest_within(fit, distance, slack)
    words = (
        f"nearest to nominal ({prior.distance} distance) among estimates whose misfit "
        f"is within {slack:.2%} of the best constrained fit"
    )
    return _Settled(near.fit, slack, near.share, words)


def _certificate(
    model: TorqueModel,
    x: Vector,
    links: tuple[LinkCondition, ...],
    best: BestFit,
    settled: _Settled,
) -> Certificate:
    fit, final = best.optimality, settled.fit.optimality
    poses = random_poses(model, POSES, _SEED)
    figures = {
        "fit: relative gap": fit.gap,
        "fit: violation": fit.violation,
        "prior: relative gap": final.gap,
        "prior: relative gap of the squared distance": settled.share,
        "prior: violation": final.violation,
        "slack": settled.slack,
        "weight of the prior": settled.fit.weight,
        f"least eigenvalue of M(q) over {POSES} poses": least_mass_eigenvalue(
            model, x, poses
        ),
    }
    figures |= {
        f"least eigenvalue of J of {link.link}, per typical link": link.least_eigenvalue
        for link in links
    }
    violation = max(fit.violation, final.violation)
    fine = fit.verdict == "certified" and final.verdict == "certified"
    if fine and settled.share <= _DISTANCE_GAP:
        reason = (
            f"best fit proven to a relative {fit.gap:.1e}, "
            f"{_proven(settled)}, constraints violated by at most {violation:.1e}"
        )
        return Certificate("certified", reason, figures)
    reason = (
        f"relative gap of the best fit {fit.gap:.1e} and of the final estimate "
        f"{final.gap:.1e} (allowed {GAP_TOLERANCE:.0e}), of the squared distance "
        f"{settled.share:.1e} (allowed {_DISTANCE_GAP:.0e}), violation {violation:.1e} "
        f"(allowed {FEASIBILITY_TOLERANCE:.0e}); the estimate is usable only as far as "
        "these figures say"
    )
    return Certificate("uncertified", reason, figures)


def _proven(settled: _Settled) -> str:
    if settled.share > 0.0:
        return f"squared distance to nominal to {settled.share:.1e}"
    return f"compromise with the prior to {settled.fit.optimality.gap:.1e}"
