"""Two independent methods for the best constrained fit, compared."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from smooth_fit import smooth_least_squares

from consistent_id.constraints import Constraint
from consistent_id.constraints.cones.certificate import OptimumVerdict
from consistent_id.estimation.best_fit import EXACT_FIT, best_fit
from consistent_id.estimation.constrained_fit import (
    DEFAULT_CONSTRAINTS,
)
from consistent_id.estimation.estimate import Estimate
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel

AHEAD = 1e-6
"""Relative misfit by which the smooth search may undercut a proven optimum."""

BEHIND = 1e-4
"""Relative misfit by which the smooth search may fall short of it."""


@dataclass(frozen=True, slots=True, eq=False)
class CrossCheck:
    """The best fit by the cone programme and by the smooth search.

    Parameters
    ----------
    cone_misfit, smooth_misfit : float
        ``||R x - z||`` of both, on the weighted regression.
    difference : float
        ``(smooth - cone) / cone``, with at least a millionth of the torque's norm in
        the denominator.
    cone_verdict : {"certified", "uncertified"}
        Verdict of the cone programme's optimum.
    smooth : Estimate
        The estimate of the smooth search, with its own certificate.
    """

    cone_misfit: float
    smooth_misfit: float
    difference: float
    cone_verdict: OptimumVerdict
    smooth: Estimate

    @property
    def agrees(self) -> bool:
        """Whether both misfits agree: a relative difference of -1e-6 to 1e-4.

        A lower misfit of the smooth search would prove an error of the cone programme.
        """
        return -AHEAD <= self.difference <= BEHIND


def cross_check(
    model: TorqueModel,
    regression: Regression,
    *,
    constraints: Sequence[Constraint] = DEFAULT_CONSTRAINTS,
    base: BaseParameters | None = None,
) -> CrossCheck:
    """Compute the best constrained fit in two independent ways, and compare.

    Parameters
    ----------
    model : TorqueModel
    regression : Regression
    constraints : sequence of Constraint
        Of the kinds that `smooth_least_squares` supports.
    base : BaseParameters, optional

    Raises
    ------
    ProblemError, InfeasibleError, NotExcitedError, SolverError
        See `smooth_least_squares` and `constrained_least_squares`.
    """
    base = base_parameters(model) if base is None else base
    smooth = smooth_least_squares(model, regression, constraints=constraints, base=base)
    cone = best_fit(model, regression, constraints, base=base)
    R = regression.stacked()
    misfits = [
        float(np.linalg.norm(R[:, :-1] @ x - R[:, -1]))
        for x in (cone.parameters, smooth.parameters)
    ]
    unit = max(misfits[0], EXACT_FIT * float(np.linalg.norm(R[:, -1])))
    return CrossCheck(
        cone_misfit=misfits[0],
        smooth_misfit=misfits[1],
        difference=(misfits[1] - misfits[0]) / unit,
        cone_verdict=cone.optimality.verdict,
        smooth=smooth,
    )
