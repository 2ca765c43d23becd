"""Design of exciting trajectories: from a robot and its limits to a path worth playing.

First many searches for the least condition number, then from the best of them for the
least standard errors under a bound on it; no path leaves without the proof that it
keeps its limits at all times.
"""

import os
import time as clock
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._interrupts import Asked, noted_interrupts
from consistent_id._threads import single_threaded
from consistent_id.base import BaseParameters, ConditionNumber, base_parameters
from consistent_id.collisions.scene import Scene
from consistent_id.errors import InfeasibleError, NotExcitedError, ProblemError
from consistent_id.excitation.accuracy import PredictedAccuracy, predicted_accuracy
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.criteria import Objective, criterion_of, scaled
from consistent_id.excitation.search import Found, Searcher
from consistent_id.excitation.search_task import SearchTask, search_task
from consistent_id.excitation.starts import Job, Outcome, run_searches
from consistent_id.excitation.verification import Demands, Proof, demands
from consistent_id.model import RobotModel
from consistent_id.motion.limits import MotionLimits, motion_limits
from consistent_id.regressor import TorqueModel
from consistent_id.tables import Table
from consistent_id.trajectory import FourierTrajectory

_FIRST = 0.6  # share of the time limit after which the first of two stages ends
_SECOND = 0.9  # share after which the last stage ends
_REFINED = 2  # paths that go on to the second stage, however many workers there are
_COMPARED = 8  # random paths at most that the design is compared with
_ATTEMPTS = 4  # at a proof, each with less of the limits to use
_LEAST = 0.01  # rad or m; a joint that can move less is not excited


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """What one stage of a design has found, proven to keep all limits.

    Parameters
    ----------
    objective : str
    trajectory : FourierTrajectory
    value : float
        The objective's own: a condition number, or a size of standard errors.
    accuracy : PredictedAccuracy
        At all samples that will be recorded.
    proof : Proof
    number : int
        Of the search that found it, from 0.
    """

    objective: str
    trajectory: FourierTrajectory
    value: float
    accuracy: PredictedAccuracy
    proof: Proof
    number: int


@dataclass(frozen=True, slots=True, eq=False)
class ExcitationDesign:
    """A trajectory worth playing, and all that is known of it.

    Parameters
    ----------
    model : TorqueModel
    base : BaseParameters
    demands : Demands
    form : PathForm
    aim : Aim
    stages : tuple of Stage
        The last one's trajectory is the design's.
    unoptimised : PredictedAccuracy
        Of the best of the random paths that the searches began with.
    seed, starts : int
    seconds : float
    notes : tuple of str
    """

    model: TorqueModel
    base: BaseParameters
    demands: Demands
    form: PathForm
    aim: Aim
    stages: tuple[Stage, ...]
    unoptimised: PredictedAccuracy
    seed: int
    starts: int
    seconds: float
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        verdict = "all limits proven" if self.proof.holds else "limits not proven"
        return (
            f"ExcitationDesign({self.model.robot.name!r}: {verdict}, "
            f"{self.form.duration:.4g} s, condition number "
            f"{self.condition.value:.4g} (random path: "
            f"{self.unoptimised.condition.value:.4g}))"
        )

    def _repr_html_(self) -> str:
        return Table(repr(self), (), (), self.notes).html()

    @property
    def limits(self) -> MotionLimits:
        """The limits of its motion."""
        return self.demands.limits

    @property
    def trajectory(self) -> FourierTrajectory:
        """The path to play."""
        return self.stages[-1].trajectory

    @property
    def accuracy(self) -> PredictedAccuracy:
        """What recording it will tell."""
        return self.stages[-1].accuracy

    @property
    def condition(self) -> ConditionNumber:
        """Condition number of its base regressor."""
        return self.accuracy.condition

    @property
    def proof(self) -> Proof:
        """What is proven of it."""
        return self.stages[-1].proof


