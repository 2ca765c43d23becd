"""Settings of a torque fit, chosen by rollouts of motion that it has not seen.

The danger is overfitting: a model of slow motion may be wrong for fast motion. So the
training data are split by speed: the model is fitted to the slower part and judged by
its rollouts of the faster part, and vice versa.  One setting is changed at a time, from
a plain start.  Whether to refine by rollout, and how far, is tried on the same parts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from consistent_id.errors import (
    InfeasibleError,
    ProblemError,
    RecordingError,
    SolverError,
)
from consistent_id.estimation.constrained import (
    constrained_least_squares,
)
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.fitted_to import fitted_spans
from consistent_id.estimation.method import Method
from consistent_id.estimation.transmission_springs import joint_springs
from consistent_id.problems.file import JointTable
from consistent_id.problems.loading import problem_of
from consistent_id.problems.problem import Problem
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains, trimmed
from consistent_id.regression.base import base_parameters
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.residual_noise import joint_noise
from consistent_id.rollout.commanded_motion import replay, replayable
from consistent_id.rollout.refine import refined
from consistent_id.rollout.replay_model import SpringError, replay_model

_SLOW_PART = 0.6  # of the training time is the slower part
_BETWEEN_PARTS = 0.2  # s between the parts

Spans = tuple[tuple[float, float], ...]

CUTOFFS = (5.0, 7.5, 10.0, 15.0, 20.0, 30.0)  # Hz, of motion and torque
SCALES = (0.01, 0.02, 0.05, 0.1)  # rad/s or m/s, of the change of sign of friction
DELAYS = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)  # of commands, in periods of the slowest log

WORTH = 0.025
"""Least relative gain of a spring, or of friction that varies with position: the same
threshold as for other terms of a model, so that they are not selected by chance.
"""

_PASSES = 2  # over all settings; the second seldom changes one

RIDGES = (0.1, 0.3, 1.0)
"""Weights of the torque fit that are tried, from large steps to small ones."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of a torque fit of commands.

    Parameters
    ----------
    cutoff : float, [Hz]
        Of motion and torque.
    velocity_scale : float, [rad/s or m/s]
    friction_slope : tuple of str
        Joints whose friction varies with position.
    delay : float, [s]
        Of commands.
    stiffness : tuple of float, optional, [N m/rad or N/m]
        Of springs between motors and links, one each, infinite for a rigid joint; by
        default those of the problem.
    """

    cutoff: float = 10.0
    velocity_scale: float = 0.05
    friction_slope: tuple[str, ...] = ()
    delay: float = 0.0
    stiffness: tuple[float, ...] | None = None


def with_settings(problem: Problem, settings: Settings) -> Problem:
    """Return a problem with other settings; its logs are not read again.

    Raises
    ------
    ProblemError
        If the problem has no gains, or no Coulomb friction of the shape ``"tanh"``.
    """
    table, change = problem.table, msgspec.structs.replace
    if table.data is None or table.data.gains is None:
        raise _without_gains(problem)
    drives = {
        "velocity_scale": settings.velocity_scale,
        "coulomb": "tanh",
        "friction_slope": False,
    }
    preparation = change(
        table.data.preparation,
        motion_cutoff=settings.cutoff,
        torque_cutoff=settings.cutoff,
    )
    known = problem.drives.calibration
    gains = change(
        table.data.gains,
        delay=settings.delay,
        scale=known.scale.tolist(),
        encoder_bias=known.encoder_bias.tolist(),
        stiffness=_stated(problem, settings.stiffness),
    )
    data = change(table.data, gains=gains, preparation=preparation)
    named = dict.fromkeys((*table.joints, *settings.friction_slope), JointTable())
    joints = {
        name: change(
            joint, **drives | {"friction_slope": name in settings.friction_slope}
        )
        for name, joint in (named | table.joints).items()
    }
    changed = change(
        table, data=data, drive=change(table.drive, **drives), joints=joints
    )
    file = problem.source or problem.folder / "problem.toml"
    made = problem_of(changed, file)
    made._read.update(problem._read)
    return replace(made, source=problem.source)


def _stated(problem: Problem, stiffness: Sequence[float] | None) -> list[float] | None:
    """Return the stiffness of springs as a file states it; None for a rigid robot."""
    if stiffness is None:
        joints = len(problem.model.robot)
        stiffness = gains_of(problem).of(joints).stiffness.tolist()
    return list(stiffness) if np.isfinite(stiffness).any() else None


def torque_fit(
    problem: Problem, training: Sequence[Recording] | None = None
) -> tuple[Estimate, Regression]:
    """Return the constrained torque fit, weighted by each joint's noise."""
    model = problem.model
    base = base_parameters(model)
    recordings = problem.training if training is None else training
    plain = build_regression(model, recordings)
    regression = plain.weighted(joint_noise(model, plain, base=base))
    estimate = constrained_least_squares(
        model,
        regression,
        constraints=problem.constraints,
        prior=problem.prior,
        base=base,
        method=Method.WEIGHTED_CONSTRAINED,
    )
    return replace(estimate, fitted_to=fitted_spans(recordings)), regression


