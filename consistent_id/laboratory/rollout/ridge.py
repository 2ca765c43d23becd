"""Whether to refine by rollout, and how far: tried on parts of the training motion."""

from dataclasses import dataclass

import numpy as np

from consistent_id.laboratory.rollout.inner_split import Spans, slow_and_fast, within
from consistent_id.laboratory.rollout.refine import refined
from consistent_id.laboratory.rollout.settings import (
    gains_of,
    rollout_error,
    torque_fit,
)
from consistent_id.problems.problem import Problem

RIDGES = (0.1, 0.3, 1.0)
"""Weights of the torque fit that are tried: most and little of a step is taken."""


@dataclass(frozen=True, slots=True)
class RidgeChoice:
    """How far to refine.

    Parameters
    ----------
    ridge : float, optional
        Weight of the torque fit; None: not to refine at all.
    errors : dict of (float or None) to float, [rad or m]
        Of rollouts of the part that was not learnt from, both ways.
    """

    ridge: float | None
    errors: dict[float | None, float]


def chosen_ridge(problem: Problem) -> RidgeChoice:
    """Choose how far to refine a problem's estimate, on its training data alone.

    Raises
    ------
    ProblemError
        If the problem has no gains.
    RecordingError
        If a motion diverges.
    """
    slow, fast = slow_and_fast(problem)
    squares: dict[float | None, list[float]] = {}
    for learnt, judged in ((slow, fast), (fast, slow)):
        for ridge, error in _errors(problem, learnt, judged).items():
            squares.setdefault(ridge, []).append(error**2)
    errors = {ridge: float(np.sqrt(np.mean(s))) for ridge, s in squares.items()}
    return RidgeChoice(min(errors, key=lambda ridge: errors[ridge]), errors)


def _errors(
    problem: Problem, learnt: Spans, judged: Spans
) -> dict[float | None, float]:
    """Return the errors of rollouts of one part, by what is learnt from the other."""
    logs = problem.logs("training")
    estimate, regression = torque_fit(problem, within(problem.training, learnt))
    others = within(logs, judged)
    errors: dict[float | None, float] = {None: rollout_error(problem, estimate, others)}
    for ridge in RIDGES:
        better = refined(
            estimate,
            regression,
            within(logs, learnt),
            gains_of(problem),
            constraints=problem.constraints,
            delay=problem.delay_of_commands,
            ridge=ridge,
        )
        errors[ridge] = rollout_error(problem, better.estimate, others)
    return errors
