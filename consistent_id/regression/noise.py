"""The noise of each joint's torque, from residuals of weighted least squares."""

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.threads import single_threaded
from consistent_id.errors import ProblemError
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.linear import solve_linear
from consistent_id.regression.regression import Regression, require_match
from consistent_id.regression.regressor import TorqueModel


@single_threaded
def joint_noise(
    model: TorqueModel,
    regression: Regression,
    *,
    base: BaseParameters | None = None,
    iterations: int = 10,
) -> Vector:
    """Return each joint's residual standard deviation at its own weighted solution.

    The maximum-likelihood weights of independent joints, by alternating least squares
    and residuals until they change by less than a thousandth.  A joint whose residual
    vanishes is given a millionth of its torque.
    """
    base = base_parameters(model) if base is None else base
    require_match(model, regression, base)
    if iterations < 1:
        raise ProblemError(f"iterations is {iterations}, expected 1 or more")
    floor = 1e-6 * np.maximum(regression.torque_rms, 1e-12)
    columns = list(base.independent)
    sigma = regression.sigma
    for _ in range(iterations):
        R = regression.weighted(sigma).stacked()
        solution = solve_linear(R[:, columns], R[:, -1])
        x = base.lift(solution.x)
        updated = np.maximum(residual_sigma(regression, x, solution.rank), floor)
        converged = np.all(abs(updated - sigma) <= 1e-3 * sigma)
        sigma = updated
        if converged:
            break
    return sigma


def residual_sigma(regression: Regression, x: Vector, rank: int) -> Vector:
    """Residual standard deviation of each joint, less the degrees of freedom spent.

    Of correlated noise a fit takes more: `rank` of the effective samples.
    """
    counts = np.array(regression.counts, dtype=np.float64)
    spent = rank / float(np.sum(counts / regression.correlation))
    if spent >= 1.0:
        return regression.residual_rms(x)
    return np.asarray(regression.residual_rms(x) / np.sqrt(1.0 - spent))
