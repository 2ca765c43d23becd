"""Least squares on base parameters: the paper's eq. (6), without forming Y^T Y.

With ``Y = Q R``, ``(Y^T Y)^-1 Y^T tau = R^-1 Q^T tau`` for full rank.  Where the data
leave combinations open, that inverse does not exist; the answer is then the smallest
base vector among all that fit best, and says so.
"""

from dataclasses import dataclass, replace
from itertools import permutations
from time import perf_counter

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.threads import single_threaded
from consistent_id.errors import NotExcitedError, ProblemError
from consistent_id.estimation.estimate import Certificate, Estimate
from consistent_id.estimation.method import Method
from consistent_id.regression.base import (
    BaseParameters,
    base_parameters,
    linear_combination,
    parameter_origins,
)
from consistent_id.regression.regression import Regression, require_match
from consistent_id.regression.regressor import TorqueModel

DATA_RANK_TOLERANCE = 1e-10
"""Singular values of the unit-column regressor below this, relative to the largest,
count as zero: ten times beyond what rounding leaves of an exact zero."""

_SILENT = 1e-13  # norm of a column, relative to the largest, that is rounding alone
_STATIONARITY = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class LinearSolution:
    """Solution of ``min ||A x - b||`` with its rank and null space.

    Parameters
    ----------
    x : ndarray, shape (columns,)
        The smallest solution.
    pseudo_inverse : ndarray, shape (columns, rows)
        ``x = pseudo_inverse @ b``.
    null_space : ndarray, shape (columns, columns - rank)
        Directions that do not change ``A x``, in readable (reduced) form.
    row_space : ndarray, shape (rank, columns)
        Combinations that the rows determine.
    singular_values : ndarray
        Of the matrix with unit columns.
    """

    x: Vector
    pseudo_inverse: Matrix
    null_space: Matrix
    row_space: Matrix
    singular_values: Vector

    @property
    def rank(self) -> int:
        """Rank of the matrix."""
        return len(self.x) - int(self.null_space.shape[1])


def solve_linear(
    A: Matrix, b: Vector, *, tolerance: float = DATA_RANK_TOLERANCE
) -> LinearSolution:
    """Solve a least-squares problem; the smallest solution if rank is deficient.

    Rank is decided on unit columns, so it does not depend on units.
    """
    norms = np.linalg.norm(A, axis=0)
    if not norms.any():
        raise NotExcitedError("the regressor is zero: the motion excites no parameter")
    silent = norms <= _SILENT * norms.max()
    unit = np.where(silent, 1.0, norms)
    scaled = np.where(silent, 0.0, A / unit)
    U, s, Vt = np.linalg.svd(scaled, full_matrices=len(A) < A.shape[1])
    s = np.append(s, np.zeros(A.shape[1] - len(s)))
    rank = int((s > tolerance * s[0]).sum())
    inverse = (Vt[:rank].T / s[:rank]) @ U[:, :rank].T / unit[:, None]
    null = Vt[rank:].T / unit[:, None]
    if null.shape[1]:
        # The smallest solution has no part along the null space.
        basis, _ = np.linalg.qr(null)
        inverse = inverse - basis @ (basis.T @ inverse)
    return LinearSolution(inverse @ b, inverse, _readable(null), Vt[:rank] * unit, s)


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
        Name under which the estimate appears.

    Returns
    -------
    Estimate
        The standard parameters are the smallest vector with the estimated base
        parameters; only the latter mean something.

    Raises
    ------
    NotExcitedError
        If the data excite nothing.
    """
    started = perf_counter()
    base = base_parameters(model) if base is None else base
    require_match(model, regression, base)
    R = regression.stacked()
    A, b = R[:, list(base.independent)], R[:, -1]
    solution = solve_linear(A, b)
    parameters = base.lift(solution.x)
    sigma = residual_sigma(regression, parameters, solution.rank)
    redundant = sum(regression.counts) > solution.rank
    covariance = _covariance(regression, base, solution, sigma) if redundant else None
    undetermined = tuple(
        linear_combination(direction, base.names) for direction in solution.null_space.T
    )
    notes = ["standard errors are for white noise"]
    if not redundant:
        notes = ["no more rows than parameters: the noise is unknown, so are errors"]
    if undetermined:
        notes.append(
            f"the data determine {solution.rank} of {len(base)} base parameters; this "
            "is the smallest of all vectors that fit best"
        )
    return Estimate(
        method=method,
        model=model,
        base=base,
        parameters=parameters,
        base_covariance=covariance,
        origins=parameter_origins(
            solution.row_space @ base.projection,
            np.zeros((0, len(model.layout))),
            elsewhere="convention",
        ),
        undetermined=undetermined,
        sigma=sigma,
        certificate=stationarity_certificate(A, b, solution),
        notes=tuple(notes),
        seconds=perf_counter() - started,
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
    """
    started = perf_counter()
    base = base_parameters(model) if base is None else base
    weighted = regression.weighted(joint_noise(model, regression, base=base))
    estimate = least_squares(
        model, weighted, base=base, method=Method.WEIGHTED_LEAST_SQUARES
    )
    return replace(estimate, seconds=perf_counter() - started)


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
        settled = np.all(abs(updated - sigma) <= 1e-3 * sigma)
        sigma = updated
        if settled:
            break
    return sigma


