"""Shadow prices: what each constraint costs in torque, and the fit without it.

With ``E`` the misfit's norm over ``N`` rows and ``l`` the multiplier of ``a.x <= b``
for ``1/2 E^2``, the root-mean-square residual ``E / sqrt(N)`` changes by
``-l db / (E sqrt(N))`` when ``b`` does.  A constraint without a multiplier costs
nothing; the others are left out, one at a time, and the best fit is computed again.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.threads import single_threaded
from consistent_id.constraints import Constraint
from consistent_id.constraints.cones.certificate import OptimumVerdict, solve_certified
from consistent_id.constraints.cones.least_norm import LeastNorm
from consistent_id.errors import SolverError
from consistent_id.estimation.best_fit import BestFit, best_fit
from consistent_id.estimation.scaled_fit import REFERENCE
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel

STEP = 0.01
"""Share of a typical mass, length or torque by which a constraint is tightened."""

_FREE = 1e-6  # price, relative to the residual, that is none


@dataclass(frozen=True, slots=True)
class ShadowPrice:
    """The cost of one constraint, the others held.

    Parameters
    ----------
    label : str
    price : float, [N m or N], or in units of the joints' `sigma`
        Change of the root-mean-square residual if an equality's value, or what an
        inequality or a block asks for, rose by `STEP` of what is typical.
    cost : float, same unit
        What the residual falls by when the constraint is left out altogether.
    verdict : {"certified", "uncertified"}
        Of the best fits behind the cost.
    """

    label: str
    price: float
    cost: float
    verdict: OptimumVerdict


@single_threaded
def shadow_prices(
    model: TorqueModel,
    regression: Regression,
    constraints: Sequence[Constraint],
    *,
    base: BaseParameters | None = None,
) -> tuple[ShadowPrice, ...]:
    """Return the shadow prices that are not zero, the largest cost first.

    Parameters
    ----------
    model : TorqueModel
    regression : Regression
        Its `sigma` are the weights.
    constraints : sequence of Constraint
    base : BaseParameters, optional

    Raises
    ------
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    base = base_parameters(model) if base is None else base
    best = best_fit(model, regression, constraints, base=base)
    scaled = best.scaled
    unit = scaled.size / np.sqrt(sum(regression.counts))
    rms = unit * np.sqrt(_total(best, best.solution.u))
    prices = unit * _prices(best)
    found = []
    for member, price in enumerate(prices):
        if abs(price) <= _FREE * max(rms, unit):
            continue
        problem = LeastNorm(scaled.M, scaled.z, scaled.domain.without(member))
        cost = np.nan
        verdict: OptimumVerdict = "uncertified"
        try:
            solution, optimality = solve_certified(
                problem, scaled.centre, reference=REFERENCE
            )
        except SolverError:
            pass  # the cost stays unknown, and says so
        else:
            cost = max(rms - unit * np.sqrt(_total(best, solution.u)), 0.0)
            verdicts = {best.optimality.verdict, optimality.verdict}
            verdict = "certified" if verdicts == {"certified"} else "uncertified"
        label = scaled.domain.labels[member]
        found.append(ShadowPrice(label, float(price), float(cost), verdict))
    return tuple(sorted(found, key=lambda p: -np.nan_to_num(p.cost, nan=np.inf)))


def _total(best: BestFit, u: Vector) -> float:
    return best.scaled.excess(u) + best.scaled.residual**2


def _prices(best: BestFit) -> Vector:
    """Return changes of the scaled misfit by `STEP`, in the order of labels."""
    multipliers = best.solution.multipliers
    slopes = np.concatenate(
        [
            -multipliers.equal,
            multipliers.at_most,
            [float(np.trace(Z)) for Z in multipliers.blocks],
        ]
    )
    # An exact fit has no slope; a millionth of the torque stands in for it.
    return np.asarray(slopes * STEP / np.sqrt(max(_total(best, best.solution.u), 1.0)))
