"""Regressions of what preparation found in the training data, each value moved."""

from collections.abc import Sequence

from consistent_id.problems.problem import Problem
from consistent_id.recordings.recording import Recording
from consistent_id.regression.regression import Regression, build_regression


def variant_regressions(
    problem: Problem, training: Sequence[Recording]
) -> list[Regression]:
    """Return the training data with each value found changed by its standard error.

    See `uncertainty`, which takes them.
    """
    if problem.table.data is None:
        return []
    varied = problem.found_in_training.varied(training)
    return [build_regression(problem.model, logs) for logs in varied]
