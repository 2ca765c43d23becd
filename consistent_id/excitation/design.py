"""Design of exciting trajectories: from a robot and its limits to a path worth playing.

First many searches for the least condition number, then from the best of them one for
the least standard errors under a bound on it; last the proof that all limits hold.
"""

import os
import time as clock
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._arrays import Matrix, checked
from consistent_id.base import (
    BaseParameters,
    ConditionNumber,
    base_parameters,
    condition_number,
)
from consistent_id.errors import InfeasibleError, NotExcitedError, ProblemError
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.basis import FourierBasis
from consistent_id.excitation.guards import Guard, TorqueGuard
from consistent_id.excitation.limits import MotionLimits, motion_limits
from consistent_id.excitation.search import BOUND_POWER, Found, Searcher, SearchTask
from consistent_id.excitation.starts import Job, run_searches
from consistent_id.model import RobotModel
from consistent_id.regressor import TorqueModel
from consistent_id.trajectory import FourierTrajectory

_SAMPLES = 100  # of a path at least; and ten per period of the highest frequency
_FIRST = 0.55  # share of the time limit that the first stage may use
_SECOND = 0.85  # share after which the second stage ends
_REACH = 0.99  # share of a torque limit that is used at samples
_LEAST = 0.01  # rad or m; a joint that can move less is not excited


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """What one stage of a design has found.

    Parameters
    ----------
    objective : str
    trajectory : FourierTrajectory
    value : float
        The objective's own: a condition number, or a size of standard errors.
    condition : ConditionNumber
        Of the base regressor, at all samples that will be recorded.
    seed : int
        Of the search that found it.
    """

    objective: str
    trajectory: FourierTrajectory
    value: float
    condition: ConditionNumber
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class ExcitationDesign:
    """A trajectory worth playing, and all that is known of it.

    Parameters
    ----------
    model : TorqueModel
    base : BaseParameters
    limits : MotionLimits
    form : PathForm
    aim : Aim
    stages : tuple of Stage
        The last one's trajectory is the design's.
    unoptimised : ConditionNumber
        Of the best of the random paths that the searches began with.
    seed, starts : int
    seconds : float
    notes : tuple of str
    """

    model: TorqueModel
    base: BaseParameters
    limits: MotionLimits
    form: PathForm
    aim: Aim
    stages: tuple[Stage, ...]
    unoptimised: ConditionNumber
    seed: int
    starts: int
    seconds: float
    notes: tuple[str, ...]

    @property
    def trajectory(self) -> FourierTrajectory:
        """The path to play."""
        return self.stages[-1].trajectory

    @property
    def condition(self) -> ConditionNumber:
        """Condition number of its base regressor."""
        return self.stages[-1].condition