def gains_of(problem: Problem) -> PDGains:
    """Return the gains of a problem's drives.

    Raises
    ------
    ProblemError
        If it has none.
    """
    gains = problem.gains
    if gains is None:
        raise _without_gains(problem)
    return gains


def _without_gains(problem: Problem) -> ProblemError:
    return ProblemError(
        f"problem {problem.name!r} has no [data.gains]; a rollout replays commands of "
        "PD-controlled joints: give kp, kd and [data.columns] position_command"
    )


def rollout_error(
    problem: Problem, estimate: Estimate, logs: Sequence[Recording]
) -> float:
    """Return the root-mean-square error of an estimate's rollouts [rad or m]."""
    gains = gains_of(problem)
    joints = problem.model.robot.joint_names
    known = [replayable(log.of(joints)) for log in logs]
    try:
        model = replay_model(estimate, joints, gains)
        delay = problem.delay_of_commands
        errors = [replay(model, log, delay=delay).errors for log in known]
    except RecordingError:
        return np.inf
    return float(np.sqrt((np.vstack(errors) ** 2).mean()))


@dataclass(frozen=True, slots=True)
class SettingsChoice:
    """Settings, and their errors.

    Parameters
    ----------
    error : float, [rad or m]
        Error of rollouts of the held-out part, both ways; it is the least of all that
        were tried, so it is optimistic.
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


def within(recordings: Sequence[Recording], spans: Spans) -> list[Recording]:
    """Return recordings within spans of time, one span for each."""
    return [
        trimmed(recording, *span)
        for recording, span in zip(recordings, spans, strict=True)
        if span[1] > span[0]
    ]


def slow_and_fast(problem: Problem) -> tuple[Spans, Spans]:
    """Return the slower and the faster part of each training log, as times [s]."""
    slow, fast = [], []
    for log in problem.logs("training"):
        start, stop = float(log.time[0]), float(log.time[-1])
        ends = [
            (start, start + _SLOW_PART * (stop - start)),
            (start + _SLOW_PART * (stop - start) + _BETWEEN_PARTS, stop),
        ]
        mirrored = [
            (stop - _SLOW_PART * (stop - start), stop),
            (start, stop - _SLOW_PART * (stop - start) - _BETWEEN_PARTS),
        ]
        speeds = [_speed(trimmed(log, *span)) for span in ends]
        first, second = ends if speeds[0] <= speeds[1] else mirrored
        slow.append(first)
        fast.append(second)
    return tuple(slow), tuple(fast)


def _speed(log: Recording) -> float:
    """Return the mean speed over all joints, each over its range."""
    spread = np.ptp(log.position, axis=0)
    moved = abs(np.diff(log.position, axis=0)).sum(axis=0) / log.duration
    return float((moved[spread > 0.0] / spread[spread > 0.0]).mean())


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
