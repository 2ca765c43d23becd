"""Stages of a design: searches, and the proof of what they find."""

import time as clock
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.interrupts import Asked
from consistent_id.errors import InfeasibleError, NotExcitedError
from consistent_id.excitation.accuracy import PredictedAccuracy, predicted_accuracy
from consistent_id.excitation.aims import Aim
from consistent_id.excitation.criteria import Objective, criterion_of, scaled
from consistent_id.excitation.designed import Stage
from consistent_id.excitation.search import Found, Searcher
from consistent_id.excitation.search_task import SearchTask
from consistent_id.excitation.starts import Job, Outcome, run_searches
from consistent_id.excitation.verification import Demands
from consistent_id.recordings.trajectory import FourierTrajectory

_FIRST = 0.6  # share of the time limit after which the first of two stages ends
_SECOND = 0.9  # share after which the last stage ends
_REFINED = 2  # paths that go on to the second stage, however many workers there are
_ATTEMPTS = 4  # at a proof, each with less of the limits to use


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """A stage's result: the best that is proven, then what else was found."""

    stage: Stage
    found: tuple[Found, ...]
    starts: int
    cut_short: bool


@dataclass(frozen=True, slots=True, eq=False)
class Workshop:
    """Searches, and the proof that what they find keeps its limits."""

    task: SearchTask
    demands: Demands
    aim: Aim
    workers: int
    time_limit: float
    progress: bool

    def stages(self, starts: int, interrupted: Asked) -> list[Settled]:
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

    def stage(self, jobs: list[Job], deadline: float, interrupted: Asked) -> Settled:
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
                    return Settled(stage, (one, *others), starts, cut_short)
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

    def refining(self, first: Settled, objective: Objective) -> list[Job]:
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
