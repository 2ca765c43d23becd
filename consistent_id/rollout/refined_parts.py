"""Refined estimates of one part of the training motion, judged on the other part.

The refined estimate is what a rollout delivers, so what is chosen last is chosen by it:
terms of the model, how far to refine, and from which cut-off.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.errors import ConsistentIdError, RecordingError
from consistent_id.estimation.estimate import Estimate
from consistent_id.problems.problem import Problem
from consistent_id.rollout.motion_parts import Spans, slow_and_fast, within
from consistent_id.rollout.part_errors import (
    block_squares,
    diverged,
    is_larger,
    joint_weights,
)
from consistent_id.rollout.refine import (
    RefinementStart,
    refined_once,
    refinement_start,
)
from consistent_id.rollout.rollout_slopes import Replays
from consistent_id.rollout.settings import gains_of, torque_fit

RIDGES = (0.1, 0.3, 1.0)
"""Weights of the torque fit that are tried, from large steps to small ones."""


class PartStart(NamedTuple):
    """The start of a refinement on one part; the other part judges it."""

    learnt: Spans
    other: Spans
    start: RefinementStart


class RefinedParts(NamedTuple):
    """Errors of refined estimates on the part that was not learnt from.

    Parameters
    ----------
    squares : dict of (float or None) to list of ndarray, shape (blocks, joints)
        Squared errors of the blocks of each part, for the weights of the torque fit and
        without refinement (None); infinite where rollouts diverge.
    starts : tuple of PartStart
    reason : str, optional
        Why a refinement of a part is not possible.
    """

    squares: dict[float | None, list[Matrix]]
    starts: tuple[PartStart, ...]
    reason: str | None = None

    @property
    def ridge(self) -> float | None:
        """The weight that predicts best; None: not to refine."""
        return None if self.reason else best_ridge(self.squares)

    @property
    def least(self) -> Matrix:
        """Squared errors of the blocks of both parts with the weight that is best.

        An infinite one where a part has no estimate.
        """
        found = self.squares[self.ridge]
        return np.concatenate(found) if len(found) == 2 else np.full((1, 1), np.inf)


def refined_parts(problem: Problem) -> RefinedParts:
    """Return the errors of estimates that one step has refined, both ways.

    One step shows whether a refinement predicts; all weights share its derivatives.
    """
    squares: dict[float | None, list[Matrix]] = {r: [] for r in (None, *RIDGES)}
    reason, starts = None, list[PartStart]()
    try:
        slow, fast = slow_and_fast(problem)
        for learnt, other in ((slow, fast), (fast, slow)):
            for ridge, of_blocks in _squares(problem, learnt, other, starts):
                squares[ridge].append(of_blocks)
    except ConsistentIdError as why:
        reason = str(why)
    return RefinedParts(squares, tuple(starts), reason)


def best_ridge(squares: Mapping[float | None, Sequence[Matrix]]) -> float | None:
    """Return the weight with the least error that is worse on neither part.

    Each joint counts over its level without refinement.

    Parameters
    ----------
    squares : mapping of (float or None) to sequence of ndarray, shape (blocks, joints)
        Squared errors of the blocks of each part, for the weights and without
        refinement (None).  Worse is what is worse by more than the standard error of
        the difference over blocks.
    """

    def worse(now: Matrix, before: Matrix) -> bool:
        return is_larger(now, before, errors=1.0)

    kept = [
        ridge
        for ridge, parts in squares.items()
        if ridge is None or not any(map(worse, parts, squares[None]))
    ]
    weights = joint_weights(np.concatenate(squares[None]))
    return min(kept, key=lambda r: float((np.concatenate(squares[r]) @ weights).sum()))


def _squares(
    problem: Problem, learnt: Spans, other: Spans, starts: list[PartStart]
) -> Iterator[tuple[float | None, Matrix]]:
    """Yield the squared errors of one part's blocks, by fits to the other part.

    The start of the refinement is added to `starts`.
    """
    logs = problem.logs("training")
    estimate, regression = torque_fit(problem, within(problem.training, learnt))
    others = within(logs, other)

    def squares(moved: Estimate) -> Matrix:
        try:
            return block_squares(problem, moved, others)
        except RecordingError:
            return diverged(problem)

    yield None, squares(estimate)
    replays = Replays.of(estimate, within(logs, learnt), gains_of(problem))
    start = refinement_start(
        replays, regression, problem.constraints, problem.delay_of_commands
    )
    starts.append(PartStart(learnt, other, start))
    for ridge in RIDGES:
        yield ridge, squares(replace(estimate, parameters=refined_once(start, ridge)))
