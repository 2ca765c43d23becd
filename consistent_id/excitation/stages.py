"""Stages of a design: searches, and the proof of what they find."""

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from consistent_id._support.interrupts import Interrupted
from consistent_id.errors import InfeasibleError, NotExcitedError
from consistent_id.excitation.accuracy import PredictedAccuracy, predicted_accuracy
from consistent_id.excitation.aims import Aim
from consistent_id.excitation.designed import Stage
from consistent_id.excitation.search import Candidate
from consistent_id.excitation.search_problem import SearchProblem
from consistent_id.excitation.searches import run_searches
from consistent_id.excitation.verification import Demands, Proof
from consistent_id.recordings.trajectory import FourierTrajectory

_FIRST = 0.6  # share of the time limit after which the first of two stages ends
_LAST = 0.9  # share after which the last stage ends
_MORE = 0.3  # share that searches get at least after a proof has failed
_REFINED = 2  # paths that go on to the second stage, however many workers there are
_ATTEMPTS = 4  # at a proof, each with less of the limits to use


class _NothingYet(KeyboardInterrupt):
    """The user ended a search before it had anything to keep."""


RunSearches = Callable[..., tuple[Candidate, ...]]
Prove = Callable[[FourierTrajectory], Proof]


def design_stages(
    problem: SearchProblem,
    demands: Demands,
    aim: Aim,
    *,
    starts: int,
    workers: int,
    time_limit: float,
    interrupted: Interrupted,
    progress: bool,
) -> tuple[Stage, ...]:
    """Search for the aim's objective, then from the best paths for the second one.

    Raises
    ------
    InfeasibleError
        If no path was found that keeps the limits; it names the one in the way.
    NotExcitedError
        If no motion within the limits identifies all base parameters.
    """
    began = clock.monotonic()
    run = partial(
        run_searches, workers=workers, interrupted=interrupted, progress=progress
    )
    prove = _proving_once(demands)

    def stage(problem: SearchProblem, starts: Sequence[Candidate], end: float) -> Stage:
        deadline, more = began + end * time_limit, _MORE * time_limit
        return _stage(problem, starts, prove, aim, run, interrupted, deadline, more)

    refine = None if aim.refine == aim.objective else aim.refine
    random = [Candidate(number) for number in range(starts)]
    first = stage(problem, random, _LAST if refine is None else _FIRST)
    if refine is None or interrupted():
        return (first,)
    best = first.candidates[:_REFINED]
    spread = problem.score("condition", np.asarray(best[0].variables))
    bound = spread + float(np.log(aim.growth))
    try:
        second = replace(problem, objective=refine, spread_bound=bound)
        return first, stage(second, best, _LAST)
    except (InfeasibleError, _NothingYet):
        return (first,)  # a proven path is there already


def _proving_once(demands: Demands) -> Prove:
    """Return what proves paths, each once: a second stage may end where it began."""
    proofs: dict[bytes, Proof] = {}

    def prove(path: FourierTrajectory) -> Proof:
        key = np.vstack([path.offset, path.sine, path.cosine]).tobytes()
        if key not in proofs:
            proofs[key] = demands.proof(path)
        return proofs[key]

    return prove


def _stage(
    problem: SearchProblem,
    starts: Sequence[Candidate],
    prove: Prove,
    aim: Aim,
    run: RunSearches,
    interrupted: Interrupted,
    deadline: float,
    more: float,
) -> Stage:
    """Search; where no path can be proven, search on with less of the limits."""
    searches, cut_short = 0, False
    proofs: list[Proof] = []
    for _ in range(_ATTEMPTS):
        found = run(problem, starts, deadline=deadline)
        searches = searches or len(found)
        early = len(found) < len(starts) or not all(one.complete for one in found)
        cut_short |= early
        usable = [one for one in found if one.variables is not None]
        if not usable and interrupted():
            raise _NothingYet
        if not usable:
            raise _nothing_found(found, early)
        paths = [problem.basis.trajectory(np.asarray(c.variables)) for c in usable]
        proofs = []
        for one, path in zip(usable, paths, strict=True):
            proofs.append(prove(path))
            if proofs[-1].holds:
                others = (other for other in usable if other is not one)
                candidates = (one, *others)
                return _proven(
                    problem, path, proofs[-1], aim, candidates, searches, cut_short
                )
        if interrupted():
            break
        guards = tuple(guard.tightened() for guard in problem.guards)
        problem, starts = replace(problem, guards=guards), usable[:_REFINED]
        deadline = max(deadline, clock.monotonic() + more)
    proofs[0].require()
    raise InfeasibleError("no path was found that keeps all limits")


def _proven(
    problem: SearchProblem,
    path: FourierTrajectory,
    proof: Proof,
    aim: Aim,
    candidates: tuple[Candidate, ...],
    searches: int,
    cut_short: bool,
) -> Stage:
    """Return the stage of a proven path, with the accuracy of its whole recording."""
    model, base = problem.information.model, problem.information.base
    accuracy = predicted_accuracy(model, base, path, aim)
    if not np.isfinite(accuracy.condition.value) and not aim.recordings:
        raise NotExcitedError(
            "no motion within the limits identifies all base parameters; nothing is "
            f"known of {accuracy.weakest}. Look at the ranges and velocities of the "
            "joints that these belong to, and at their friction terms"
        )
    value = _value(problem, accuracy)
    return Stage(
        problem.objective, path, value, accuracy, proof, candidates, searches, cut_short
    )


def _value(problem: SearchProblem, accuracy: PredictedAccuracy) -> float:
    """Return the objective's own value at all samples that will be recorded."""
    M = accuracy.factor.T @ accuracy.factor + accuracy.earlier.T @ accuracy.earlier
    return float(np.exp(problem.criterion(problem.objective)(M).value))


def _nothing_found(found: Sequence[Candidate], out_of_time: bool) -> InfeasibleError:
    obstacles = sorted({one.obstacle for one in found if one.obstacle})
    more = "give a longer time_limit, " if out_of_time else ""
    return InfeasibleError(
        f"{len(found)} searches found no path that keeps {', '.join(obstacles)} within "
        f"its limit; {more}raise it, or narrow the joints' ranges to where less is "
        "needed"
    )
