"""Settings of a torque fit, chosen by rollouts of motion that it has not seen.

The fit learns from the slower part of the training data and is judged by its rollouts
of the faster part, and the other way round.  One setting is changed at a time, from a
plain start.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id.errors import InfeasibleError, RecordingError, SolverError
from consistent_id.estimation.joint_springs import joint_springs
from consistent_id.laboratory.rollout.inner_split import Spans, slow_and_fast, within
from consistent_id.laboratory.rollout.settings import (
    Settings,
    gains_of,
    rollout_error,
    torque_fit,
    with_settings,
)
from consistent_id.laboratory.rollout.springs import SpringError
from consistent_id.problems.problem import Problem

CUTOFFS = (5.0, 7.5, 10.0, 15.0, 20.0, 30.0)  # Hz, of motion and torque
SCALES = (0.01, 0.02, 0.05, 0.1)  # rad/s or m/s, of the change of sign of friction
DELAYS = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)  # of commands, in periods of the slowest log

WORTH = 0.025
"""Relative gain that a spring, or friction which varies with position, must bring: the
floor that was found for other terms of a model, so that they are not chosen by chance.
"""

_PASSES = 2  # over all settings; the second seldom changes one


@dataclass(frozen=True, slots=True)
class SettingsChoice:
    """Settings, and what they were chosen by.

    Parameters
    ----------
    error : float, [rad or m]
        Of rollouts of the part that was not learnt from, both ways; the least of all
        that were tried, so optimistic.
    tried : tuple of (Settings, float)
    """

    settings: Settings
    error: float
    tried: tuple[tuple[Settings, float], ...]


def chosen_settings(problem: Problem, start: Settings | None = None) -> SettingsChoice:
    """Choose the settings of a problem on its training data alone.

    Parameters
    ----------
    problem : Problem
        With gains.

    Raises
    ------
    ProblemError
        If the problem has no gains.
    RecordingError
        If no settings give a rollout that stays near the robot.
    """
    tried: dict[Settings, float] = {}
    parts = slow_and_fast(problem)

    def error(settings: Settings) -> float:
        if settings not in tried:
            tried[settings] = error_of_parts(with_settings(problem, settings), parts)
        return tried[settings]

    delays = _delays(problem)
    best = Settings() if start is None else start
    for _ in range(_PASSES):
        before = best
        for name, values in (
            ("delay", delays),
            ("cutoff", _cutoffs(problem)),
            ("velocity_scale", SCALES),
        ):
            candidates = [replace(best, **{name: value}) for value in values]  # type: ignore[arg-type]
            best = min((best, *candidates), key=error)
        best = _with_slopes(best, motor_groups(problem), error)
        if best == before:
            break
    best = with_springs(best, problem, error)
    best = min((best, replace(best, delay=_between(best, delays, error))), key=error)
    if not np.isfinite(error(best)):
        raise RecordingError(
            f"problem {problem.name!r}: with no settings the rollouts stay near the "
            "robot; check gains, columns and units"
        )
    return SettingsChoice(best, error(best), tuple(tried.items()))


def motor_groups(problem: Problem) -> tuple[tuple[str, ...], ...]:
    """Return joints of equal motors together, each other joint by itself."""
    groups = [tuple(joints) for joints in problem.table.constraints.equal_motors]
    grouped = {joint for joints in groups for joint in joints}
    names = problem.model.robot.joint_names
    return (*groups, *((name,) for name in names if name not in grouped))


def _with_slopes(
    best: Settings,
    groups: Sequence[tuple[str, ...]],
    error: Callable[[Settings], float],
) -> Settings:
    """Return the joints of which friction that varies with position is worth it.

    All of a group or none.  From none or all of them, whichever is better, groups are
    added that are worth it, and left out where that costs less than they would have to
    bring.
    """

    def sloped(chosen: Sequence[tuple[str, ...]]) -> Settings:
        names = tuple(joint for group in groups if group in chosen for joint in group)
        return replace(best, friction_slope=names)

    now = [group for group in groups if set(group) <= set(best.friction_slope)]
    for start in ([], list(groups)):
        if error(sloped(start)) < (1.0 - WORTH) * error(sloped(now)):
            now = start
    for group in groups:
        without = [other for other in now if other != group]
        added = [*without, group]
        worth = error(sloped(added)) < (1.0 - WORTH) * error(sloped(without))
        now = added if worth else without
    return sloped(now)


def with_springs(
    best: Settings, problem: Problem, error: Callable[[Settings], float]
) -> Settings:
    """Return settings with springs behind motors, if the data ask for them.

    The torque fit finds them, see `joint_springs`; rollouts must confirm them.  If the
    problem states springs, or its file not all inertias, which they would carry, none
    are looked for.

    Parameters
    ----------
    error : callable
        Of rollouts that were not learnt from.
    """
    known = np.isfinite(gains_of(problem).stiffness).any()
    if known or problem.model.robot.nominal is None:
        return best
    made = with_settings(problem, best)
    found = joint_springs(
        made.model,
        made.training,
        groups=made.table.constraints.equal_motors,
        constraints=made.constraints,
    )
    if not found.compliance.any():
        return best
    sprung = replace(best, stiffness=tuple(found.stiffness.tolist()))
    return sprung if error(sprung) < (1.0 - WORTH) * error(best) else best


def _between(
    best: Settings, delays: Sequence[float], error: Callable[[Settings], float]
) -> float:
    """Return the delay at which a parabola through the best three is lowest [s]."""
    place = delays.index(best.delay) if best.delay in delays else 0
    if not 0 < place < len(delays) - 1:
        return best.delay
    at = np.array(delays[place - 1 : place + 2])
    values = [error(replace(best, delay=float(delay))) for delay in at]
    if not np.isfinite(values).all():
        return best.delay
    bend, slope, _ = np.polyfit(at - best.delay, values, 2)
    lowest = best.delay - slope / (2.0 * bend) if bend > 0.0 else best.delay
    return round(float(np.clip(lowest, at[0], at[-1])), 5)


def _delays(problem: Problem) -> list[float]:
    """Return the delays that are tried, [s]."""
    period = max(1.0 / log.rate for log in problem.logs("training"))
    return [round(share * period, 6) for share in DELAYS]


def _cutoffs(problem: Problem) -> list[float]:
    rates = [log.rate for log in problem.logs("training")]
    return [cutoff for cutoff in CUTOFFS if cutoff < 0.4 * min(rates)]


def error_of_parts(problem: Problem, parts: tuple[Spans, Spans]) -> float:
    """Return the error of rollouts of each part by a fit to the other [rad or m]."""
    both = [_error(problem, *parts), _error(problem, *reversed(parts))]
    return float(np.sqrt(np.mean(np.square(both))))


def _error(problem: Problem, learnt: Spans, judged: Spans) -> float:
    """Return the error of rollouts; infinite if there is no fit, or they diverge."""
    try:
        estimate, _ = torque_fit(problem, within(problem.training, learnt))
        return rollout_error(
            problem, estimate, within(problem.logs("training"), judged)
        )
    except (InfeasibleError, SolverError, SpringError):
        return np.inf
