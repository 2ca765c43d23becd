"""Least squares without constraints, and the noise in its residuals.

`joint_noise` finds weights; `unconstrained_fit` computes once what every estimate from
a regression is compared with.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.singular import pinv, singular_values, svd
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.regression.base import BaseParameters, base_parameters, require_match
from consistent_id.regression.linear import (
    DATA_RANK_TOLERANCE,
    LinearSolution,
    solve_linear,
    triangle,
)
from consistent_id.regression.model_errors import BLOCKS
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel

_EXACT = 1e-6  # residual, relative to the torque, that counts as none
_FEW = 3.0  # spare effective samples for each parameter, below which errors are rough
_SHOWN = 1.1  # ratio of variances from which errors of the model are stated
_WIDE = 2.05  # standard errors of a 95 % interval from which they are stated
WHITE = 1.5  # samples of correlation up to which noise is called white

NORMAL = 1.96
"""Standard errors either way of a 95 % interval, if their size is known."""


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
    return noise_levels(regression, base, iterations=iterations)


@single_threaded
def noise_levels(
    regression: Regression, base: BaseParameters, *, iterations: int = 10
) -> Vector:
    """Return the noise of `joint_noise` for base parameters of the same model."""
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

    A fit absorbs more of correlated noise: `rank` of the effective samples.
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


@brief
class Scatter(NamedTuple):
    """A covariance, shape (rank, rank), and its degrees of freedom."""

    covariance: Matrix
    freedom: float


@brief
@dataclass(frozen=True, eq=False)
class ResidualNoise:
    """Noise of each joint, and the covariance of least squares under it.

    With ``A = Q D`` the weighted base regressor and ``Q`` orthonormal, a change of the
    base parameters by ``steps @ y`` raises the squared misfit by ``y^T y``, and least
    squares scatters ``y`` with the covariance `inflation` (the sandwich form): that of
    scores under correlated noise, see `CorrelatedNoise`, or under white noise of each
    joint's level.  It is about one where weights are right and noise is white.

    Parameters
    ----------
    sigma : ndarray, shape (joints,), [N m or N]
        Standard deviation of each joint's residual.
    length : ndarray, shape (joints,)
        Samples that determine as much as one with white noise.
    effective : float
        Samples of white noise that determine as much as all samples.
    measured : bool
        Whether `length` comes from residuals; else noise is taken to be white.
    steps : ndarray, shape (base, rank)
    inflation : ndarray, shape (rank, rank)
    root : ndarray, shape (rank, rank)
        Triangular, ``root^T root = inflation``: keeps eigenvalues that squares lose.
    between : tuple of Scatter
        Covariance of ``y`` that is added: by errors of the model, see
        `CorrelatedNoise`, or by scatter between recordings, by kind of parameter, see
        `RecordingScatter`.
    level_freedom : ndarray, shape (joints,)
        Degrees of freedom of `level`; see `CorrelatedNoise.freedom`.
    of_joints : tuple of ndarray, each shape (rows, rank)
        ``N_j`` of each joint, with ``inflation = sum_j N_j^T N_j``.
    beyond : float
        Variance with errors of the model over that by noise; see `CorrelatedNoise`.
        One where scatter between recordings contains it.
    shapes : ndarray, shape (shapes, rank), optional
        Like the rows of `root`, for errors that samples share, see `CorrelatedNoise`.
        They are not in `inflation`.
    """

    sigma: Vector
    length: Vector
    effective: float
    measured: bool
    steps: Matrix
    inflation: Matrix
    root: Matrix
    level_freedom: Vector
    of_joints: tuple[Matrix, ...]
    between: tuple[Scatter, ...] = ()
    beyond: float = 1.0
    shapes: Matrix | None = None

    @property
    def rank(self) -> int:
        """Number of combinations of base parameters that the data determine."""
        return len(self.inflation)

    @cached_property
    def coordinates(self) -> Matrix:
        """The map from a change of the base parameters to ``y``; it undoes `steps`.

        Shape (rank, base).
        """
        square = self.steps.shape[0] == self.steps.shape[1]
        inverse = np.linalg.inv if square else pinv
        return np.asarray(inverse(self.steps))

    @property
    def freedom(self) -> float:
        """Degrees of freedom of `sigma`: effective samples less those spent."""
        return self.effective - self.rank

    @property
    def level(self) -> Vector:
        """White noise that does as much to parameters as each joint's, [N m or N]."""
        return np.asarray(self.sigma * np.sqrt(self.length))

    @property
    def one_error(self) -> float:
        """Squared misfit within which nothing moves by more than a standard error.

        The least eigenvalue of `inflation`: ``y^T inflation^-1 y <= 1`` for every ``y``
        with ``y^T y`` up to it.
        """
        return float(singular_values(self.root)[-1]) ** 2

    def errors(self, y: Vector) -> float:
        """Return by how many standard errors ``y`` moves all parameters together."""
        return float(np.linalg.norm(np.linalg.solve(self.root.T, y)))

    @property
    def scatter(self) -> Matrix:
        """Covariance of ``y`` by noise and other scatter, shape (rank, rank)."""
        added = [part.covariance for part in self.between]
        if self.shapes is not None:
            added.append(self.shapes.T @ self.shapes)
        return np.asarray(sum(added, self.inflation))

    def freedoms(self, functionals: Matrix) -> Vector:
        """Return the degrees of freedom of each functional's standard error.

        Parameters
        ----------
        functionals : ndarray, shape (rows, base)
            See `freedoms_along`.
        """
        return self.freedoms_along(functionals @ self.steps)

    def freedoms_along(self, G: Matrix) -> Vector:
        """Return the degrees of freedom of the standard error of each ``g^T y``.

        Those of noise and of scatter between recordings, combined [Satterthwaite1946]_.
        For noise they are those of the joints, by their shares in the variance: a
        parameter depends mostly on the noise of a few joints, which is estimated from
        their own residuals at the motion's few frequencies.

        Parameters
        ----------
        G : ndarray, shape (rows, rank)
        """
        parts = [
            (np.sum(np.square(G @ own.T), axis=1), freedom)
            for own, freedom in zip(self.of_joints, self.level_freedom, strict=True)
        ]
        parts += [
            (np.einsum("ij,jk,ik->i", G, covariance, G), freedom)
            for covariance, freedom in self.between
        ]
        if self.shapes is not None:
            parts.append((np.sum(np.square(G @ self.shapes.T), axis=1), np.inf))
        total = np.sum([variance for variance, _ in parts], axis=0)
        squares = np.sum([variance**2 / freedom for variance, freedom in parts], axis=0)
        touched = squares > np.finfo(np.float64).tiny
        combined = total**2 / np.where(touched, squares, 1.0)
        untouched = float(np.mean(self.level_freedom))
        return np.asarray(np.where(touched, np.maximum(combined, 1.0), untouched))

    @cached_property
    def quantiles(self) -> Vector:
        """Standard errors either way of a 95 % interval, shape (base,).

        Student's quantiles for the degrees of freedom of each base parameter.
        """
        return half_widths(self.freedoms(np.eye(len(self.steps))))

    def with_freedom(self, freedom: float) -> "ResidualNoise":
        """Return the same noise, its whole covariance with these degrees of freedom."""
        return replace(self, of_joints=(self.root,), level_freedom=np.array([freedom]))

    def white(self, regression: Regression, base: BaseParameters) -> "ResidualNoise":
        """Return white noise of each joint's `level` in its place."""
        columns = list(base.independent)
        rows = zip(regression.factors, regression.sigma, self.level, strict=True)
        parts = tuple(
            level / weight**2 * _product(factor[:, columns], self.steps)
            for factor, weight, level in rows
        )
        root = triangle(np.asfortranarray(np.vstack(parts)))
        return replace(self, inflation=root.T @ root, root=root, of_joints=parts)

    def squared_misfit(self, functionals: Matrix) -> Vector:
        """Return the squared misfit of one standard error of each functional.

        Moving ``f @ base`` by one standard error with all others free raises the
        squared misfit of least squares by one under right weights and white noise, and
        by ``(f S K S^T f) / (f S S^T f)`` in general, ``S`` the steps and ``K`` the
        `scatter`.  For a functional that the data do not touch, the mean is returned.

        Parameters
        ----------
        functionals : ndarray, shape (rows, base)
        """
        G = functionals @ self.steps
        norms = np.sum(G**2, axis=1)
        raised = np.einsum("ij,jk,ik->i", G, self.scatter, G)
        mean = np.trace(self.scatter) / self.rank
        touched = norms > np.finfo(np.float64).tiny
        ratios = raised / np.where(touched, norms, 1.0)
        return np.asarray(np.where(touched, ratios, mean))

    @property
    def sentence(self) -> str:
        """The basis of the standard errors, in words."""
        if not self.measured:
            return (
                "standard errors are for white noise: no residuals were at hand; on "
                "recordings, build_regression finds how noise is correlated"
            )
        least, most = float(self.length.min()), float(self.length.max())
        more = (
            f"; they are {np.sqrt(self.beyond):.1f} times as large again, because "
            "errors of the model move parameters by more than noise"
            if self.beyond > _SHOWN
            else ""
        )
        width = width_text(self.quantiles)
        more += f"; {width}" if width else ""
        if most <= WHITE:
            return (
                f"residuals are white: standard errors are those of white noise{more}"
            )
        lengths = _span(least, most, ".0f")
        factors = _span(np.sqrt(least), np.sqrt(most), ".1f")
        few = (
            f"; there are only {self.effective:.0f} effective samples for {self.rank} "
            "parameters, so that errors are rough"
            if self.freedom < _FEW * self.rank
            else ""
        )
        return (
            f"residuals are correlated over {lengths} samples, depending on the joint: "
            f"standard errors are {factors} times those of white noise{more}{few}"
        )


