"""A problem's prepared recordings: those it names, or simulated from its paper."""

import numpy as np

from consistent_id.errors import ProblemError
from consistent_id.problems.problem import Problem
from consistent_id.problems.published import PublishedReport, check_published
from consistent_id.recordings.recording import Recording
from consistent_id.regression.simulation import simulate_torque


def simulated_experiment(
    problem: Problem, published: PublishedReport
) -> tuple[Recording, Recording]:
    """Return simulated training and validation recordings, from the file's seed.

    The truth is the consistent robot nearest to the published mean.
    """
    table = problem.table.simulation
    if table is None:
        raise ProblemError(f"problem {problem.name!r} has no [simulation] table")
    truth = published.vectors[0].nearest.parameters
    rng = np.random.default_rng(table.seed)
    training, validation = (
        simulate_torque(
            problem.model, truth, problem.motion(name), noise=table.noise, rng=rng
        )
        for name in (table.training, table.validation)
    )
    return training, validation


def recordings_of(
    problem: Problem, published: PublishedReport | None = None
) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    """Return a problem's training and validation recordings, real or simulated."""
    if problem.table.data is not None:
        return problem.training, problem.validation
    if not problem.has_data:
        raise ProblemError(
            f"problem {problem.name!r} has neither [data] nor a [simulation] with a "
            "[published] truth; there are no training data"
        )
    published = check_published(problem) if published is None else published
    training, validation = simulated_experiment(problem, published)
    return (training,), (validation,)
