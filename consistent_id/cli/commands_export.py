"""The estimate that ``consistent-id export`` writes."""

from pathlib import Path

from consistent_id.estimation.constrained import constrained_least_squares
from consistent_id.estimation.estimate import Estimate
from consistent_id.problems.problem import Problem
from consistent_id.problems.study import recordings_of
from consistent_id.regression.base import base_parameters
from consistent_id.regression.regression import build_regression


def estimate_for_export(problem: Problem, file: Path | None = None) -> Estimate:
    """Return the problem's constrained estimate, or the one that a file holds.

    Parameters
    ----------
    problem : Problem
    file : Path, optional
        As ``consistent-id identify --output`` writes it.
    """
    base = base_parameters(problem.model)
    if file is not None:
        return Estimate.load(file, problem.model, base)
    training, _ = recordings_of(problem)
    return constrained_least_squares(
        problem.model,
        build_regression(problem.model, training),
        constraints=problem.constraints,
        prior=problem.prior,
        base=base,
    )
