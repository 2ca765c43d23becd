"""The noise of each joint's torque, from residuals of weighted least squares."""

from functools import lru_cache

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.threads import single_threaded
from consistent_id.errors import ProblemError
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.linear import LinearSolution, solve_linear
from consistent_id.regression.regression import Regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.same_model import require_match


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
    counts = np.array(regression.counts, dtype=np.float64)
    columns = [*base.independent, -1]
    factors = [factor[:, columns] for factor in regression.factors]
    effective = _effective(regression)
    sigma, rank = regression.sigma, 0
    for _ in range(iterations):
        rows = [factor / s for factor, s in zip(factors, sigma, strict=True)]
        R = triangle(np.asfortranarray(np.vstack(rows)))
        if rank == len(base):  # as before: weights are positive
            x = _solved(R)
        else:
            solution = solve_linear(R[:, :-1], R[:, -1])
            x, rank = solution.x, solution.rank
        norms = [np.linalg.norm(factor @ np.append(x, -1.0)) for factor in factors]
        rms = np.array(norms) / np.sqrt(counts)
        updated = np.maximum(_less_freedom(rms, rank, effective), floor)
        converged = np.all(abs(updated - sigma) <= 1e-3 * sigma)
        sigma = updated
        if converged:
            break
    return sigma


@lru_cache(maxsize=8)
def base_solution(regression: Regression, base: BaseParameters) -> LinearSolution:
    """Return the base parameters of weighted least squares, and their null space.

    Raises
    ------
    NotExcitedError
        If the data excite nothing.
    """
    R = regression.stacked()
    return solve_linear(R[:, list(base.independent)], R[:, -1])


def residual_sigma(regression: Regression, x: Vector, rank: int) -> Vector:
    """Residual standard deviation of each joint, less the degrees of freedom spent.

    Of correlated noise a fit takes more: `rank` of the effective samples.
    """
    return _less_freedom(regression.residual_rms(x), rank, _effective(regression))


def _effective(regression: Regression) -> Vector:
    """Return the samples of white noise that determine as much, of each joint."""
    return np.asarray(np.array(regression.counts) / regression.correlation)


def _less_freedom(rms: Vector, rank: int, effective: Vector) -> Vector:
    spent = rank / float(effective.sum())
    return rms if spent >= 1.0 else np.asarray(rms / np.sqrt(1.0 - spent))


def _solved(R: Matrix) -> Vector:
    """Return the least-squares solution of a factor of full rank, torque last."""
    from scipy.linalg import solve_triangular

    n = R.shape[1] - 1
    return np.asarray(solve_triangular(R[:n, :n], R[:n, n]))
