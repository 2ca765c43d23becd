"""Iteratively reweighted least squares with Huber's loss."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.given_values import require_type
from consistent_id._support.singular import lstsq
from consistent_id.constraints.cones.certificate import Certificate
from consistent_id.errors import ProblemError
from consistent_id.estimation.base_least_squares import unconstrained_estimate
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.method import Method
from consistent_id.recordings.recording import Recording, several
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.correlated_noise import scores_along
from consistent_id.regression.linear import solve_linear
from consistent_id.regression.motion_arrays import Motion
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regression import Regression, build_regression, reweighted
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import (
    UnconstrainedFit,
    base_solution,
    joint_noise,
    unconstrained_fit,
)

HUBER_K = 1.345
"""Residuals beyond this many standard deviations count linearly; 95 % efficient for
Gaussian noise [Huber1981]_."""

_MAD = 1.4826  # standard deviation of a Gaussian over its median absolute deviation
_ALIKE = 1e-8  # difference of steps, relative to the largest, that counts as zero
_GROWN = 2.0  # growth of a step from which the mixing restarts
_MEMORY = 3  # earlier steps used to accelerate each step: 2 to 8 give the same speed


@single_threaded
def huber(
    model: TorqueModel,
    recordings: Recording | Sequence[Recording],
    *,
    k: float = HUBER_K,
    base: BaseParameters | None = None,
    iterations: int = 30,
    tolerance: float = 1e-4,
    regression: Regression | None = None,
) -> Estimate:
    """Estimate with Huber's loss: outliers have bounded influence.

    Each joint's scale is the normalised median absolute residual; samples are weighted
    by ``min(1, k scale / |residual|)``.  The recordings are streamed once per
    iteration, and no regressor is kept.  Anderson's mixing of the last steps halves
    the iterations [WalkerNi2011]_.

    Parameters
    ----------
    model : TorqueModel
    recordings : Recording or sequence of Recording
    k : float
    base : BaseParameters, optional
    iterations : int
    tolerance : float
        Change of predicted torque, relative to each joint's scale, at which to stop.
    regression : Regression, optional
        Regression of the recordings, with its noise, if it is at hand.

    Returns
    -------
    Estimate
        Certified when the iteration has converged.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True))
    >>> q, dq, ddq = np.random.default_rng(0).normal(size=(3, 200, 1))
    >>> motion = ci.Recording(("joint1",), np.arange(200) / 100, q, dq, ddq)
    >>> body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]  # kg, kg m, kg m^2
    >>> log = ci.simulate_torque(model, [*body, 0.4], motion)
    >>> round(ci.huber(model, log)["joint1.viscous"], 6)
    0.4
    """
    started, rules = perf_counter(), HuberRules(k, iterations, tolerance)
    require_type(model, TorqueModel, "model")
    base = base_parameters(model) if base is None else base
    plain = build_regression(model, recordings) if regression is None else regression
    sigma = joint_noise(model, plain, base=base)
    start = base_solution(plain.weighted(sigma), base).x
    estimate = huber_estimate(
        model, several(recordings), unconstrained_fit(plain, base), start, rules
    )
    return replace(estimate, seconds=perf_counter() - started)


@dataclass(frozen=True, slots=True)
class HuberRules:
    """The bend of the loss, and the limit of iterations; see `huber`.

    Raises
    ------
    ProblemError
        If the loss does not bend, or there is no iteration.
    """

    k: float = HUBER_K
    iterations: int = 30
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        if not 0.0 < self.k < np.inf:
            raise ProblemError(
                f"k is {self.k}, expected a positive number of deviations"
            )
        if self.iterations < 1:
            raise ProblemError(f"iterations is {self.iterations}, expected 1 or more")


@single_threaded
def huber_estimate(
    model: TorqueModel,
    recordings: Sequence[Recording],
    plain: UnconstrainedFit,
    start: Vector,
    rules: HuberRules,
) -> Estimate:
    """Return the estimate of `huber` from fits made before.

    Parameters
    ----------
    plain : UnconstrainedFit
        Least squares on the recordings.
    start : ndarray, shape (base,)
        The base parameters to begin with: those of weighted least squares.
    """
    started, base = perf_counter(), plain.base
    motions = [motion_of(model, recording, None) for recording in recordings]
    reached = _settled(model, plain, motions, start, rules)
    scale, bound = reached.scale, rules.k * reached.scale
    final = reweighted(model, motions, reached.weights, noise=True).weighted(scale)
    fit = unconstrained_fit(final, base)
    estimate = unconstrained_estimate(model, fit, data=plain, method=Method.HUBER)
    return replace(
        estimate,
        sigma=scale,
        base_covariance=_covariance(model, plain, motions, reached.residuals, bound),
        parameter_errors=None,
        base_quantiles=None,
        certificate=_certificate(reached.change, rules.tolerance),
        notes=(f"Huber's loss, k = {rules.k:g}", *estimate.notes),
        seconds=perf_counter() - started,
    )


class _Reached(NamedTuple):
    """The end of the reweighting: each joint's scale, and each motion's rows."""

    scale: Vector
    weights: list[Array]
    residuals: list[Array]
    change: float


def _settled(
    model: TorqueModel,
    plain: UnconstrainedFit,
    motions: Sequence[Motion],
    x: Vector,
    rules: HuberRules,
) -> _Reached:
    """Reweight rows until convergence, starting from base parameters."""
    base, k = plain.base, rules.k
    floor = 1e-6 * np.maximum(plain.regression.torque_rms, 1e-12)
    counted = np.vstack([motion.counted for motion in motions])
    columns = list(base.independent)
    residuals = _residuals(model, base.lift(x), motions)
    change: float = np.inf
    steps: tuple[_ReweightingStep, ...] = ()
    for _ in range(rules.iterations):
        scale = np.maximum(_MAD * _medians(abs(np.vstack(residuals)), counted), floor)
        weights = [
            np.sqrt(np.minimum(1.0, k * scale / np.maximum(abs(r), 1e-300)))
            for r in residuals
        ]
        R = reweighted(model, motions, weights).weighted(scale).stacked()
        end = solve_linear(R[:, columns], R[:, -1]).x
        updated = _residuals(model, base.lift(end), motions)
        before, change = change, _largest_change(residuals, updated, scale)
        if change <= rules.tolerance:
            break
        kept = () if change > _GROWN * before else steps[-_MEMORY:]
        steps = (*kept, _ReweightingStep(x, end, updated))
        shares = _mixed(steps, R[:, columns])
        x = shares @ np.array([step.end for step in steps])
        # Residuals are affine in parameters, and shares add to one.
        of_motions = zip(*(step.residuals for step in steps), strict=True)
        residuals = [np.tensordot(shares, of_steps, axes=1) for of_steps in of_motions]
    return _Reached(scale, weights, updated, change)


class _ReweightingStep(NamedTuple):
    """Base parameters before a reweighting and after it, and their residuals."""

    start: Vector
    end: Vector
    residuals: list[Array]


def _mixed(steps: Sequence[_ReweightingStep], metric: Matrix) -> Vector:
    """Return the shares of the steps' ends in the next start: Anderson's mixing.

    Among all points that the last starts span, it chooses the one with the shortest
    step, if steps were linear; lengths are those of ``metric @ step``.
    """
    taken = np.array([step.end - step.start for step in steps]) @ metric.T
    back = lstsq(np.diff(taken, axis=0).T, taken[-1], _ALIKE)
    at_last = np.eye(len(steps))[-1]
    return np.asarray(at_last + np.append(back, 0.0) - np.append(0.0, back))


def _residuals(model: TorqueModel, x: Vector, motions: Sequence[Motion]) -> list[Array]:
    """Return the torque residuals of each motion."""
    return [m.torque - m.predicted(model, x) for m in motions]


def _largest_change(
    before: Sequence[Array], after: Sequence[Array], scale: Vector
) -> float:
    """Return the largest change of a residual, in units of its joint's scale."""
    pairs = zip(before, after, strict=True)
    return max(float((abs(new - old) / scale).max()) for old, new in pairs)


