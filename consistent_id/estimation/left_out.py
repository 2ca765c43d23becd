"""Blocks of the training data that are left out of a fit and predicted by it.

A block is a run of consecutive segments.  The fit to all other blocks predicts each of
its segments, so every segment has an error that it did not choose.  Squares are pooled:
a segment's squared error is divided by the mean squared torque of *all* training data.
With its own torque as the divisor, a segment with hardly any torque would count most.

Several slacks are tried without proofs.  The point nearest to the nominal robot within
a slack is the optimum of a penalised fit for some weight of the distance
(`nearest_within` searches for it, and proves it).  For errors on data left out, every
tenfold weight is enough: a point between two optima satisfies the constraints, which
are convex, and is chosen to use up the slack exactly.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix, Vector, freeze_arrays
from consistent_id._support.executors import all_but_each, single_threaded
from consistent_id.constraints import Constraint
from consistent_id.constraints.priors import (
    INSIDE,
    NominalDistance,
    Penalty,
    PointToSet,
    Prior,
    nominal_distance,
)
from consistent_id.errors import (
    InfeasibleError,
    NotExcitedError,
    ProblemError,
    SolverError,
)
from consistent_id.estimation.best_fit import (
    BestFit,
    FitProblem,
    ScaledFit,
    base_factor,
)
from consistent_id.estimation.constrained_fit import BestInside, best_inside
from consistent_id.estimation.penalised import PenalisedFit, penalised_fit
from consistent_id.estimation.torque_error import stacked_of_kinds
from consistent_id.regression.base import BaseParameters, require_match
from consistent_id.regression.regression import Regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import noise_levels, unconstrained_fit
from consistent_id.regression.segments import merged

_STEP = 10.0  # from one weight of the distance to the next
_STRONGEST = 1e3  # weight at which the distance counts a thousand residuals
_WEAKEST = 1e-14  # below it, rounding counts more than the distance
_GAP = 1e-4  # relative gap of a fit, which only predicts data


class NearPoint(NamedTuple):
    """A point near the nominal robot.

    Parameters
    ----------
    u : ndarray, shape (parameters,)
        See `ScaledFit`.
    weight : float
        Weight of the distance: between those of the two optima beside it.
    """

    u: Vector
    weight: float


def nearest_points(
    best: BestFit, distance: NominalDistance, slacks: Sequence[float], *, first: float
) -> list[NearPoint]:
    """Return about the nearest point to nominal within each slack of the best fit.

    Parameters
    ----------
    slacks : sequence of float
        Allowed relative increases of the misfit.
    first : float
        Weight that is tried first: a power of ten.

    Raises
    ------
    InfeasibleError, SolverError
        See `constrained_least_squares`.
    """
    scaled = best.scaled
    least = scaled.excess(best.solution.u)
    # Misfits below one, a millionth of the torque, count as that: see `ScaledFit`.
    total = max(least + scaled.residual**2, 1.0)
    limits = least + ((1.0 + np.array(slacks)) ** 2 - 1.0) * total

    def fitted(weight: float, start: PenalisedFit | None = None) -> PenalisedFit:
        near = None if start is None else start.solution.u
        return penalised_fit(scaled, distance, weight, start=near, gap=_GAP)

    path = [fitted(first)]
    while path[0].excess < limits.max() and path[0].weight < _STRONGEST:
        path.insert(0, fitted(path[0].weight * _STEP, path[0]))
    while path[-1].excess > limits.min() and path[-1].weight > _WEAKEST:
        path.append(fitted(path[-1].weight / _STEP, path[-1]))
    return [_between(best, path, limit) for limit in limits]


def next_first(weights: Sequence[float]) -> float:
    """Return the weight to try first with nearly the same data and the same slacks."""
    return float(10.0 ** np.ceil(np.log10(max(weights))))


def _between(best: BestFit, path: Sequence[PenalisedFit], limit: float) -> NearPoint:
    """Return the point of a path, strongest weight first, whose excess is a limit.

    On the line from ``u`` to ``v`` the excess is ``||r + t d||^2`` with ``r = M u - z``
    and ``d = M (v - u)``.
    """
    inside = [k for k, fit in enumerate(path) if fit.excess <= limit]
    k = inside[0] if inside else len(path) - 1
    near = path[k]
    if k == 0 or not inside:
        return NearPoint(near.solution.u, near.weight)
    far = path[k - 1]
    scaled, u, step = best.scaled, near.solution.u, far.solution.u - near.solution.u
    r, d = scaled.M @ u - scaled.z, scaled.M @ step
    a, b, c = float(d @ d), float(d @ r), float(r @ r) - limit
    # The root beyond zero, without cancellation; c <= 0 and the far end is outside.
    t = -c / (b + np.sqrt(max(b * b - a * c, 0.0))) if c < 0.0 else 0.0
    t = float(np.clip(t, 0.0, 1.0))
    weight = near.weight ** (1.0 - t) * far.weight**t
    return NearPoint(u + t * step, float(weight))


FOLDS = 6
"""Blocks that are left out, one at a time."""


class LeftOutBlock(NamedTuple):
    """The data without a block, and the block's segments."""

    rest: Regression
    segments: tuple[Regression, ...]


