"""Settings of a torque fit, chosen by rollouts of motion that it has not seen.

One setting is changed at a time, from a plain start; see `Candidates`.  A
candidate that cannot be built is skipped, with its reason.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from consistent_id.estimation.transmission_springs import joint_springs
from consistent_id.problems.problem import Problem
from consistent_id.robot.chains import mirrored_motors
from consistent_id.robot.scaling import placeholders
from consistent_id.rollout.candidates import Candidates
from consistent_id.rollout.delay_interval import (
    ALIKE,
    SPEEDS,
    delay_error,
    delay_interval,
    other_frictions,
)
from consistent_id.rollout.delay_search import (
    APART,
    FIRST,
    MOST,
    NEAR,
    FoundDelay,
    found_delay,
)
from consistent_id.rollout.part_errors import is_larger
from consistent_id.rollout.refined_parts import refined_parts
from consistent_id.rollout.settings import (
    Settings,
    gains_of,
    table_in_form_of,
    with_settings,
)

CUTOFFS = (5.0, 7.5, 10.0, 15.0, 20.0, 30.0)  # Hz, of motion and torque
SCALES = (0.01, 0.02, 0.05, 0.1)  # rad/s or m/s, of the change of sign of friction
WORTH = 0.025
"""Least relative gain of a spring, of friction that varies with position, or of motors
of their own: the same threshold as for other terms of a model, so that they are not
selected by chance.
"""

_PASSES = 2  # over cut-off and velocity scale
_QUICK = 15.0  # Hz, a cut-off that leaves most rows beside those of slow joints
_FAR_OFF = 1.25  # times the error from which on rows are not left out
_BEYOND = 1.5  # times a stated delay is tried at the most, if that is more than `MOST`


@dataclass(frozen=True, slots=True)
class SettingsChoice:
    """Settings, and their errors.

    Parameters
    ----------
    error : float, [rad or m]
        Error of rollouts of the held-out part, both ways.  These settings are the best
        of all that were tried, with all joints alike, so it is optimistic.
    tried : tuple of (Settings, float)
    delay : FoundDelay, optional
        The delay with its standard error.
    delay_interval : tuple of float, optional, [s]
        Its 95 % interval, see `delay_interval`; None where it is not known.
    skipped : tuple of str
        Reasons why candidates could not be built.
    """

    settings: Settings
    error: float
    tried: tuple[tuple[Settings, float], ...]
    delay: FoundDelay | None = None
    skipped: tuple[str, ...] = ()
    delay_interval: tuple[float, float] | None = None


def motor_sentence(choice: SettingsChoice, stated: Sequence[Sequence[str]] = ()) -> str:
    """Return in one line which joints have equal motors; empty if none may have.

    Parameters
    ----------
    stated : sequence of sequence of str
        Joints that have equal motors by the problem.
    """
    found = choice.settings.equal_motors
    if found:
        return f"equal motors of limbs that mirror each other: {_listed(found)}"
    if stated:
        return f"equal motors, as the problem states: {_listed(stated)}"
    for tried, error in choice.tried:
        if tried.equal_motors and np.isfinite(error):
            return (
                "motors of limbs that mirror each other differ, because equal ones "
                f"predict worse: {_listed(tried.equal_motors)}"
            )
    return ""


def _listed(groups: Sequence[Sequence[str]]) -> str:
    return "; ".join(", ".join(group) for group in groups)


def chosen_settings(
    problem: Problem, start: Settings | None = None, *, refine: bool = False
) -> SettingsChoice:
    """Choose the settings of a problem on its training data alone.

    Parameters
    ----------
    problem : Problem
        With gains.
    refine : bool
        Whether the estimate will be refined; see `_with_fewer_terms`.

    Raises
    ------
    ProblemError
        If the problem has no gains.
    RecordingError
        If no settings give a rollout that stays near the robot, or there is too little
        motion for two parts.
    """
    gains_of(problem)
    candidates = Candidates(problem)
    error = candidates.error
    if start is None:
        start = Settings(delay=problem.delay_of_commands)
    most = max(MOST, _BEYOND * start.delay)  # a stated delay is within the range
    with candidates.in_two_processes():
        best, rested, found = _searched(problem, start, candidates, most, refine)
    if not np.isfinite(error(best)):
        raise candidates.none_found()
    others = other_frictions(problem, best, candidates)
    tried_without = rested.least_joint_speed is not None
    if tried_without and best.least_joint_speed is None:
        if error(rested) <= ALIKE * error(best):
            others.append(candidates.by_delay(rested))
    tried = tuple(candidates.tried.items())
    skipped = list(candidates.skipped)
    if unbounded := _without_range(problem):
        skipped.append(
            f"friction that varies with position: {', '.join(unbounded)} "
            f"{'has' if len(unbounded) == 1 else 'have'} no range"
        )
    interval = delay_interval(found, others, most)
    sure = replace(best, delay_error=delay_error(found, interval))
    plain = candidates.tried[best]
    return SettingsChoice(sure, plain, tried, found, tuple(skipped), interval)


def _searched(
    problem: Problem, start: Settings, candidates: Candidates, most: float, refine: bool
) -> tuple[Settings, Settings, FoundDelay]:
    """Return the best settings, the best without rows of slow joints, and the delay."""
    error, groups = candidates.error, _sloped_groups(problem)
    best = _started(start, groups, problem, error)
    candidates.weigh(best)
    best = replace(best, delay=_delayed(best, candidates, [*FIRST, most], most).delay)
    candidates.weigh(best)
    best = _with_terms(best, problem, error)
    rested = _without_rests(best, problem, candidates, most)
    best = min((_shaped(best, problem, error), rested), key=error)
    best = _with_bodies(best, problem, candidates, most)
    best = _with_motors(best, problem, candidates)
    best = _with_slopes(best, groups, error)
    best = with_springs(best, problem, error)
    if refine:
        best = _with_fewer_terms(best, problem, candidates)
    near = [best.delay - NEAR, best.delay, best.delay + NEAR]
    near += [best.delay - APART, best.delay + APART]
    found = _delayed(best, candidates, near, most, beyond=True)
    best = min((best, replace(best, delay=found.delay)), key=error)
    return best, rested, replace(found, delay=best.delay)


def _started(
    start: Settings,
    groups: Sequence[tuple[str, ...]],
    problem: Problem,
    error: Callable[[Settings], float],
) -> Settings:
    """Return the best start: friction in MuJoCo's form or not, all slopes or none."""
    best = start
    if table_in_form_of(problem.table, "mjcf") != problem.table:
        best = min((best, replace(best, simulated=True)), key=error)
    return min((best, replace(best, friction_slope=_names(groups))), key=error)


