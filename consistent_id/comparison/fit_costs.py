"""What does each constraint cost in fit?  The best fit again, leaving one out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.threads import single_threaded
from consistent_id.constraints import Constraint
from consistent_id.constraints.cones.certificate import OptimumVerdict
from consistent_id.estimation.best_fit import best_fit
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel


@dataclass(frozen=True, slots=True, eq=False)
class ConstraintCost:
    """Fit with all constraints, and without one of them.

    Parameters
    ----------
    constraint : Constraint
        The one left out.
    rms_with, rms_without : ndarray, shape (joints,), [N m or N]
        Root-mean-square residual of the best fits.
    increase : float
        Relative increase of the weighted misfit that the constraint causes; never
        negative, up to the certificates' gap.
    verdict : {"certified", "uncertified"}
        Of both optima.
    """

    constraint: Constraint
    rms_with: Vector
    rms_without: Vector
    increase: float
    verdict: OptimumVerdict

    @property
    def name(self) -> str:
        """Name of the constraint's class."""
        return type(self.constraint).__name__


@single_threaded
def constraint_costs(
    model: TorqueModel,
    regression: Regression,
    constraints: Sequence[Constraint],
    *,
    base: BaseParameters | None = None,
) -> tuple[ConstraintCost, ...]:
    """Return the cost of each constraint, the others held.

    Costs do not add up: two constraints that say the same cost nothing each.

    Raises
    ------
    InfeasibleError
        If all constraints together admit nothing.
    """
    base = base_parameters(model) if base is None else base
    whole = best_fit(model, regression, constraints, base=base)
    rms_with = regression.residual_rms(whole.parameters)
    misfit_with = _misfit(regression, rms_with)
    costs = []
    for i, left_out in enumerate(constraints):
        others = [*constraints[:i], *constraints[i + 1 :]]
        without = best_fit(model, regression, others, base=base)
        rms = regression.residual_rms(without.parameters)
        verdicts = {whole.optimality.verdict, without.optimality.verdict}
        costs.append(
            ConstraintCost(
                constraint=left_out,
                rms_with=rms_with,
                rms_without=rms,
                increase=misfit_with / _misfit(regression, rms) - 1.0,
                verdict="certified" if verdicts == {"certified"} else "uncertified",
            )
        )
    return tuple(costs)


def _misfit(regression: Regression, rms: Vector) -> float:
    counts = np.array(regression.counts)
    return float(np.sqrt(np.sum(counts * (rms / regression.sigma) ** 2)))