@single_threaded
def design_trajectory(
    model: TorqueModel | RobotModel,
    form: PathForm | None = None,
    aim: Aim | None = None,
    *,
    limits: MotionLimits | None = None,
    parameters: ArrayLike | None = None,
    scene: Scene | None = None,
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
    scene : Scene, optional
        Bodies that must stay apart; without it collisions are not looked at.
    starts : int
        Searches from random paths.
    time_limit : float, [s]
        For the searches; a proof that fails adds to it.
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
    began = clock.monotonic()
    model = TorqueModel(model) if isinstance(model, RobotModel) else model
    form, aim = form or PathForm(), aim or Aim()
    limits = motion_limits(model.robot) if limits is None else limits
    workers = _require_sensible(starts, time_limit, seed, workers)
    asked = demands(model, limits, parameters, scene)
    _require_long_enough(form, aim, asked.limits)
    base = base_parameters(model)
    task = search_task(model, base, form, aim, asked.limits, asked.guards)
    task = replace(task, seed=seed)
    with noted_interrupts() as interrupted:
        workshop = _Workshop(task, asked, aim, workers, time_limit, progress)
        settled = workshop.stages(starts, interrupted)
        unoptimised = _unoptimised(task, aim, starts)
    cut_short = any(one.cut_short for one in settled)
    notes = asked.notes
    if aim.refine not in (None, aim.objective) and len(settled) == 1:
        notes += (f"no path better by {aim.refine} was found within the limits",)
    if aim.scaling == "unit columns" and aim.refine is None:
        notes += (
            "with unit columns a condition number alone may leave a joint almost "
            "still; refine with D, A or E",
        )
    if cut_short:
        notes += ("time or the user ended the search; another run may differ",)
    return ExcitationDesign(
        model=model,
        base=base,
        demands=asked,
        form=form,
        aim=aim,
        stages=tuple(one.stage for one in settled),
        unoptimised=unoptimised,
        seed=seed,
        starts=settled[0].starts,
        seconds=clock.monotonic() - began,
        notes=notes,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Settled:
    """A stage's result: the best that is proven, then what else was found."""

    stage: Stage
    found: tuple[Found, ...]
    starts: int
    cut_short: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Workshop:
    """Searches, and the proof that what they find keeps its limits."""

    task: SearchTask
    demands: Demands
    aim: Aim
    workers: int
    time_limit: float
    progress: bool

    def stages(self, starts: int, interrupted: Asked) -> list[_Settled]:
        """Search for the objective, then from the best for the second one."""
        now, refine = clock.time(), self.aim.refine
        single = refine in (None, self.aim.objective)
        jobs = [Job(self.aim.objective, number) for number in range(starts)]
        share = _SECOND if single else _FIRST
        settled = [self.stage(jobs, now + share * self.time_limit, interrupted)]
        if refine is None or single or interrupted():
            return settled
        jobs, deadline = self.refining(settled[0], refine), _SECOND * self.time_limit
        try:
            settled.append(self.stage(jobs, now + deadline, interrupted))
        except (InfeasibleError, KeyboardInterrupt):
            pass  # a proven path is there already
        return settled

    def stage(self, jobs: list[Job], deadline: float, interrupted: Asked) -> _Settled:
        """Search; where no path can be proven, search on with less to use."""
        task, starts, cut_short = self.task, 0, False
        for _ in range(_ATTEMPTS):
            outcome = run_searches(
                task,
                jobs,
                workers=self.workers,
                deadline=deadline,
                interrupted=interrupted,
                progress=self.progress,
            )
            starts = starts or len(outcome.found)
            cut_short |= outcome.interrupted or outcome.out_of_time
            usable = [one for one in outcome.found if one.variables is not None]
            if not usable and outcome.interrupted:
                raise KeyboardInterrupt  # before there was anything to keep
            if not usable:
                raise _nothing_found(outcome)
            for one in usable:
                stage = self._proven(jobs[0].objective, one)
                if stage is not None:
                    others = (other for other in usable if other is not one)
                    return _Settled(stage, (one, *others), starts, cut_short)
            if outcome.interrupted:
                break
            task = replace(task, guards=tuple(g.tightened() for g in task.guards))
            bound = {job.number: job.spread_bound for job in jobs}
            jobs = [
                Job(jobs[0].objective, one.number, one.variables, bound[one.number])
                for one in usable[:_REFINED]
            ]
            deadline = max(deadline, clock.time() + 0.3 * self.time_limit)
        self.demands.proof(self._path(usable[0])).require()
        raise InfeasibleError("no path was found that keeps all limits")

    def refining(self, first: _Settled, objective: Objective) -> list[Job]:
        """Return searches from the best paths, bounded in how far they worsen."""
        searcher = Searcher(self.task)
        best = np.asarray(first.found[0].variables)
        bound = searcher.score("condition", best) + float(np.log(self.aim.growth))
        return [
            Job(objective, one.number, one.variables, bound)
            for one in first.found[:_REFINED]
        ]

    def _path(self, found: Found) -> FourierTrajectory:
        variables = np.asarray(found.variables)
        return self.task.basis.trajectory(variables)

    def _proven(self, objective: Objective, found: Found) -> Stage | None:
        path = self._path(found)
        proof = self.demands.proof(path)
        if not proof.holds:
            return None
        accuracy = predicted_accuracy(self.task.model, self.task.base, path, self.aim)
        if not np.isfinite(accuracy.condition.value) and not self.aim.recordings:
            raise NotExcitedError(
                "no motion within the limits tells all base parameters apart; nothing "
                f"is known of {accuracy.weakest}. Look at the ranges and velocities of "
                "the joints that these belong to, and at their friction terms"
            )
        value = self._value(objective, accuracy)
        return Stage(objective, path, value, accuracy, proof, found.number)

    def _value(self, objective: Objective, accuracy: PredictedAccuracy) -> float:
        """Return the objective's own value at all samples that will be recorded."""
        M = accuracy.factor.T @ accuracy.factor + accuracy.earlier.T @ accuracy.earlier
        criterion = criterion_of(objective, np.inf, self.task.gram)
        if objective == "condition":
            criterion = scaled(criterion, self.task.scaling)
        return float(np.exp(criterion(M).value))


def _require_sensible(
    starts: int, time_limit: float, seed: int, workers: int | None
) -> int:
    """Return the number of processes; refuse what makes no sense before any work."""
    for name, value, least in (
        ("starts", starts, 1),
        ("seed", seed, 0),
        ("workers", 1 if workers is None else workers, 1),
    ):
        if not isinstance(value, int | np.integer) or value < least:
            raise ProblemError(f"{name} is {value!r}, expected {least} or more, whole")
    if not 0.0 < time_limit < np.inf:
        raise ProblemError(f"time_limit is {time_limit} s, expected more than 0")
    return min(workers or _processors(), starts)


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


def _nothing_found(outcome: Outcome) -> InfeasibleError:
    if not outcome.found:
        return InfeasibleError(
            "time was over before any path was found; give a longer time_limit"
        )
    obstacles = sorted({one.offence for one in outcome.found if one.offence})
    more = "give a longer time_limit, " if outcome.out_of_time else ""
    return InfeasibleError(
        f"{len(outcome.found)} searches found no path that keeps "
        f"{', '.join(obstacles)} within its limit; {more}raise it, or narrow the "
        "joints' ranges to where less is needed"
    )


def _unoptimised(task: SearchTask, aim: Aim, starts: int) -> PredictedAccuracy:
    searcher = Searcher(task)
    numbers = range(min(starts, _COMPARED))
    paths = [task.basis.trajectory(searcher.random(number)) for number in numbers]
    told = [predicted_accuracy(task.model, task.base, path, aim) for path in paths]
    return min(told, key=lambda accuracy: accuracy.condition.value)


def _processors() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
