"""Settings of a torque fit, chosen by rollouts of motion that it has not seen.

One setting is changed at a time, from a plain start; see `squares_of_parts`.  A
candidate that cannot be built is skipped, with its reason.  Whether to refine by
rollout, and how far, is tried on the same parts.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import ConsistentIdError, RecordingError
from consistent_id.estimation.transmission_springs import joint_springs
from consistent_id.problems.problem import Problem
from consistent_id.robot.chains import mirrored_motors
from consistent_id.rollout.delay_interval import delay_interval, other_frictions
from consistent_id.rollout.delay_search import (
    FIRST,
    MOST,
    NEAR,
    FoundDelay,
    found_delay,
)
from consistent_id.rollout.refine import (
    RefinementStart,
    full_step,
    refined_once,
    refinement_start,
)
from consistent_id.rollout.replay_model import SEARCH_STEP
from consistent_id.rollout.rollout_slopes import Replays
from consistent_id.rollout.settings import (
    BLOCKS_OF_PART,
    Settings,
    Spans,
    block_squares,
    compared_fit,
    difference_error,
    gains_of,
    rollout_error,
    slow_and_fast,
    squares_of_parts,
    table_in_form_of,
    torque_fit,
    with_settings,
    within,
)

CUTOFFS = (5.0, 7.5, 10.0, 15.0, 20.0, 30.0)  # Hz, of motion and torque
SCALES = (0.01, 0.02, 0.05, 0.1)  # rad/s or m/s, of the change of sign of friction
WORTH = 0.025
"""Least relative gain of a spring, or of friction that varies with position: the same
threshold as for other terms of a model, so that they are not selected by chance.
"""

_PASSES = 2  # over cut-off and velocity scale
_BEYOND = 1.5  # times a stated delay is tried at the most, if that is more than `MOST`

RIDGES = (0.1, 0.3, 1.0)
"""Weights of the torque fit that are tried, from large steps to small ones."""


@dataclass(frozen=True, slots=True)
class SettingsChoice:
    """Settings, and their errors.

    Parameters
    ----------
    error : float, [rad or m]
        Error of rollouts of the held-out part, both ways; it is the least of all that
        were tried, so it is optimistic.
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


class _Candidates:
    """Settings that were tried, on parts of the training motion."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.parts = slow_and_fast(problem)
        self.tried: dict[Settings, float] = {}
        self.skipped: dict[str, None] = {}
        self.built = False  # whether any was, though its rollouts may diverge
        self._squares: dict[Settings, Vector] = {}

    def squares(self, settings: Settings) -> Vector:
        """Return the sums of squared errors of blocks; infinite if it cannot be built.

        Both parts count alike.
        """
        if settings not in self._squares:
            try:
                made = with_settings(self.problem, settings)
                found = squares_of_parts(made, self.parts)
                self.built = True
            except ConsistentIdError as reason:
                self.skipped[str(reason)] = None
                found = np.full(2 * BLOCKS_OF_PART, np.inf)
            self._squares[settings] = found
            self.tried[settings] = float(np.sqrt(found.sum()))
        return self._squares[settings]

    def error(self, settings: Settings) -> float:
        """Return the root-mean-square error of rollouts of parts not learnt from."""
        self.squares(settings)
        return self.tried[settings]

    def none_found(self) -> RecordingError:
        """Return why no settings have an error."""
        seen = "; ".join(self.skipped)
        if self.built:
            what = (
                "with no settings the rollouts stay near the robot; check gains, "
                "columns and units"
            )
        else:
            what = "no settings can be fitted to a part of the training motion"
        return RecordingError(
            f"problem {self.problem.name!r}: {what}{seen and '. Seen: ' + seen}"
        )


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
        If no settings give a rollout that stays near the robot, or there is too little
        motion for two parts.
    """
    gains_of(problem)
    candidates = _Candidates(problem)
    error = candidates.error
    groups = _sloped_groups(problem)
    if start is None:
        start = Settings(delay=problem.delay_of_commands)
    most = max(MOST, _BEYOND * start.delay)  # a stated delay is within the range
    best = _started(start, groups, problem, error)
    best = replace(best, delay=_delayed(best, candidates, [*FIRST, most], most).delay)
    best = _with_terms(best, problem, error)
    for _ in range(_PASSES):
        before = best
        best = _climbed(best, "cutoff", _cutoffs(problem), error)
        best = _climbed(best, "velocity_scale", SCALES, error)
        if best == before:
            break
    best = _with_motors(best, problem, candidates)
    best = _with_slopes(best, groups, error)
    best = with_springs(best, problem, error)
    near = [best.delay - NEAR, best.delay, best.delay + NEAR]
    found = _delayed(best, candidates, near, most)
    best = min((best, replace(best, delay=found.delay)), key=error)
    if not np.isfinite(error(best)):
        raise candidates.none_found()
    others = other_frictions(problem, best, candidates.parts)
    tried = tuple(candidates.tried.items())
    skipped = list(candidates.skipped)
    if unbounded := _without_range(problem):
        skipped.append(
            f"friction that varies with position: {', '.join(unbounded)} "
            f"{'has' if len(unbounded) == 1 else 'have'} no range"
        )
    interval = delay_interval(found, others, most)
    return SettingsChoice(best, error(best), tried, found, tuple(skipped), interval)


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
    best: Settings, candidates: _Candidates, first: Sequence[float], most: float
) -> FoundDelay:
    """Return the delay of commands with the least error, and its standard error."""
    return found_delay(
        lambda delay: candidates.squares(replace(best, delay=delay)),
        [*first, best.delay],
        most,
    )


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