def design_trajectory(
    model: TorqueModel | RobotModel,
    form: PathForm | None = None,
    aim: Aim | None = None,
    *,
    limits: MotionLimits | None = None,
    parameters: ArrayLike | None = None,
    starts: int = 4,
    time_limit: float = 10.0,
    seed: int = 0,
    workers: int | None = None,
    progress: bool = False,
) -> ExcitationDesign:
    """Design an exciting trajectory within a robot's limits.

    Parameters
    ----------
    model : TorqueModel or RobotModel
        A robot alone has rigid-body columns only.
    form : PathForm, optional
        By default 10 s, five harmonics, from rest to rest.
    aim : Aim, optional
        By default the least condition number, then D-optimality.
    limits : MotionLimits, optional
        By default the robot file's.
    parameters : array_like, shape (parameters,) or (members, parameters), optional
        With which torque is predicted and held to its limits, for the worst of them; by
        default the nominal robot without friction.
    starts : int
        Searches from random paths.
    time_limit : float, [s]
        For everything but the proof at the end.
    seed : int
        Same seed, same design, unless time ran out (a note says so).
    workers : int, optional
        Processes; by default one for each processor, at most one for each start.
    progress : bool
        Show a bar; an interrupt ends the search and keeps the best.

    Raises
    ------
    ProblemError
        If limits contradict each other, or the path is too short for them.
    NotExcitedError
        If no motion within the limits tells all base parameters apart.
    InfeasibleError
        If no path was found that keeps the limits; it names the one in the way.
    """
    began, now = clock.monotonic(), clock.time()
    model = TorqueModel(model) if isinstance(model, RobotModel) else model
    form, aim = form or PathForm(), aim or Aim()
    limits = motion_limits(model.robot) if limits is None else limits
    _require_long_enough(form, aim, limits)
    base = base_parameters(model)
    guards, notes = _guards(model, limits, parameters)
    task = _task(model, base, form, aim, limits, guards)
    workers = min(workers or _processors(), max(starts, 1))
    jobs = [Job(aim.objective, seed + k) for k in range(starts)]
    first = run_searches(
        task,
        jobs,
        workers=workers,
        deadline=now + _FIRST * time_limit,
        progress=progress,
    )
    best = _usable(first.found)
    if not best:
        raise _nothing_found(first.found)
    stages = [_stage(task, aim, aim.objective, best[0])]
    cut_short = first.interrupted or first.out_of_time
    if aim.refine is not None and aim.refine != aim.objective and not first.interrupted:
        second = run_searches(
            task,
            _refining(task, aim, best[:workers]),
            workers=workers,
            deadline=now + _SECOND * time_limit,
            progress=progress,
        )
        cut_short |= second.interrupted or second.out_of_time
        if refined := _usable(second.found):
            stages.append(_stage(task, aim, aim.refine, refined[0]))
        else:
            notes += (f"no path was found that is better by {aim.refine}",)
    if cut_short:
        notes += ("time or the user ended the search; another run may differ",)
    return ExcitationDesign(
        model=model,
        base=base,
        limits=limits,
        form=form,
        aim=aim,
        stages=tuple(stages),
        unoptimised=_unoptimised(task, aim, jobs),
        seed=seed,
        starts=len(first.found),
        seconds=clock.monotonic() - began,
        notes=notes,
    )


def path_condition(
    model: TorqueModel, base: BaseParameters, path: FourierTrajectory, aim: Aim
) -> ConditionNumber:
    """Return the condition number of a path's base regressor, as `aim` counts it.

    At the samples that will be recorded; rows are divided by the noise, if it is given.
    """
    W = _base_regressor(model, base, path, aim)
    noise = "" if aim.noise is None else ", rows divided by the noise"
    return condition_number(
        W,
        basis=f"{len(base)} base parameters{noise}",
        unit_columns=aim.scaling == "unit columns",
    )


def _base_regressor(
    model: TorqueModel, base: BaseParameters, path: FourierTrajectory, aim: Aim
) -> Matrix:
    motion = path.recording(aim.rate)
    columns = list(base.independent)
    noise = aim.noise_of(model.torque_joints)
    blocks = [
        Y[:, columns].transpose(0, 2, 1) / noise[:, None, None]
        for _, Y in model.chunks(motion.position, motion.velocity, motion.acceleration)  # type: ignore[arg-type]
    ]
    return np.concatenate([block.reshape(-1, len(columns)) for block in blocks])


def _task(
    model: TorqueModel,
    base: BaseParameters,
    form: PathForm,
    aim: Aim,
    limits: MotionLimits,
    guards: tuple[Guard, ...],
) -> SearchTask:
    basis = FourierBasis(limits, form.frequencies, form.duration, form.rest)
    degree = int(np.ceil(form.frequencies[-1] * form.duration))
    still = basis.trajectory(np.zeros((basis.size, len(limits.joints))))
    columns, noise = list(base.independent), aim.noise_of(model.torque_joints)
    earlier = np.zeros((len(columns), len(columns)))
    for regression in aim.recordings:
        rows = regression.weighted(noise).stacked()[:, columns]
        earlier += rows.T @ rows
    gram = None
    if aim.task is not None:
        log = aim.task.of(model.robot.joint_names)
        Y = model.regressor(log.position, log.velocity, log.acceleration)[:, columns]  # type: ignore[arg-type]
        gram = np.einsum("jps,jqs->pq", Y, Y) / (len(Y) * len(log))
    return SearchTask(
        model=model,
        base=base,
        basis=basis,
        period=still.period,
        samples=max(_SAMPLES, 10 * degree),
        recorded=form.duration * aim.rate,
        noise=noise,
        earlier=earlier,
        scaling=aim.scaling,
        gram=gram,
        guards=guards,
    )


