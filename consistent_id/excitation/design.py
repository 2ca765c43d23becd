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

from consistent_id._threads import single_threaded
from consistent_id.base import BaseParameters, ConditionNumber, base_parameters
from consistent_id.collisions.scene import Scene
from consistent_id.errors import InfeasibleError, NotExcitedError, ProblemError
from consistent_id.excitation.accuracy import PredictedAccuracy, predicted_accuracy
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.criteria import Objective
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
    seed : int
        Of the search that found it.
    """

    objective: str
    trajectory: FourierTrajectory
    value: float
    accuracy: PredictedAccuracy
    proof: Proof
    seed: int


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
    began, now = clock.monotonic(), clock.time()
    model = TorqueModel(model) if isinstance(model, RobotModel) else model
    form, aim = form or PathForm(), aim or Aim()
    limits = motion_limits(model.robot) if limits is None else limits
    _require_long_enough(form, aim, limits)
    asked = demands(model, limits, parameters, scene)
    base, notes = base_parameters(model), asked.notes
    task = search_task(model, base, form, aim, limits, asked.guards)
    workers = min(workers or _processors(), max(starts, 1))
    workshop = _Workshop(task, asked, aim, workers, time_limit, progress)
    jobs = [Job(aim.objective, seed + k) for k in range(starts)]
    share = _SECOND if aim.refine in (None, aim.objective) else _FIRST
    first = workshop.stage(jobs, now + share * time_limit)
    stages, outcomes = [first.stage], [first.outcome]
    refine = aim.refine not in (None, aim.objective) and not first.outcome.interrupted
    if refine:
        try:
            second = workshop.stage(
                workshop.refining(first), now + _SECOND * time_limit
            )
        except InfeasibleError:
            notes += (f"no path better by {aim.refine} was found within the limits",)
        else:
            stages.append(second.stage)
            outcomes.append(second.outcome)
    if any(outcome.interrupted or outcome.out_of_time for outcome in outcomes):
        notes += ("time or the user ended the search; another run may differ",)
    return ExcitationDesign(
        model=model,
        base=base,
        demands=asked,
        form=form,
        aim=aim,
        stages=tuple(stages),
        unoptimised=_unoptimised(task, aim, jobs),
        seed=seed,
        starts=len(first.outcome.found),
        seconds=clock.monotonic() - began,
        notes=notes,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Settled:
    stage: Stage
    found: tuple[Found, ...]
    outcome: Outcome


@dataclass(frozen=True, slots=True, eq=False)
class _Workshop:
    """Searches, and the proof that what they find keeps its limits."""

    task: SearchTask
    demands: Demands
    aim: Aim
    workers: int
    time_limit: float
    progress: bool

    def stage(self, jobs: list[Job], deadline: float) -> _Settled:
        """Search; where no path can be proven, search on with less to use."""
        task = self.task
        for _ in range(_ATTEMPTS):
            outcome = run_searches(
                task,
                jobs,
                workers=self.workers,
                deadline=deadline,
                progress=self.progress,
            )
            usable = [one for one in outcome.found if one.variables is not None]
            if not usable:
                raise _nothing_found(outcome)
            objective = jobs[0].objective
            stages = (self._proven(objective, one) for one in usable)
            for stage in stages:
                if stage is not None:
                    return _Settled(stage, tuple(usable), outcome)
            task = replace(task, guards=tuple(g.tightened() for g in task.guards))
            bound = {job.seed: job.spread_bound for job in jobs}
            jobs = [
                Job(objective, one.seed, one.variables, bound[one.seed])
                for one in usable[:_REFINED]
            ]
            deadline = max(deadline, clock.time() + 0.3 * self.time_limit)
        self.demands.proof(self._path(usable[0])).require()
        raise InfeasibleError("no path was found that keeps all limits")

    def refining(self, first: _Settled) -> list[Job]:
        """Return searches from the best paths, bounded in how far they worsen."""
        objective = self.aim.refine
        if objective is None:
            return []
        searcher = Searcher(self.task)
        starts = first.found[:_REFINED]
        least = min(
            searcher.score("condition", np.asarray(one.variables)) for one in starts
        )
        bound = least + float(np.log(self.aim.growth))
        return [Job(objective, one.seed, one.variables, bound) for one in starts]

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
        value = float(np.exp(found.score))
        return Stage(objective, path, value, accuracy, proof, found.seed)


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


def _unoptimised(task: SearchTask, aim: Aim, jobs: list[Job]) -> PredictedAccuracy:
    searcher = Searcher(task)
    paths = [task.basis.trajectory(searcher.random(job.seed)) for job in jobs[:8]]
    told = [predicted_accuracy(task.model, task.base, path, aim) for path in paths]
    return min(told, key=lambda accuracy: accuracy.condition.value)


def _processors() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
