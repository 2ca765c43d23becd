"""The recommended estimate, chosen by its prediction of left-out training data.

Blocks of consecutive segments are left out of the fit one after another and predicted.
Of the methods whose error is within one standard error of the least, the simplest is
recommended: a smaller difference is chance. Held-out recordings are not used, so the
choice does not bias their error.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector, freeze_arrays
from consistent_id._support.executors import all_but_each, single_threaded
from consistent_id.constraints import Constraint
from consistent_id.constraints.priors import Prior
from consistent_id.errors import (
    InfeasibleError,
    NotExcitedError,
    ProblemError,
    SolverError,
)
from consistent_id.estimation.best_fit import FitProblem
from consistent_id.estimation.constrained_fit import (
    constrained_fit,
)
from consistent_id.estimation.torque_error import stacked_of_kinds
from consistent_id.estimation.verdict import percent
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import joint_noise
from consistent_id.regression.segments import merged

FOLDS = 6
"""Blocks that are left out, one at a time."""


@dataclass(frozen=True, slots=True)
class MethodCandidate:
    """A method that can be recommended.

    Parameters
    ----------
    weighted : bool
        Whether joints are weighted by their noise.
    """

    method: str
    weighted: bool
    prior: Prior


@dataclass(frozen=True, slots=True, eq=False)
class Recommendation:
    """The recommended method, and the prediction errors of every candidate.

    Parameters
    ----------
    candidates : tuple of str
        From the simplest to the most complex.
    errors : array_like, shape (candidates, folds)
        Torque error on each block when it was left out, over the block's torque;
        infinite where there is no fit without the block.
    """

    method: str
    candidates: tuple[str, ...]
    errors: Matrix

    def __post_init__(self) -> None:
        shape = {"errors": (len(self.candidates), None)}
        freeze_arrays(self, shape, "recommendation", finite=False)

    @property
    def error(self) -> Vector:
        """Root-mean-square error over blocks of each candidate."""
        return np.asarray(np.sqrt(np.mean(self.errors**2, axis=1)))

    @property
    def expected(self) -> float | None:
        """Torque error to expect on a motion not seen; None if it is not known."""
        error = float(self.error[self.candidates.index(self.method)])
        return error if np.isfinite(error) else None

    @property
    def statement(self) -> str:
        """The reason, in a sentence."""
        if self.expected is None:
            return f"{self.method}, the simplest; no block of the data can be left out"
        pairs = zip(self.candidates, self.error, strict=True)
        others = ", ".join(f"{m} {percent(e)}" for m, e in pairs if m != self.method)
        beside = f"; {others}" if others else ""
        return (
            f"error to expect on a motion not seen: {percent(self.expected)} (all "
            f"joints, blocks of the training data left out{beside})"
        )


@single_threaded
def recommend(
    model: TorqueModel,
    segments: Sequence[Regression],
    candidates: Sequence[MethodCandidate],
    *,
    constraints: Sequence[Constraint],
    base: BaseParameters,
) -> Recommendation:
    """Recommend one of several methods.

    Parameters
    ----------
    segments : sequence of Regression
        The training data, in the order of time.
    candidates : sequence of MethodCandidate
        From the simplest to the most complex.

    Raises
    ------
    ProblemError
        If there is no candidate, or fewer than two segments.
    """
    if not candidates or len(segments) < 2:
        raise ProblemError(
            f"{len(candidates)} candidates and {len(segments)} segments, expected at "
            "least one and two"
        )
    folds = _folds(segments, min(FOLDS, len(segments)))
    errors = np.array(
        [
            _left_out(model, candidate, folds, constraints, base)
            for candidate in candidates
        ]
    )
    names = tuple(candidate.method for candidate in candidates)
    return Recommendation(names[_simplest(errors)], names, errors)


class _LeftOut(NamedTuple):
    """The data without a block, and the block."""

    rest: Regression
    tested: Regression


def _left_out(
    model: TorqueModel,
    candidate: MethodCandidate,
    folds: Sequence[_LeftOut],
    constraints: Sequence[Constraint],
    base: BaseParameters,
) -> list[float]:
    """Return a candidate's error on each fold; infinite where there is no fit."""
    errors: list[float] = []
    weight: float | None = None  # weight of the prior: similar in all folds
    for rest, tested in folds:
        try:
            if candidate.weighted:
                rest = rest.weighted(joint_noise(model, rest, base=base))
            problem = FitProblem.of(model, rest, constraints, base)
            fit = constrained_fit(problem, candidate.prior, weight=weight)
        except (InfeasibleError, NotExcitedError, SolverError):
            errors.append(np.inf)
            continue
        weight = fit.final.weight
        errors.append(_relative_error(model, tested, fit.parameters))
    return errors


def _folds(segments: Sequence[Regression], number: int) -> list[_LeftOut]:
    parts = np.array_split(np.arange(len(segments)), number)
    blocks = [merged([segments[i] for i in part]) for part in parts]
    rests = all_but_each(blocks, Regression.__add__)
    return [_LeftOut(*pair) for pair in zip(rests, blocks, strict=True)]


def _simplest(errors: Matrix) -> int:
    """Return the first row whose mean square is within one standard error of the least.

    The standard error is that of the row with the least error, over blocks.
    """
    squared = errors**2
    mean = squared.mean(axis=1)
    best = int(np.argmin(mean))
    if not np.isfinite(mean[best]):
        return 0
    spread = float(np.std(squared[best], ddof=1)) / np.sqrt(squared.shape[1])
    return int(np.argmax(mean <= mean[best] + spread))


def _relative_error(model: TorqueModel, regression: Regression, x: Vector) -> float:
    """Return the torque error over the torque; see `stacked_of_kinds`."""
    counts = np.array(regression.counts, dtype=np.float64)
    size = counts * regression.torque_rms**2
    error = counts * regression.residual_rms(x) ** 2
    return stacked_of_kinds(model, error, size) if size.any() else np.inf
