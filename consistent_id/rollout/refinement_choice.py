"""Whether to refine a torque fit by rollout, how far, and from which cut-off.

It is tried on the parts of the training motion on which settings are chosen: a step
from the fit to one part has to predict the other part, both ways.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.errors import ConsistentIdError
from consistent_id.problems.problem import Problem
from consistent_id.rollout.chosen_settings import cutoffs
from consistent_id.rollout.delay_interval import without_rests
from consistent_id.rollout.motion_parts import within
from consistent_id.rollout.part_errors import block_squares, is_larger
from consistent_id.rollout.refine import full_step
from consistent_id.rollout.refined_parts import PartStart, refined_parts
from consistent_id.rollout.settings import (
    Settings,
    compared_fit,
    gains_of,
    with_settings,
)


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
    found = refined_parts(problem)
    errors = {
        ridge: float(np.sqrt(np.sum(s))) if len(s) == 2 else np.inf
        for ridge, s in found.squares.items()
    }
    choice = RidgeChoice(found.ridge, errors, found.reason)
    if settings is None or choice.ridge is None or without_rests(problem, settings):
        return choice
    return _lowered(problem, settings, choice, choice.ridge, found.starts)


def _lowered(
    problem: Problem,
    settings: Settings,
    choice: RidgeChoice,
    ridge: float,
    starts: Sequence[PartStart],
) -> RidgeChoice:
    """Return the choice with the lowest cut-off that predicts as well, refined.

    Cut-offs are chosen by rollouts of torque fits, but it is the refined estimate that
    is wanted, and noise of the motion biases the torque fit that it keeps to.  Lower
    ones are tried in turn, until the error of refined estimates on the other part is
    larger by more than chance.  Where rows of slow joints are left out, none is tried:
    a filter's reach around reversals grows, and few rows would be left.
    """

    def squares(cutoff: float) -> Matrix:
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
        if is_larger(now, first):
            break
        best = cutoff
    return replace(choice, cutoffs=errors, cutoff=best)