def _with_motors(best: Settings, problem: Problem, candidates: _Candidates) -> Settings:
    """Return settings with equal motors of limbs that mirror each other, if not worse.

    They have fewer parameters, so they are taken unless their error is larger by more
    than the standard error of the difference over blocks.  If the problem states equal
    motors, none are looked for.
    """
    groups = mirrored_motors(problem.model.robot)
    if problem.table.constraints.equal_motors or not groups:
        return best
    shared = replace(best, equal_motors=groups)
    if not np.isfinite(candidates.error(shared)):
        return best
    more = candidates.squares(shared) - candidates.squares(best)
    return shared if more.sum() <= difference_error(more) else best


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


def _cutoffs(problem: Problem) -> list[float]:
    rates = [log.rate for log in problem.logs("training")]
    return [cutoff for cutoff in CUTOFFS if cutoff < 0.4 * min(rates)]


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
    squares: dict[float | None, list[float]] = {r: [] for r in (None, *RIDGES)}
    reason, starts = None, list[_PartStart]()
    try:
        slow, fast = slow_and_fast(problem)
        for learnt, other in ((slow, fast), (fast, slow)):
            for ridge, error in _errors(problem, learnt, other, starts):
                squares[ridge].append(error**2)
    except ConsistentIdError as why:
        reason = str(why)
    errors = {
        ridge: float(np.sqrt(np.mean(s))) if len(s) == 2 else np.inf
        for ridge, s in squares.items()
    }
    best = min(errors, key=lambda ridge: errors[ridge])
    choice = RidgeChoice(None if reason else best, errors, reason)
    if settings is None or choice.ridge is None:
        return choice
    return _lowered(problem, settings, choice, choice.ridge, starts)


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

    lower = sorted(c for c in _cutoffs(problem) if c < settings.cutoff)
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


def _errors(
    problem: Problem, learnt: Spans, other: Spans, starts: list[_PartStart]
) -> Iterator[tuple[float | None, float]]:
    """Yield the errors of rollouts of one part, by fits to the other part.

    One step shows whether a refinement predicts; all weights share its derivatives,
    which are added to `starts`.
    """
    logs = problem.logs("training")
    estimate, regression = torque_fit(problem, within(problem.training, learnt))
    others = within(logs, other)
    yield None, rollout_error(problem, estimate, others, SEARCH_STEP)
    replays = Replays.of(estimate, within(logs, learnt), gains_of(problem))
    start = refinement_start(
        replays, regression, problem.constraints, problem.delay_of_commands
    )
    starts.append(_PartStart(learnt, other, start))
    for ridge in RIDGES:
        moved = replace(estimate, parameters=refined_once(start, ridge))
        yield ridge, rollout_error(problem, moved, others, SEARCH_STEP)
