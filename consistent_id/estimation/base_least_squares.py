"""Least squares on base parameters: the paper's eq. (6), without forming Y^T Y.

With ``Y = Q R``, ``(Y^T Y)^-1 Y^T tau = R^-1 Q^T tau`` for full rank.  Where
combinations are not identifiable from the data, that inverse does not exist.  The
result is then the smallest base vector among all that fit best, with a note.
"""

from dataclasses import replace
from time import perf_counter

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.given_values import require_type
from consistent_id.constraints.cones.certificate import Certificate
from consistent_id.estimation.determination import determined
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.fit import fit_of
from consistent_id.estimation.method import Method
from consistent_id.regression.base import (
    BaseParameters,
    base_parameters,
    open_combinations,
    require_match,
)
from consistent_id.regression.linear import LinearSolution
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import (
    ResidualNoise,
    UnconstrainedFit,
    joint_noise,
    unconstrained_fit,
)

_STATIONARITY = 1e-9


@single_threaded
def least_squares(
    model: TorqueModel,
    regression: Regression,
    *,
    base: BaseParameters | None = None,
    method: str = Method.LEAST_SQUARES,
) -> Estimate:
    """Estimate base parameters by least squares; weighted if the regression is.

    Parameters
    ----------
    model : TorqueModel
    regression : Regression
        Its `sigma` are the weights.
    base : BaseParameters, optional
        By default `base_parameters(model)`.
    method : str
        Name of the estimate's method.

    Returns
    -------
    Estimate
        The standard parameters are the smallest vector with the estimated base
        parameters; only the base parameters are estimated.

    Raises
    ------
    NotExcitedError
        If the data excite no parameter.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True))
    >>> q, dq, ddq = np.random.default_rng(0).normal(size=(3, 200, 1))
    >>> motion = ci.Recording(("joint1",), np.arange(200) / 100, q, dq, ddq)
    >>> body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]  # kg, kg m, kg m^2
    >>> log = ci.simulate_torque(model, [*body, 0.4], motion)
    >>> regression = ci.build_regression(model, log)
    >>> plain = ci.least_squares(model, regression)
    >>> round(plain["joint1.viscous"], 6), len(plain.base)
    (0.4, 4)
    """
    started = perf_counter()
    require_type(model, TorqueModel, "model")
    require_type(regression, Regression, "regression")
    base = base_parameters(model) if base is None else base
    require_match(model, regression, base)
    free = unconstrained_fit(regression, base)
    estimate = unconstrained_estimate(model, free, data=free, method=method)
    return replace(estimate, seconds=perf_counter() - started)


@single_threaded
def unconstrained_estimate(
    model: TorqueModel, free: UnconstrainedFit, *, data: UnconstrainedFit, method: str
) -> Estimate:
    """Return the estimate of `least_squares` of a fit made before.

    Parameters
    ----------
    free : UnconstrainedFit
    data : UnconstrainedFit
        Least squares on the rows in which errors are measured: those of `free`, unless
        a method weighs single samples.
    """
    started = perf_counter()
    regression, base, solution = free.regression, free.base, free.solution
    R, parameters = regression.stacked(), free.parameters
    redundant = sum(regression.counts) > solution.rank
    known, notes = np.zeros((0, len(model.layout))), _notes(model, free)
    found_by = determined(model, free, known, parameters, elsewhere="convention")
    A, b = R[:, list(base.independent)], R[:, -1]
    return Estimate(
        method=method,
        model=model,
        base=base,
        parameters=parameters,
        base_covariance=_covariance(free.noise, solution) if redundant else None,
        origins=found_by.origins,
        undetermined=open_combinations(solution, base.names),
        sigma=free.sigma,
        certificate=stationarity_certificate(A, b, solution),
        notes=notes,
        seconds=perf_counter() - started,
        fit=fit_of(model, data, parameters),
        parameter_errors=found_by.errors if redundant else None,
        parameter_quantiles=found_by.quantiles if redundant else None,
        base_quantiles=free.noise.quantiles if redundant else None,
    )


@single_threaded
def weighted_least_squares(
    model: TorqueModel,
    regression: Regression,
    *,
    base: BaseParameters | None = None,
) -> Estimate:
    """Estimate with each joint weighted by its own noise level, found by iteration.

    See `joint_noise` and `least_squares`.

    Parameters
    ----------
    model : TorqueModel
    regression : Regression
    base : BaseParameters, optional
    """
    started = perf_counter()
    base = base_parameters(model) if base is None else base
    weighted = regression.weighted(joint_noise(model, regression, base=base))
    estimate = least_squares(
        model, weighted, base=base, method=Method.WEIGHTED_LEAST_SQUARES
    )
    return replace(estimate, seconds=perf_counter() - started)


def _notes(model: TorqueModel, free: UnconstrainedFit) -> tuple[str, ...]:
    """Return notes on the conditions under which values and errors are valid."""
    regression, base, solution = free.regression, free.base, free.solution
    notes = ["no more rows than parameters: noise and standard errors are unknown"]
    if sum(regression.counts) > solution.rank:
        notes = [free.noise.sentence]
        of_two_kinds = len(set(model.forces.tolist())) > 1
        if of_two_kinds and np.ptp(regression.sigma) == 0.0:
            notes.append(
                "rows in N m and in N have equal weight, regardless of their sizes; "
                "weighted_least_squares divides each joint's rows by its noise"
            )
    notes += base.near
    if solution.null_space.size:
        notes.append(
            f"the data determine {solution.rank} of {len(base)} base parameters; this "
            "is the smallest of all vectors that fit best"
        )
    return tuple(notes)


def _covariance(noise: ResidualNoise, solution: LinearSolution) -> Matrix:
    """Covariance of the estimate; infinite where parameters are not identifiable."""
    covariance = np.asarray(noise.steps @ noise.scatter @ noise.steps.T)
    open_ended = (abs(solution.null_space) > 1e-9).any(axis=1)
    covariance[open_ended, :] = covariance[:, open_ended] = np.nan
    covariance[open_ended, open_ended] = np.inf
    return covariance


def stationarity_certificate(
    A: Matrix, b: Vector, solution: LinearSolution
) -> Certificate:
    """Certify a least-squares solution by its vanishing gradient."""
    gradient = A.T @ (A @ solution.x - b)
    scale = np.linalg.norm(A, axis=0) * np.linalg.norm(b)
    left = float((abs(gradient) / np.where(scale > 0, scale, 1.0)).max())
    figures = {"stationarity": left, "rank": float(solution.rank)}
    if left <= _STATIONARITY:
        return Certificate(
            "certified",
            "the gradient vanishes: no parameters fit these data better",
            figures,
        )
    return Certificate("uncertified", "the gradient does not vanish", figures)