def _guards(
    model: TorqueModel, limits: MotionLimits, parameters: ArrayLike | None
) -> tuple[tuple[Guard, ...], tuple[str, ...]]:
    places = [model.robot.joint_names.index(name) for name in model.torque_joints]
    effort = limits.effort[places]
    if not np.isfinite(effort).any():
        return (), ("torque is not limited",)
    size = len(model.layout)
    if parameters is None:
        nominal = model.robot.nominal
        if nominal is None:
            return (), (
                "torque limits are not looked at: the nominal parameters of some links "
                "are unknown",
            )
        members = np.zeros((1, size))
        members[0, : len(nominal)] = nominal
    else:
        members = np.atleast_2d(checked(parameters, np.shape(parameters), "parameters"))
        if members.ndim != 2 or members.shape[1] != size:
            raise ProblemError(
                f"parameters have shape {np.shape(parameters)}, expected ({size},) or "
                f"(members, {size}) for this torque model"
            )
    return (TorqueGuard(model, members, effort, _REACH),), ()


def _require_long_enough(form: PathForm, aim: Aim, limits: MotionLimits) -> None:
    highest = form.frequencies[-1]
    if highest > 0.5 * aim.rate:
        raise ProblemError(
            f"a path of {form.duration:g} s with frequencies up to {highest:.4g} Hz "
            f"cannot be seen at {aim.rate:g} Hz; make it longer, or take fewer "
            "harmonics"
        )
    # From rest to rest at full speed, or accelerating for half of the time.
    reach = np.minimum(
        limits.velocity * form.duration / 2.0,
        limits.acceleration * form.duration**2 / 8.0,
    )
    j = int(np.argmin(reach))
    if reach[j] < _LEAST:
        raise ProblemError(
            f"in {form.duration:g} s joint {limits.joints[j]!r} can move "
            f"{reach[j]:.2g} rad (or m) within velocity {limits.velocity[j]:g} and "
            f"acceleration {limits.acceleration[j]:g}; make the path longer, or raise "
            "these limits"
        )


def _usable(found: tuple[Found, ...]) -> list[Found]:
    return [one for one in found if one.variables is not None]


def _nothing_found(found: tuple[Found, ...]) -> Exception:
    if not found:
        return InfeasibleError(
            "time was over before any path was found; give a longer time_limit"
        )
    obstacles = sorted({one.offence for one in found if one.offence})
    return InfeasibleError(
        f"{len(found)} searches found no path that keeps {', '.join(obstacles)} within "
        "its limit; raise it, or narrow the joints' ranges to where less is needed"
    )


def _refining(task: SearchTask, aim: Aim, best: list[Found]) -> list[Job]:
    """Return searches from the best paths, under a bound on how far they worsen."""
    assert aim.refine is not None
    searcher = Searcher(task)
    criterion = searcher.criterion("condition", BOUND_POWER)
    jobs = []
    for one in best:
        assert one.variables is not None
        value = criterion(searcher.information(one.variables).matrix).value
        bound = value + float(np.log(aim.growth))
        jobs.append(Job(aim.refine, one.seed, one.variables, bound))
    return jobs


def _stage(task: SearchTask, aim: Aim, objective: str, found: Found) -> Stage:
    assert found.variables is not None
    path = task.basis.trajectory(found.variables)
    condition = path_condition(task.model, task.base, path, aim)
    if not np.isfinite(condition.value):
        raise NotExcitedError(
            "no motion within the limits tells all base parameters apart; look at "
            "ranges, velocities and the friction terms"
        )
    return Stage(objective, path, float(np.exp(found.score)), condition, found.seed)


def _unoptimised(task: SearchTask, aim: Aim, jobs: list[Job]) -> ConditionNumber:
    searcher = Searcher(task)
    paths = [task.basis.trajectory(searcher.random(job.seed)) for job in jobs]
    conditions = [path_condition(task.model, task.base, p, aim) for p in paths]
    return min(conditions, key=lambda condition: condition.value)


def _processors() -> int:
    return (
        len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else (os.cpu_count() or 1)
    )