def residual_sigma(regression: Regression, x: Vector, rank: int) -> Vector:
    """Residual standard deviation of each joint, less the degrees of freedom spent."""
    counts = np.array(regression.counts, dtype=np.float64)
    spent = rank / counts.sum()
    if spent >= 1.0:
        return regression.residual_rms(x)
    return np.asarray(regression.residual_rms(x) / np.sqrt(1.0 - spent))


def _covariance(
    regression: Regression,
    base: BaseParameters,
    solution: LinearSolution,
    sigma: Vector,
) -> Matrix:
    """Covariance of the estimate under each joint's own noise (the sandwich form)."""
    # x = A^+ b with A^+ = (A^T A)^+ A^T; joint j contributes (A^T A)^+ A_j^T.
    columns = list(base.independent)
    gram_inverse = solution.pseudo_inverse @ solution.pseudo_inverse.T
    noise = np.zeros((len(base), len(base)))
    for factor, weight, s in zip(
        regression.factors, regression.sigma, sigma, strict=True
    ):
        rows = (factor[:, columns] @ gram_inverse) * (s / weight**2)
        noise += rows.T @ rows
    open_ended = (abs(solution.null_space) > 1e-9).any(axis=1)
    noise[open_ended, :] = noise[:, open_ended] = np.nan
    noise[open_ended, open_ended] = np.inf
    return noise


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


def _readable(null: Matrix) -> Matrix:
    """Null space in sparse form, so that directions read as short combinations.

    From the reduced echelon form, directions are added to each other as long as that
    makes one shorter; the first entry of each is one.
    """
    if null.shape[1] == 0:
        return null
    from scipy.linalg import qr

    _, _, order = qr(null.T, mode="economic", pivoting=True)
    pivots = np.sort(order[: null.shape[1]])
    directions = [_cleaned(row) for row in (null @ np.linalg.inv(null[pivots])).T]
    shorter = True
    while shorter:
        shorter = False
        for i, j in permutations(range(len(directions)), 2):
            best = _shortest_sum(directions[i], directions[j])
            if np.count_nonzero(best) < np.count_nonzero(directions[i]):
                directions[i], shorter = best, True
    return np.column_stack([row / row[np.flatnonzero(row)[0]] for row in directions])


def _shortest_sum(v: Vector, w: Vector) -> Vector:
    """Of ``v`` less a multiple of ``w``, the one with the fewest entries."""
    both = np.flatnonzero((v != 0.0) & (w != 0.0))
    sums = [_cleaned(v - v[e] / w[e] * w) for e in both]
    return min(sums, key=np.count_nonzero, default=v)


def _cleaned(row: Vector) -> Vector:
    nearest = np.round(row)
    return np.asarray(np.where(abs(row - nearest) < 1e-7, nearest, row))