def _with_terms(
    best: Settings, problem: Problem, error: Callable[[Settings], float]
) -> Settings:
    """Return settings with the problem's coupled gears and springs, all, or none.

    A selection by torque may have found some of them, which stand for other errors of
    the model; rollouts of faster motion have to confirm them.
    """
    terms = problem.model.terms
    if problem.table.couplings:
        best = min((best, replace(best, couplings=False)), key=error)
    others = [True] * (not all(one.spring for one in terms))
    others += [False] * any(one.spring for one in terms)
    return min((best, *(replace(best, spring=one) for one in others)), key=error)


def _delayed(
    best: Settings,
    candidates: Candidates,
    first: Sequence[float],
    most: float,
    *,
    beyond: bool = False,
) -> FoundDelay:
    """Return the delay of commands with the least error, and its standard error."""
    squares, first = candidates.by_delay(best), [*first, best.delay]
    return found_delay(squares, first, most, beyond=beyond)


def _shaped(
    best: Settings, problem: Problem, error: Callable[[Settings], float]
) -> Settings:
    """Return settings with the best cut-off and velocity scale."""
    for _ in range(_PASSES):
        before = best
        best = _climbed(best, "cutoff", cutoffs(problem), error)
        best = _climbed(best, "velocity_scale", SCALES, error)
        if best == before:
            break
    return best


def _with_bodies(
    best: Settings, problem: Problem, candidates: Candidates, most: float
) -> Settings:
    """Return settings with the bodies of the robot's file, if these predict better.

    Where the motion determines them badly, bodies make up for what the model of the
    drives lacks.
    """
    if not _may_take_bodies(problem):
        return best
    kept, error = replace(best, bodies="model"), candidates.error
    near = [kept.delay - NEAR, kept.delay, kept.delay + NEAR]
    kept = replace(kept, delay=_delayed(kept, candidates, near, most).delay)
    return min((best, _shaped(kept, problem, error)), key=error)


def _may_take_bodies(problem: Problem) -> bool:
    """Return whether a problem leaves open if bodies are those of the robot's file.

    One that states which bodies it wants, or that the file's masses are not the
    robot's, is not asked.
    """
    known = problem.table.constraints
    stated = known.bodies is not None or known.masses != "datasheet"
    return not stated and _has_bodies(problem)


def _with_fewer_terms(
    best: Settings, problem: Problem, candidates: Candidates
) -> Settings:
    """Return settings without coupled gears, and with the file's bodies, if not worse.

    A torque fit needs such terms to make up for what the model lacks; a refinement can
    do without them.  So refined estimates judge them, which is too slow for all
    candidates.  A model with fewer parameters is taken unless its error is larger by
    more than chance.
    """
    fewer = list[dict[str, Any]]()
    if problem.table.couplings and best.couplings:
        fewer.append({"couplings": False})
    if best.bodies is None and _may_take_bodies(problem):
        fewer.append({"bodies": "model"})
    known = None
    for change in fewer:
        error = candidates.error
        tried = _shaped(replace(best, **change), problem, error)
        if not error(tried) <= ALIKE * error(best):
            continue
        if known is None:
            known = refined_parts(with_settings(problem, best)).least
        now = refined_parts(with_settings(problem, tried)).least
        if not is_larger(now, known):
            best, known = tried, now
    return best


