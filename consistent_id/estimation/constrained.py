"""The best fit among physically consistent parameters.

In the standard parameters from the start, because that is where consistency lives:

1. the least weighted misfit ``||R x - z||`` over the constraints;
2. among all constrained ``x`` whose misfit is within a slack of it, the one nearest to
   the nominal robot.  What the data do not determine, the prior does, and not the
   solver by chance.

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
)
from consistent_id.constraints.priors import Prior
from consistent_id.estimation.audit import FitProblem, audited
from consistent_id.estimation.constrained_fit import constrained_fit
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.method import Method
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel

DEFAULT_CONSTRAINTS: tuple[Constraint, ...] = (
    PhysicalConsistency(),
    FixedMasses(),
    NonNegativeDrive(),
)
"""Links physically consistent, masses of the datasheet, friction that dissipates."""


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
        Chooses among what fits alike; by default `PointToSet`.
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
    fitted = constrained_fit(model, regression, constraints, prior, base)
    return audited(
        FitProblem(model, regression, constraints, base),
        fitted.best.scaled,
        fitted.parameters,
        fitted.proof,
        method=method,
        note=fitted.note,
        started=started,
    )
