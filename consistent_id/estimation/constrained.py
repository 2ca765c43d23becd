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

from consistent_id._support.threads import single_threaded
from consistent_id.constraints import (
    Constraint,
    FixedMasses,
    NonNegativeDrive,
    PhysicalConsistency,
    lowered,
)
from consistent_id.constraints.cones.certificate import (
    FEASIBILITY_TOLERANCE,
    GAP_TOLERANCE,
)
from consistent_id.constraints.link_condition import LinkCondition, link_conditions
from consistent_id.constraints.priors import Prior
from consistent_id.estimation.estimate import Certificate, Estimate
from consistent_id.estimation.least_squares import residual_sigma, solve_linear
from consistent_id.estimation.method import Method
from consistent_id.estimation.nearest import DISTANCE_GAP
from consistent_id.estimation.settled import SLACK_GAP, Settled, settle
from consistent_id.regression.base import (
    BaseParameters,
    base_parameters,
    parameter_origins,
)
from consistent_id.regression.mass_matrix import (
    POSES,
    least_mass_eigenvalue,
    random_poses,
)
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel

DEFAULT_CONSTRAINTS: tuple[Constraint, ...] = (
    PhysicalConsistency(),
    FixedMasses(),
    NonNegativeDrive(),
)
"""Every link a body, masses of the datasheet, friction that dissipates."""

_SEED = 0  # of the poses at which mass matrices are examined


@single_threaded
def constrained_least_squares(
    model: TorqueModel,
    regression: Regression,
    *,
    constraints: Sequence[Constraint] = DEFAULT_CONSTRAINTS,
    prior: Prior | None = None,
    base: BaseParameters | None = None,
    method: str = Method.CONSTRAINED,
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
    settled = settle(model, regression, constraints, prior, base)
    x = settled.parameters
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
        certificate=_certificate(model, regression, constraints, links, settled),
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


def _certificate(
    model: TorqueModel,
    regression: Regression,
    constraints: Sequence[Constraint],
    links: tuple[LinkCondition, ...],
    settled: Settled,
) -> Certificate:
    poses = random_poses(model, POSES, _SEED)
    least = least_mass_eigenvalue(model, settled.parameters, poses)
    violation = lowered(constraints, model).violation(settled.parameters)
    figures = {
        "violation in original units": violation,
        **_gaps(settled),
        f"least eigenvalue of M(q) over {POSES} poses": least,
        **_by_joint_and_link(regression, links, settled),
    }
    bodies = any(isinstance(c, PhysicalConsistency) for c in constraints)
    if bodies and least <= 0.0:
        reason = (
            f"{settled.proven}; but the mass matrix has an eigenvalue of {least:.3g}: "
            "constrain rotor inertia with NonNegativeDrive"
        )
        return Certificate("uncertified", reason, figures)
    if settled.certified:
        return Certificate("certified", settled.proven, figures)
    reason = (
        f"{settled.proven} (allowed: {GAP_TOLERANCE:.0e} of the final estimate, "
        f"{DISTANCE_GAP:.0e}, {SLACK_GAP:.0e} and {FEASIBILITY_TOLERANCE:.0e}); the "
        "estimate is usable only as far as these figures say"
    )
    return Certificate("uncertified", reason, figures)


def _gaps(settled: Settled) -> dict[str, float]:
    fit, final = settled.best.optimality, settled.fit.optimality
    return {
        "fit: relative gap": fit.gap,
        "fit: violation": fit.violation,
        "prior: relative gap": final.gap,
        "prior: relative gap of the squared distance": settled.share,
        "prior: violation": final.violation,
        "slack": settled.slack,
        "slack: relative uncertainty": settled.unsure,
        "weight of the prior": settled.fit.weight,
    }


def _by_joint_and_link(
    regression: Regression, links: tuple[LinkCondition, ...], settled: Settled
) -> dict[str, float]:
    rms = regression.residual_rms(settled.parameters)
    residuals = {
        f"RMS residual of {joint}": float(value)
        for joint, value in zip(regression.joints, rms, strict=True)
    }
    return residuals | {
        f"least eigenvalue of J of {link.link}, per typical link": link.least_eigenvalue
        for link in links
    }