def _without_rests(
    start: Settings, problem: Problem, candidates: Candidates, most: float
) -> Settings:
    """Return settings that leave out the rows of slow joints, if that may be better.

    Friction that holds a joint has any value that balances it.  A torque fit that
    predicts a certain value there is wrong, and bodies, damping and delay make up for
    it, more so with a high cut-off.  So cut-off and delay are found again without these
    rows.  Where joints are slow for most of the motion, too few rows are left.  If the
    problem states which rows are left out, these are.
    """
    data = problem.table.data
    if data is None or data.preparation.least_joint_speed is not None:
        return start
    error, usable = candidates.error, cutoffs(problem)
    higher = min((c for c in usable if c >= _QUICK), default=start.cutoff)
    best = replace(start, least_joint_speed=SPEEDS[0], cutoff=higher)
    best = _climbed(best, "cutoff", usable, error)
    if error(best) > _FAR_OFF * error(start):
        return start
    near = [best.delay - NEAR, best.delay, best.delay + NEAR]
    best = replace(best, delay=_delayed(best, candidates, near, most).delay)
    best = _shaped(best, problem, error)
    return _climbed(best, "least_joint_speed", SPEEDS, error)


def _climbed(
    best: Settings,
    name: str,
    values: Sequence[float],
    error: Callable[[Settings], float],
) -> Settings:
    """Return settings with the best value of one of them, from neighbour to neighbour.

    The error has one least value along these settings, nearly.
    """
    order = sorted({*values, getattr(best, name)})
    for step in (1, -1):
        place = order.index(getattr(best, name)) + step
        while 0 <= place < len(order):
            tried: Settings = replace(best, **{name: order[place]})
            if error(tried) >= error(best):
                break
            best, place = tried, place + step
    return best


def _with_motors(best: Settings, problem: Problem, candidates: Candidates) -> Settings:
    """Return settings with equal motors of limbs that mirror each other, if not worse.

    They have fewer parameters, so they are taken unless their error is larger by
    `WORTH`, and by more than chance.  If the problem states equal motors, none are
    looked for.
    """
    groups = mirrored_motors(problem.model.robot)
    if problem.table.constraints.equal_motors or not groups:
        return best
    shared = replace(best, equal_motors=groups)
    own, error = candidates.error(best), candidates.error(shared)
    worse = is_larger(candidates.by_joint(shared), candidates.by_joint(best))
    worse &= own < (1.0 - WORTH) * error
    return best if worse or not np.isfinite(error) else shared


def motor_groups(problem: Problem) -> tuple[tuple[str, ...], ...]:
    """Return joints of equal motors together, each other joint by itself.

    Motors of limbs that mirror each other are together, unless the problem states
    equal motors.
    """
    robot = problem.model.robot
    stated = problem.table.constraints.equal_motors
    groups = [tuple(joints) for joints in stated] or list(mirrored_motors(robot))
    grouped = {joint for joints in groups for joint in joints}
    names = robot.joint_names
    return (*groups, *((name,) for name in names if name not in grouped))


def _sloped_groups(problem: Problem) -> tuple[tuple[str, ...], ...]:
    """Return groups of motors whose friction may vary with position.

    It needs a range of positions, at both ends of which friction is positive.
    """
    unbounded = _without_range(problem)
    groups = [
        tuple(name for name in group if name not in unbounded)
        for group in motor_groups(problem)
    ]
    return tuple(group for group in groups if group)


def _without_range(problem: Problem) -> tuple[str, ...]:
    return tuple(
        joint.name
        for joint in problem.model.robot.driven
        if not np.isfinite([joint.limits.lower, joint.limits.upper]).all()
    )


def _names(groups: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    return tuple(joint for group in groups for joint in group)


def _with_slopes(
    best: Settings,
    groups: Sequence[tuple[str, ...]],
    error: Callable[[Settings], float],
) -> Settings:
    """Return joints whose friction varies with position, if the gain is large enough.

    A group has all or none.  Starting from none or all of them, whichever is better,
    groups with enough gain are added, and groups with too little gain are removed.
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
    """Return settings with springs behind motors, if they lower the error enough.

    The torque fit finds them, see `joint_springs`; rollouts must confirm them.  If the
    problem states springs, or its file not all inertias, which they would carry, none
    are looked for.

    Parameters
    ----------
    error : callable
        Error of rollouts that were not used for training.
    """
    known = np.isfinite(gains_of(problem).stiffness).any()
    if known or not _has_bodies(problem):
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


def _has_bodies(problem: Problem) -> bool:
    """Return whether the robot's file states inertias, which are no placeholders."""
    robot = problem.model.robot
    return robot.nominal is not None and not placeholders(robot)


def cutoffs(problem: Problem) -> list[float]:
    """Return the cut-offs that a problem's training logs are fast enough for, [Hz]."""
    rates = [log.rate for log in problem.logs("training")]
    return [cutoff for cutoff in CUTOFFS if cutoff < 0.4 * min(rates)]