@dataclass(frozen=True, slots=True, eq=False)
class LeftOutErrors:
    """Errors of fits on the segments that they were not fitted to.

    Parameters
    ----------
    errors : array_like, shape (fits, segments)
        Root-mean-square torque error on each segment, over the root-mean-square torque
        of all segments; infinite where there is no fit without the segment's block.
    shares : array_like, shape (segments,)
        Each segment's share of all rows; their sum is one.
    weights : array_like, shape (fits,)
        Weight of the prior: the geometric mean over the blocks; see `Penalty`.
    spreads : array_like, shape (fits,)
        `prediction_spread` of the rows left out: the mean over all blocks.
    """

    errors: Matrix
    shares: Vector
    weights: Vector
    spreads: Vector

    def __post_init__(self) -> None:
        fits, segments = np.shape(self.errors)
        freeze_arrays(self, {"shares": (segments,)}, "left-out errors")
        shapes = {"errors": (fits, segments), "weights": (fits,), "spreads": (fits,)}
        freeze_arrays(self, shapes, "left-out errors", finite=False)

    @property
    def pooled(self) -> Vector:
        """Error of each fit on all that was left out, over all torque."""
        return pooled(self.errors, self.shares)

    def of(self, fit: int) -> "LeftOutErrors":
        """Return the errors of one of the fits."""
        one = slice(fit, fit + 1)
        return LeftOutErrors(
            self.errors[one], self.shares, self.weights[one], self.spreads[one]
        )


def pooled(errors: Matrix, shares: Vector) -> Vector:
    """Return the pooled error of each row, shape (fits,).

    ``sqrt(sum of squared errors / sum of squared torque)``, both over all segments.

    Examples
    --------
    >>> import numpy as np
    >>> pooled(np.array([[0.03, 0.04]]), np.array([0.5, 0.5])).round(4)
    array([0.0354])
    """
    return np.asarray(np.sqrt(errors**2 @ shares))


def folds_of(
    segments: Sequence[Regression], number: int = FOLDS
) -> tuple[LeftOutBlock, ...]:
    """Return blocks of consecutive segments, each with all other data.

    Raises
    ------
    ProblemError
        If there are fewer than two segments.
    """
    if len(segments) < 2:
        raise ProblemError(f"{len(segments)} segments, expected two or more")
    parts = np.array_split(range(len(segments)), min(number, len(segments)))
    blocks = [tuple(segments[i] for i in part) for part in parts]
    rests = all_but_each([merged(block) for block in blocks], Regression.__add__)
    return tuple(map(LeftOutBlock, rests, blocks))


class RestFit(NamedTuple):
    """The fit without a block, before a prior is chosen."""

    problem: FitProblem
    first: BestInside


@dataclass(frozen=True, slots=True, eq=False)
class LeftOutFits:
    """The best fit without each block, from which every prior starts.

    Parameters
    ----------
    model : TorqueModel
    folds : sequence of LeftOutBlock
    fits : sequence of RestFit or None
        None where there is no fit.
    """

    model: TorqueModel
    folds: Sequence[LeftOutBlock]
    fits: Sequence[RestFit | None]


@single_threaded
def left_out_fits(
    model: TorqueModel,
    folds: Sequence[LeftOutBlock],
    *,
    constraints: Sequence[Constraint],
    base: BaseParameters,
    inside: float = INSIDE,
    weighted: bool = False,
) -> LeftOutFits:
    """Fit without each block, on triangular factors.

    Parameters
    ----------
    folds : sequence of LeftOutBlock
        From `folds_of`.
    inside : float
        See `PointToSet`; that of all priors.
    weighted : bool
        Whether joints are weighted by their noise, found without the block.
    """
    fits: list[RestFit | None] = []
    for rest, _ in folds:
        try:
            require_match(model, rest, base)
            if weighted:
                rest = rest.weighted(noise_levels(rest, base))
            problem = FitProblem(model, unconstrained_fit(rest, base), constraints)
            fits.append(RestFit(problem, best_inside(problem, inside)))
        except (InfeasibleError, NotExcitedError, SolverError):
            fits.append(None)
    return LeftOutFits(model, folds, fits)


@single_threaded
def left_out_errors(fits: LeftOutFits, priors: Sequence[Prior]) -> LeftOutErrors:
    """Predict the segments of each block by the fit without it, with each prior.

    Parameters
    ----------
    fits : LeftOutFits
    priors : sequence of PointToSet, or of Penalty
        With the same distance, and the fits' share inside.

    Returns
    -------
    LeftOutErrors
        One fit for each prior.
    """
    every = [segment for fold in fits.folds for segment in fold.segments]
    rows = np.array([sum(segment.counts) for segment in every])
    torque = np.sum([_squares(segment) for segment in every], axis=0)
    found: list[Sequence[_Predicted] | None] = []
    first = 1.0  # weight of the distance that is tried first: similar in all folds
    for fit, fold in zip(fits.fits, fits.folds, strict=True):
        predicted = None if fit is None else _predicted(fit, fold, priors, first)
        found.append(predicted)
        if predicted is not None:
            first = next_first([one.weight for one in predicted])
    return _pooled(fits.model, fits.folds, found, torque, rows, len(priors))


