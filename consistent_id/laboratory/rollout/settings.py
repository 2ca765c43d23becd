"""Settings of a torque fit, chosen by rollouts of motion that it has not seen.

Overfitting is the danger: what explains slow motion need not hold for fast.  So the fit
learns from the slower part of the training data and is judged by its rollouts of the
faster part, and the other way round.  One setting is changed at a time, from a plain
start.
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
from consistent_id.estimation.constrained import constrained_least_squares
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.method import Method
from consistent_id.laboratory.rollout.replay import replay, replayable
from consistent_id.laboratory.rollout.replay_model import replay_model
from consistent_id.problems.problem import Problem, problem_of
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains, trimmed
from consistent_id.regression.base import base_parameters
from consistent_id.regression.noise import joint_noise
from consistent_id.regression.regression import Regression, build_regression

CUTOFFS = (5.0, 7.5, 10.0, 15.0, 20.0, 30.0)  # Hz, of motion and torque
SCALES = (0.01, 0.02, 0.05, 0.1)  # rad/s or m/s, of the change of sign of friction
DELAYS = (0.0, 0.0025, 0.005, 0.0075, 0.01, 0.015)  # s, of commands

WORTH = 0.025
"""Relative gain that friction which varies with position must bring: the floor that was
found for other terms of a model, so that they are not chosen by chance."""

_SLOW = 0.6  # of the training time is the slower part
_GUARD = 0.2  # s between the parts
_PASSES = 2  # over all settings; the second seldom changes one


@dataclass(frozen=True, slots=True)
class Settings:
    """What a torque fit of commands depends on besides its data.

    Parameters
    ----------
    cutoff : float, [Hz]
        Of motion and torque.
    velocity_scale : float, [rad/s or m/s]
    friction_slope : bool
        Whether friction varies with position.
    delay : float, [s]
        Of commands.
    """

    cutoff: float = 10.0
    velocity_scale: float = 0.05
    friction_slope: bool = False
    delay: float = 0.0


@dataclass(frozen=True, slots=True)
class SettingsChoice:
    """Settings, and what they were chosen by.

    Parameters
    ----------
    settings : Settings
    error : float, [rad or m]
        Of rollouts of the part that was not learnt from, both ways; the least of all
        that were tried, so optimistic.
    tried : tuple of (Settings, float)
    """

    settings: Settings
    error: float
    tried: tuple[tuple[Settings, float], ...]


def _between(best: Settings, error: Callable[[Settings], float]) -> float:
    """Return the delay at which a parabola through the best three is lowest [s]."""
    place = DELAYS.index(best.delay) if best.delay in DELAYS else 0
    if not 0 < place < len(DELAYS) - 1:
        return best.delay
    at = np.array(DELAYS[place - 1 : place + 2])
    values = [error(replace(best, delay=float(delay))) for delay in at]
    if not np.isfinite(values).all():
        return best.delay
    bend, slope, _ = np.polyfit(at - best.delay, values, 2)
    lowest = best.delay - slope / (2.0 * bend) if bend > 0.0 else best.delay
    return round(float(np.clip(lowest, at[0], at[-1])), 5)


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
        "friction_slope": settings.friction_slope,
        "coulomb": "tanh",
    }
    preparation = change(
        table.data.preparation,
        motion_cutoff=settings.cutoff,
        torque_cutoff=settings.cutoff,
    )
    data = change(
        table.data,
        gains=change(table.data.gains, delay=settings.delay),
        preparation=preparation,
    )
    joints = {name: change(joint, **drives) for name, joint in table.joints.items()}
    changed = change(
        table, data=data, drive=change(table.drive, **drives), joints=joints
    )
    file = problem.source or problem.folder / "problem.toml"
    made = problem_of(changed, file)
    made._read.update(problem._read)
    return replace(made, source=problem.source)


def chosen_settings(problem: Problem, start: Settings | None = None) -> SettingsChoice:
    """Choose the settings of a problem on its training data alone.

    Parameters
    ----------
    problem : Problem
        With gains.
    start : Settings, optional

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
            tried[settings] = _crossed(with_settings(problem, settings), parts)
        return tried[settings]

    best = Settings() if start is None else start
    for _ in range(_PASSES):
        before = best
        for name, values in (
            ("delay", DELAYS),
            ("cutoff", _cutoffs(problem)),
            ("velocity_scale", SCALES),
        ):
            candidates = [replace(best, **{name: value}) for value in values]  # type: ignore[arg-type]
            best = min((best, *candidates), key=error)
        other = replace(best, friction_slope=not best.friction_slope)
        plain, sloped = sorted((best, other), key=lambda s: s.friction_slope)
        best = sloped if error(sloped) < (1.0 - WORTH) * error(plain) else plain
        if best == before:
            break
    best = min((best, replace(best, delay=_between(best, error))), key=error)
    if not np.isfinite(error(best)):
        raise RecordingError(
            f"problem {problem.name!r}: with no settings the rollouts stay near the "
            "robot; check gains, columns and units"
        )
    return SettingsChoice(best, error(best), tuple(tried.items()))


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
    return estimate, regression


Spans = tuple[tuple[float, float], ...]


def within(recordings: Sequence[Recording], spans: Spans) -> list[Recording]:
    """Return what lies within spans of time, of each recording its own span."""
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
            (start, start + _SLOW * (stop - start)),
            (start + _SLOW * (stop - start) + _GUARD, stop),
        ]
        mirrored = [
            (stop - _SLOW * (stop - start), stop),
            (start, stop - _SLOW * (stop - start) - _GUARD),
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


def _cutoffs(problem: Problem) -> list[float]:
    rates = [log.rate for log in problem.logs("training")]
    return [cutoff for cutoff in CUTOFFS if cutoff < 0.4 * min(rates)]


def _crossed(problem: Problem, parts: tuple[Spans, Spans]) -> float:
    """Return the error of rollouts of each part by a fit to the other."""
    both = [_error(problem, *parts), _error(problem, *reversed(parts))]
    return float(np.sqrt(np.mean(np.square(both))))


def _error(problem: Problem, learnt: Spans, judged: Spans) -> float:
    """Return the error of rollouts; infinite if there is no fit, or they diverge."""
    try:
        estimate, _ = torque_fit(problem, within(problem.training, learnt))
    except (InfeasibleError, SolverError):
        return np.inf
    return rollout_error(problem, estimate, within(problem.logs("training"), judged))


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