def half_widths(freedoms: Vector) -> Vector:
    """Return half of 95 % intervals in standard errors: Student's quantiles."""
    from scipy.special import stdtrit  # scipy.stats takes a second to import

    return np.asarray(stdtrit(freedoms, 0.975))


def width_text(quantiles: Vector) -> str:
    """Describe 95 % intervals that are wider than those of known errors, else empty."""
    width = float(np.median(quantiles)) if len(quantiles) else NORMAL
    if width < _WIDE:
        return ""
    return (
        f"a 95 % interval is {width:.1f} standard errors either way (median), as their "
        "size is an estimate, too"
    )


@brief
@dataclass(frozen=True, slots=True, eq=False)
class UnconstrainedFit:
    """Least squares on a regression, and the noise in its residuals.

    Parameters
    ----------
    regression : Regression
    base : BaseParameters
    solution : LinearSolution
        The base parameters, and their null space.
    parameters : ndarray, shape (parameters,)
        The smallest vector with these base parameters.
    sigma : ndarray, shape (joints,), [N m or N]
        See `residual_sigma`.
    noise : ResidualNoise
    """

    regression: Regression
    base: BaseParameters
    solution: LinearSolution
    parameters: Vector
    sigma: Vector
    noise: ResidualNoise


@lru_cache(maxsize=8)
def unconstrained_fit(regression: Regression, base: BaseParameters) -> UnconstrainedFit:
    """Fit base parameters by weighted least squares, and find the residuals' noise.

    Raises
    ------
    NotExcitedError
        If the data excite nothing.
    """
    columns = list(base.independent)
    R, solution = regression.stacked(), base_solution(regression, base)
    parameters = base.lift(solution.x)
    sigma = residual_sigma(regression, parameters, solution.rank)
    floor = _EXACT * np.maximum(regression.torque_rms, 1e-12)
    steps, length = _steps(R[:, columns], solution), regression.correlation
    parts, shapes = [], None
    for j, (factor, weight) in enumerate(
        zip(regression.factors, regression.sigma, strict=True)
    ):
        rows = _product(factor[:, columns], steps) / weight**2
        scores = sigma[j] * rows
        if regression.noise is not None:
            own = regression.noise.scores[j][:, columns]
            scores = _product(own, steps) / weight**2
        parts.append(np.vstack([scores, floor[j] * rows]))
    root = triangle(np.asfortranarray(np.vstack(parts)))
    if regression.noise is not None and regression.noise.shapes:
        of_joints = zip(regression.noise.shapes, regression.sigma, strict=True)
        shared = sum(own[:, columns] / weight**2 for own, weight in of_joints)
        shapes = _product(np.asarray(shared), steps)
    inflation, between, beyond = root.T @ root, tuple[Scatter, ...](), 1.0
    if regression.noise is not None and regression.noise.beyond > 1.0:
        added = (regression.noise.beyond - 1.0) * inflation
        between = (Scatter(added, BLOCKS - 1.0),)
        beyond = regression.noise.beyond
    effective = float(np.sum(regression.effective))
    white = np.maximum(regression.effective * (1.0 - solution.rank / effective), 1.0)
    noise = ResidualNoise(
        sigma=np.maximum(sigma, floor),
        length=length,
        effective=effective,
        measured=regression.noise is not None,
        steps=steps,
        inflation=inflation,
        root=root,
        level_freedom=white if regression.noise is None else regression.noise.freedom,
        of_joints=tuple(parts),
        between=between,
        beyond=beyond,
        shapes=shapes,
    )
    return UnconstrainedFit(regression, base, solution, parameters, sigma, noise)


def _product(rows: Matrix, steps: Matrix) -> Matrix:
    """Return ``rows @ steps``; most columns of one joint's rows are zero."""
    used = rows.any(axis=0)
    return np.asarray(rows[:, used] @ steps[used])


def _steps(A: Matrix, solution: LinearSolution) -> Matrix:
    """Return ``S`` with ``S^T A^T A S = 1`` that spans what the rows determine."""
    norms = np.linalg.norm(A, axis=0)
    if norms.min() > DATA_RANK_TOLERANCE * norms.max():
        return solution.steps
    unit = np.where(norms > DATA_RANK_TOLERANCE * norms.max(), norms, np.inf)
    _, s, Vt = svd(A / unit, full_matrices=False)
    rank = int((s > DATA_RANK_TOLERANCE * s[0]).sum())
    return np.asarray((Vt[:rank].T / s[:rank]) / unit[:, None])


def _span(least: float, most: float, form: str) -> str:
    low, high = f"{least:{form}}", f"{most:{form}}"
    return low if low == high else f"{low} to {high}"