class _Predicted(NamedTuple):
    """The prediction of a fit for a block that was left out of it.

    Parameters
    ----------
    squares : sequence of ndarray, each shape (torque joints,)
        Sum of squared errors of each segment.
    spread : float
        `prediction_spread` of the block.
    """

    squares: Sequence[Vector]
    weight: float
    spread: float


def _predicted(
    fit: RestFit, fold: LeftOutBlock, priors: Sequence[Prior], first: float
) -> list[_Predicted] | None:
    """Predict the segments of the block left out; None if there is no fit."""
    ((_, distance, _),) = {(p.inside, p.distance, type(p)) for p in priors}
    (problem, best), segments = fit, fold.segments
    scaled = best.best.scaled
    nominal = nominal_distance(problem.model, distance, scaled.unit)
    try:
        points = _points(best, nominal, priors, first)
    except (InfeasibleError, SolverError):
        return None
    block = merged(segments).weighted(problem.free.regression.sigma)
    found = []
    for u, weight in points:
        root = prediction_root(scaled, nominal, weight)
        spread = prediction_spread(root, scaled, block, problem.free.base)
        squares = [_squares(segment, u * scaled.unit) for segment in segments]
        found.append(_Predicted(squares, weight, spread))
    return found


def _points(
    best: BestInside,
    distance: NominalDistance,
    priors: Sequence[Prior],
    first: float,
) -> list[NearPoint]:
    """Return the fit with each prior; all are slacks, or all are weights."""
    slacks = [best.slack(prior) for prior in priors if isinstance(prior, PointToSet)]
    if slacks:
        return nearest_points(best.best, distance, slacks, first=first)
    weights = [prior.weight for prior in priors if isinstance(prior, Penalty)]
    fits = [penalised_fit(best.best.scaled, distance, weight) for weight in weights]
    return [NearPoint(fit.solution.u, fit.weight) for fit in fits]


def _pooled(
    model: TorqueModel,
    folds: Sequence[LeftOutBlock],
    found: Sequence[Sequence[_Predicted] | None],
    torque: Vector,
    rows: IntArray,
    fits: int,
) -> LeftOutErrors:
    """Return the errors of all folds, relative to the mean squared torque of all."""
    shares = rows / rows.sum()
    ends = np.cumsum([len(fold.segments) for fold in folds])
    errors = np.full((fits, len(rows)), np.inf)
    logs, spreads = np.zeros(fits), np.zeros(fits)
    for stop, fold, predicted in zip(ends, folds, found, strict=True):
        if predicted is None:
            continue
        own = slice(stop - len(fold.segments), stop)
        for k, one in enumerate(predicted):
            relative = zip(one.squares, shares[own], strict=True)
            if torque.any():
                errors[k, own] = [
                    stacked_of_kinds(model, squares / share, torque)
                    for squares, share in relative
                ]
            logs[k] += np.log(one.weight)
            spreads[k] += shares[own].sum() * one.spread
    fitted = sum(predicted is not None for predicted in found)
    return LeftOutErrors(errors, shares, np.exp(logs / max(fitted, 1)), spreads)


def prediction_root(
    scaled: ScaledFit, distance: NominalDistance, weight: float
) -> Matrix:
    """Return the triangular ``R`` with ``R^T R = M^T M + weight G^T G``.

    Its inverse square is the covariance of the parameters, up to a factor, where ``M``
    are the rows of the data and ``G`` those of the distance at the nominal robot: the
    prior bounds what the data leave open.
    """
    G = distance.local(distance.nominal).G
    return triangle(np.asfortranarray(np.vstack([scaled.M, np.sqrt(weight) * G])))


def prediction_spread(
    root: Matrix, scaled: ScaledFit, regression: Regression, base: BaseParameters
) -> float:
    """Return the mean variance of the predicted rows, up to a factor.

    ``trace(Y (R^T R)^-1 Y^T) / n`` for the ``n`` rows ``Y`` of a regression: small for
    motion like that of the data, large for motion that the data hardly determine.
    """
    from scipy.linalg import solve_triangular

    Y = scaled.with_factor(base_factor(regression, base)).M
    moved = solve_triangular(root, Y.T, trans="T")
    return float(np.sum(moved**2)) / sum(regression.counts)


def _squares(regression: Regression, x: Vector | None = None) -> Vector:
    """Return the sum of squared errors of each row; of squared torque without `x`."""
    rms = regression.torque_rms if x is None else regression.residual_rms(x)
    return np.asarray(np.array(regression.counts) * rms**2)
