"""The least misfit that constraints allow, certified."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.threads import single_threaded
from consistent_id.constraints import Constraint
from consistent_id.constraints.cones.certificate import (
    FEASIBILITY_TOLERANCE,
    GAP_TOLERANCE,
    Optimality,
    solve_certified,
)
from consistent_id.constraints.cones.feasibility import irreducible_conflict
from consistent_id.constraints.cones.least_norm import ConeSolution, LeastNorm
from consistent_id.errors import InfeasibleError, SolverError
from consistent_id.estimation.scaled_fit import REFERENCE, ScaledFit, scaled_fit
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel

_USABLE = 1e-5  # violation beyond which a point is no answer at all


@dataclass(frozen=True, slots=True, eq=False)
class BestFit:
    """The best fit under constraints."""

    scaled: ScaledFit
    solution: ConeSolution
    optimality: Optimality

    @property
    def parameters(self) -> Vector:
        """The best fitting parameters, in original units; open ones as they fell."""
        return self.solution.u * self.scaled.unit

    @property
    def misfit(self) -> float:
        """Norm of the whole misfit, in the units of the regression's rows."""
        excess = self.scaled.excess(self.solution.u)
        return self.scaled.size * float(np.sqrt(excess + self.scaled.residual**2))


@single_threaded
def best_fit(
    model: TorqueModel,
    regression: Regression,
    constraints: Sequence[Constraint],
    *,
    base: BaseParameters,
    gap: float = GAP_TOLERANCE,
) -> BestFit:
    """Return the least weighted misfit over the constraints, certified.

    With a larger relative `gap` of the squared misfit it is certified to that.

    Raises
    ------
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    scaled = scaled_fit(model, regression, base, constraints)
    return BestFit(scaled, *solved(scaled.problem, scaled.centre, gap=gap))


def solved(
    problem: LeastNorm,
    centre: Vector,
    *,
    reach: float = 0.0,
    gap: float = GAP_TOLERANCE,
) -> tuple[ConeSolution, Optimality]:
    """Solve and certify; when nothing comes of it, ask if a solution can exist."""
    found = None
    try:
        found = solution, optimality = solve_certified(
            problem, centre, reference=REFERENCE, reach=reach, gap=gap
        )
    except SolverError as failure:
        reason = str(failure)
    else:
        if optimality.violation <= FEASIBILITY_TOLERANCE:
            return solution, optimality
        reason = f"the best point violates constraints by {optimality.violation:.1e}"
    members = irreducible_conflict(problem.domain)
    if members:
        labels = "; ".join(problem.domain.labels[m] for m in members)
        raise InfeasibleError(
            f"no parameters satisfy these together: {labels}. Loosen one of them, or "
            "check the datasheet values and the margin"
        )
    if found is not None and found[1].violation <= _USABLE:
        return found
    raise SolverError(
        "no usable optimum, though no contradiction in the constraints was proven: "
        f"{reason}"
    )
