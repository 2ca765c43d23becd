"""Whether to refine a torque fit by rollout, how far, and from which cut-off.

It is tried on the parts of the training motion on which settings are chosen: a step
from the fit to one part has to predict the other part, both ways.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import ConsistentIdError, RecordingError
from consistent_id.estimation.estimate import Estimate
from consistent_id.problems.problem import Problem
from consistent_id.rollout.chosen_settings import cutoffs
from consistent_id.rollout.motion_parts import Spans, slow_and_fast, within
from consistent_id.rollout.refine import (
    RefinementStart,
    full_step,
    refined_once,
    refinement_start,
)
from consistent_id.rollout.rollout_slopes import Replays
from consistent_id.rollout.settings import (
    BLOCKS_OF_PART,
    Settings,
    block_squares,
    compared_fit,
    difference_error,
    gains_of,
    torque_fit,
    with_settings,
)

RIDGES = (0.1, 0.3, 1.0)
"""Weights of the torque fit that are tried, from large steps to small ones."""


@dataclass(frozen=True, slots=True)
class RidgeChoice:
    """The extent of a refinement.

    Parameters
    ----------
    ridge : float, optional
        Weight of the torque fit; None: not to refine at all.
    errors : dict of (float or None) to float, [rad or m]
        Errors of rollouts of the part that was not used for training, both ways;
        infinite where they diverge, or a part cannot be refined.
    reason : str, optional
        Why a refinement was not possible.
    cutoffs : dict of float to float, [Hz], [rad or m]
        Errors of estimates that are refined from torque fits with other cut-offs, if
        these were tried; the first is the cut-off that the settings had.
    cutoff : float, optional, [Hz]
        The one of them to refine from.
    """

    ridge: float | None
    errors: dict[float | None, float]
    reason: str | None = None
    cutoffs: dict[float, float] = field(default_factory=dict)
    cutoff: float | None = None


def chosen_ridge(problem: Problem, settings: Settings | None = None) -> RidgeChoice:
    """Choose how far to refine a problem's estimate, on its training data alone.

    A part that cannot be refined, such as one whose fit diverges, has an infinite
    error: then there is no refinement, for a reason that is returned.

    Parameters
    ----------
    problem : Problem
        With gains.
    settings : Settings, optional
        Those of the problem, if their cut-off may be lowered; see `_lowered`.

    Raises
    ------
    ProblemError
        If the problem has no gains.
    """
    gains_of(problem)
    squares: dict[float | None, list[Vector]] = {r: [] for r in (None, *RIDGES)}
    reason, starts = None, list[_PartStart]()
    try:
        slow, fast = slow_and_fast(problem)
        for learnt, other in ((slow, fast), (fast, slow)):
            for ridge, of_blocks in _squares(problem, learnt, other, starts):
                squares[ridge].append(of_blocks)
    except ConsistentIdError as why:
        reason = str(why)
    errors = {
        ridge: float(np.sqrt(np.sum(s))) if len(s) == 2 else np.inf
        for ridge, s in squares.items()
    }
    best = None if reason else best_ridge(squares)
    choice = RidgeChoice(best, errors, reason)
    if settings is None or choice.ridge is None:
        return choice
    return _lowered(problem, settings, choice, choice.ridge, starts)


def best_ridge(squares: Mapping[float | None, Sequence[Vector]]) -> float | None:
    """Return the weight with the least error that is worse on neither part.

    Parameters
    ----------
    squares : mapping of (float or None) to sequence of ndarray, shape (blocks,)
        Squared errors of the blocks of each part, for the weights and without
        refinement (None).  Worse is what is worse by more than the standard error of
        the difference over blocks.
    """

    def worse(now: Vector, before: Vector) -> bool:
        if not (np.isfinite(now).all() and np.isfinite(before).all()):
            return not np.isfinite(now).all()
        return bool((now - before).sum() > difference_error(now - before))

    kept = [
        ridge
        for ridge, parts in squares.items()
        if ridge is None or not any(map(worse, parts, squares[None]))
    ]
    return min(kept, key=lambda ridge: float(np.sum(squares[ridge])))


class _PartStart(NamedTuple):
    """The start of a refinement on one part; the other part judges it."""

    learnt: Spans
    other: Spans
    start: RefinementStart


def _lowered(
    problem: Problem,
    settings: Settings,
    choice: RidgeChoice,
    ridge: float,
    starts: Sequence[_PartStart],
) -> RidgeChoice:
    """Return the choice with the lowest cut-off that predicts as well, refined.

    Cut-offs are chosen by rollouts of torque fits, but it is the refined estimate that
    is wanted, and noise of the motion biases the torque fit that it keeps to.  Lower
    ones are tried in turn, until the error of refined estimates on the other part is
    larger by more than the standard error of the difference over blocks.
    """

    def squares(cutoff: float) -> Vector:
        made = with_settings(problem, replace(settings, cutoff=cutoff))
        logs, found = made.logs("training"), []
        for learnt, other, start in starts:
            fit = compared_fit(made, within(made.training, learnt))
            x = full_step(start, *fit, ridge=ridge)
            moved = replace(fit[0], parameters=x)
            found.append(block_squares(made, moved, within(logs, other)))
        return np.concatenate(found)

    lower = sorted(c for c in cutoffs(problem) if c < settings.cutoff)
    errors, best, first = dict[float, float](), settings.cutoff, None
    for cutoff in (settings.cutoff, *reversed(lower)):
        try:
            now = squares(cutoff)
        except ConsistentIdError:  # no fit, or a motion that diverges
            break
        errors[cutoff] = float(np.sqrt(now.sum()))
        first = now if first is None else first
        if (now - first).sum() > difference_error(now - first):
            break
        best = cutoff
    return replace(choice, cutoffs=errors, cutoff=best)


def _squares(
    problem: Problem, learnt: Spans, other: Spans, starts: list[_PartStart]
) -> Iterator[tuple[float | None, Vector]]:
    """Yield the squared errors of one part's blocks, by fits to the other part.

    They are infinite where rollouts diverge.  One step shows whether a refinement
    predicts; all weights share its derivatives, which are added to `starts`.
    """
    logs = problem.logs("training")
    estimate, regression = torque_fit(problem, within(problem.training, learnt))
    others = within(logs, other)

    def squares(moved: Estimate) -> Vector:
        try:
            return block_squares(problem, moved, others)
        except RecordingError:
            return np.full(BLOCKS_OF_PART, np.inf)

    yield None, squares(estimate)
    replays = Replays.of(estimate, within(logs, learnt), gains_of(problem))
    start = refinement_start(
        replays, regression, problem.constraints, problem.delay_of_commands
    )
    starts.append(_PartStart(learnt, other, start))
    for ridge in RIDGES:
        yield ridge, squares(replace(estimate, parameters=refined_once(start, ridge)))
