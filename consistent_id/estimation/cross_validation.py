"""The weight of a prior, chosen from the training data by cross-validation.

Each fold is a run of consecutive segments that is left out of the fit and predicted.
The error over all folds, as a function of the weight, is the regularisation path.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    IntArray,
    Matrix,
    Vector,
    freeze_arrays,
    frozen,
)
from consistent_id._support.executors import (
    Executor,
    all_but_each,
    single_threaded,
)
from consistent_id._support.tables import brief
from consistent_id.constraints import Constraint
from consistent_id.constraints.cones.certificate import GAP_TOLERANCE
from consistent_id.constraints.priors import (
    Distance,
    NominalDistance,
    Penalty,
    QuadraticDistance,
    nominal_distance,
)
from consistent_id.errors import ProblemError
from consistent_id.estimation.best_fit import FitProblem, ScaledFit, base_factor
from consistent_id.estimation.constrained_fit import (
    DEFAULT_CONSTRAINTS,
)
from consistent_id.estimation.penalised import (
    PenalisedFit,
    penalised_fit,
    penalised_fits,
)
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.segments import merged

WEIGHTS = 10.0 ** np.arange(2.0, -8.5, -0.5)
"""Weights to choose from, strongest first; down to 1e-6 for the entropic distance.
Every second one is tried, then the neighbours of the best: the error changes little
from one weight to the next.
"""

_LEAST_ENTROPIC = 1e-6  # below this weight, Newton's method takes dozens of steps

_FOLD_GAP = 1e-4
"""Relative gap of fits that leave a fold out; their errors need no better one."""


@brief
@dataclass(frozen=True, slots=True, eq=False)
class RegularisationPath:
    """Penalised estimates for a series of weights, and their prediction errors.

    Parameters
    ----------
    distance : {"pullback", "euclidean", "entropic"}
    weights : array_like, shape (weights,)
        Decreasing.
    errors : array_like, shape (weights, folds)
        Root-mean-square torque error on each fold when it was left out, divided by the
        joints' `sigma`.
    misfits : array_like, shape (weights,)
        The same error on all data, fitted to all data.
    distances : array_like, shape (weights,)
        Distance to nominal, with all data fitted.
    parameters : array_like, shape (weights, parameters)
        With all data fitted.
    certified : tuple of bool
        Whether these fits are.
    """

    distance: Distance
    weights: Vector
    errors: Matrix
    misfits: Vector
    distances: Vector
    parameters: Matrix
    certified: tuple[bool, ...]

    def __post_init__(self) -> None:
        n = len(self.weights)
        shapes = dict.fromkeys(("weights", "misfits", "distances"), (n,))
        freeze_arrays(self, shapes)
        freeze_arrays(self, {"errors": (n, None), "parameters": (n, None)})

    @property
    def error(self) -> Vector:
        """Root-mean-square error over all folds, for each weight."""
        return np.asarray(np.sqrt(np.mean(self.errors**2, axis=1)))

    @property
    def best(self) -> int:
        """Index of the weight with the least error."""
        return int(np.argmin(self.error))

    @property
    def penalty(self) -> Penalty:
        """The prior with the weight that predicts best."""
        return Penalty(float(self.weights[self.best]), self.distance)


@single_threaded
def cross_validated(
    model: TorqueModel,
    segments: Sequence[Regression],
    *,
    constraints: Sequence[Constraint] = DEFAULT_CONSTRAINTS,
    distance: Distance = "pullback",
    weights: ArrayLike | None = None,
    folds: int = 6,
    base: BaseParameters | None = None,
    executor: str | Executor | None = None,
) -> RegularisationPath:
    """Fit with a series of weights, leaving out one fold after another.

    Parameters
    ----------
    model : TorqueModel
    segments : sequence of Regression
        See `segment_regressions`; their `sigma` are the weights of joints.
    constraints : sequence of Constraint
    distance : {"pullback", "euclidean", "entropic"}
    weights : array_like, shape (weights,)
        All of them are tried, in any order; see `Penalty`.  By default some of
        `WEIGHTS`.  All folds use the same weights, in units of the residual of all
        data.
    folds : int
        Number of consecutive segments; at most as many as there are segments.
    base : BaseParameters, optional
    executor : str or Executor, optional
        Where folds are solved, see `stream_regression`; by default as stated by the
        shell's ``--executor``, else in two threads.  The result is the same.

    Returns
    -------
    RegularisationPath
        Its `penalty` has the weight that predicts best.

    Raises
    ------
    ProblemError
        If there are fewer than two folds or no positive weights.
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    folds = min(folds, len(segments))
    if folds < 2:
        raise ProblemError(f"{folds} folds of {len(segments)} segments, expected 2")
    grid = WEIGHTS[WEIGHTS >= _LEAST_ENTROPIC] if distance == "entropic" else WEIGHTS
    first = grid[::2] if weights is None else frozen(weights, (None,), "weights")
    if len(first) == 0 or first.min() <= 0.0:
        raise ProblemError("weights must be positive numbers, one or more")
    base = base_parameters(model) if base is None else base
    scaled = FitProblem.of(model, merged(segments), constraints, base).scaled()
    to_nominal = nominal_distance(model, distance, scaled.unit)
    folded = _Folds.of(scaled, segments, folds, base)
    along = partial(_along, distance=to_nominal)
    chosen = Executor.chosen(executor)
    found = folded.tried(np.sort(first)[::-1], along, chosen)
    if weights is None:
        beside = _beside(found.weights[found.best], grid)
        start = found.whole[found.best].solution.u
        found = found.merged(folded.tried(beside, partial(along, start=start), chosen))
    whole = found.whole
    total = np.array([f.excess + scaled.residual**2 for f in whole])
    return RegularisationPath(
        distance=distance,
        weights=found.weights,
        errors=found.errors,
        misfits=np.sqrt(total / folded.samples.sum()) * scaled.size,
        distances=np.sqrt([f.squared_distance for f in whole]),
        parameters=np.array([f.solution.u * scaled.unit for f in whole]),
        certified=tuple(f.optimality.verdict == "certified" for f in whole),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Folds:
    """Fits to all data, without each fold, and to each fold alone; its samples."""

    whole: ScaledFit
    rests: list[ScaledFit]
    tests: list[ScaledFit]
    samples: IntArray

    @staticmethod
    def of(
        whole: ScaledFit,
        segments: Sequence[Regression],
        folds: int,
        base: BaseParameters,
    ) -> "_Folds":
        """Return folds of consecutive segments."""
        factors = [base_factor(segment, base) for segment in segments]
        counts = np.array([sum(segment.counts) for segment in segments])
        parts = np.array_split(np.arange(len(segments)), folds)
        blocks = [_joined(*(factors[i] for i in part)) for part in parts]
        return _Folds(
            whole,
            [whole.with_factor(rest) for rest in all_but_each(blocks, _joined)],
            [whole.with_factor(block) for block in blocks],
            np.array([counts[part].sum() for part in parts]),
        )

    def tried(
        self,
        weights: Vector,
        along: Callable[..., list[list[PenalisedFit]]],
        executor: Executor | None,
    ) -> "_TriedWeight":
        """Fit all data and all but each fold, and predict the folds."""
        tasks = [([self.whole], GAP_TOLERANCE), (self.rests, _FOLD_GAP)]
        fits = map if executor is None else executor.map
        (whole,), found = fits(partial(along, weights=weights), tasks)
        columns = [
            _errors(tested, fits, samples)
            for tested, fits, samples in zip(
                self.tests, found, self.samples, strict=True
            )
        ]
        return _TriedWeight(weights, np.column_stack(columns), whole)


@dataclass(frozen=True, slots=True, eq=False)
class _TriedWeight:
    """Weights, the error on each fold for each, and the fits to all data."""

    weights: Vector
    errors: Matrix
    whole: list[PenalisedFit]

    @property
    def best(self) -> int:
        """Index of the weight with the least error over all folds."""
        return int(np.argmin(np.mean(self.errors**2, axis=1)))

    def merged(self, other: "_TriedWeight") -> "_TriedWeight":
        """Return both, the strongest weight first."""
        weights = np.concatenate([self.weights, other.weights])
        order = np.argsort(-weights)
        whole = [*self.whole, *other.whole]
        errors = np.vstack([self.errors, other.errors])
        return _TriedWeight(weights[order], errors[order], [whole[i] for i in order])


def _beside(weight: float, grid: Vector) -> Vector:
    """Return the weights of a grid next to one of them."""
    place = int(np.flatnonzero(grid == weight)[0])
    return grid[[i for i in (place - 1, place + 1) if 0 <= i < len(grid)]]


def _errors(tested: ScaledFit, fits: Sequence[PenalisedFit], samples: int) -> Vector:
    """Return the root-mean-square error of fits on data left out."""
    squared = [tested.excess(f.solution.u) + tested.residual**2 for f in fits]
    return np.asarray(np.sqrt(np.array(squared) / samples) * tested.size)


@single_threaded
def _along(
    task: tuple[Sequence[ScaledFit], float],
    distance: NominalDistance,
    weights: Vector,
    start: Vector | None = None,
) -> list[list[PenalisedFit]]:
    """Return the fits with each weight, for each of several fits of one domain.

    A task is the fits without prior, and the gap at which to end.
    """
    fits, gap = task
    if len(fits) == 1 or not isinstance(distance, QuadraticDistance):
        return [_one_after_another(fit, distance, weights, start, gap) for fit in fits]
    cases = [(fit, float(weight)) for fit in fits for weight in weights]
    near = distance.nominal if start is None else start
    together = penalised_fits(cases, distance, start=near, gap=gap)
    found = [
        penalised_fit(fit, distance, weight, gap=gap) if one is None else one
        for (fit, weight), one in zip(cases, together, strict=True)
    ]
    count = len(weights)
    return [found[first : first + count] for first in range(0, len(found), count)]


def _one_after_another(
    fit: ScaledFit,
    distance: NominalDistance,
    weights: Vector,
    start: Vector | None,
    gap: float,
) -> list[PenalisedFit]:
    """Fit for one weight after another, each from where the last one ended."""
    found: list[PenalisedFit] = []
    for weight in weights:
        start = found[-1].solution.u if found else start
        found.append(penalised_fit(fit, distance, float(weight), start=start, gap=gap))
    return found


def _joined(*factors: Matrix) -> Matrix:
    return triangle(np.asfortranarray(np.vstack(factors)))