def _medians(values: Array, counted: BoolArray) -> Vector:
    """Return each column's median over the unmasked rows."""
    return np.array(
        [np.median(v[use]) for v, use in zip(values.T, counted.T, strict=True)]
    )


def _covariance(
    model: TorqueModel,
    plain: UnconstrainedFit,
    motions: Sequence[Motion],
    residuals: Sequence[Array],
    bound: Vector,
) -> Matrix | None:
    """Return the sandwich ``H^-1 G H^-1`` of Huber's estimate [Huber1981]_.

    With ``psi`` the residual cut at its bound, ``H`` counts the rows that are not cut,
    and ``G`` is the covariance of the scores ``Y^T psi``, from the spectrum of ``psi``;
    see `scores_along`.  None if the data do not determine all parameters.
    """
    psi = [np.clip(r, -bound, bound) for r in residuals]
    inside = np.mean(abs(np.vstack(residuals)) < bound, axis=0)
    columns = np.array(plain.base.independent)
    share = np.sqrt(inside) / bound
    factors = [F[:, columns] for F in plain.regression.factors]
    H = np.vstack([F * s for F, s in zip(factors, share, strict=True)])
    solution = solve_linear(H, np.zeros(len(H)))
    if solution.rank < len(plain.base):
        return None
    inverse = solution.pseudo_inverse @ solution.pseudo_inverse.T
    basis = np.linalg.inv(np.linalg.qr(H, mode="r"))
    steps = [basis * s for s in share]
    scores = scores_along(model, motions, psi, columns, steps)
    pairs = zip(scores, bound, strict=True)
    G = np.vstack([N / limit**2 for N, limit in pairs]) @ inverse
    return np.asarray(G.T @ G)


def _certificate(change: float, tolerance: float) -> Certificate:
    figures = {"last change": change}
    if change <= tolerance:
        return Certificate("certified", "the reweighting has converged", figures)
    return Certificate(
        "uncertified",
        "the reweighting has not converged; allow more iterations",
        figures,
    )
