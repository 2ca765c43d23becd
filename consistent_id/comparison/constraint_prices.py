"""The cost of each constraint: its shadow price, and the fit without it.

With ``E`` the misfit's norm over ``N`` rows and ``l`` the multiplier of ``a.x <= b``
for ``1/2 E^2``, the root-mean-square residual ``E / sqrt(N)`` changes by
``-l db / (E sqrt(N))`` when ``b`` does.  A constraint without a multiplier costs
nothing.  The others are left out, one at a time, and the best fit is computed again.
`constraint_costs` leaves out whole kinds of constraints.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.tables import brief
from consistent_id.constraints import Constraint
from consistent_id.constraints.cones.certificate import OptimumVerdict, solve_certified
from consistent_id.constraints.cones.least_norm import LeastNorm
from consistent_id.errors import SolverError
from consistent_id.estimation.best_fit import REFERENCE, BestFit, best_fit
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel

STEP = 0.01
"""Share of a typical mass, length or torque by which a constraint is tightened."""

_FREE = 1e-6  # price, relative to the residual, that counts as zero


@brief
@dataclass(frozen=True, slots=True)
class ShadowPrice:
    """The cost of one constraint, with all others in force.

    Parameters
    ----------
    label : str
    price : float, [N m or N], or in units of the joints' `sigma`
        Change of the root-mean-square residual if an equality's value rises by `STEP`
        of the typical size, or an inequality or a block is tightened by as much.
    cost : float, same unit
        Decrease of the residual if the constraint is left out.
    verdict : {"certified", "uncertified"}
        Verdict of the best fits behind the cost.
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
            pass  # the cost stays unknown
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
    # An exact fit has no slope; a millionth of the torque is used instead.
    return np.asarray(slopes * STEP / np.sqrt(max(_total(best, best.solution.u), 1.0)))


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
        Verdict of both optima.
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
    """Return the cost of each constraint, with all others in force.

    Costs do not add up: each of two equivalent constraints costs nothing.

    Parameters
    ----------
    model : TorqueModel
    regression : Regression
        Its `sigma` are the weights.
    constraints : sequence of Constraint
    base : BaseParameters, optional

    Raises
    ------
    InfeasibleError
        If no parameters satisfy all constraints together.
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
