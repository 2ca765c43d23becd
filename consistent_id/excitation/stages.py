"""Stages of a design: searches, and the proof of their results."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from consistent_id.errors import InfeasibleError, NotExcitedError
from consistent_id.excitation.accuracy import PredictedAccuracy, predicted_accuracy
from consistent_id.excitation.aims import Aim
from consistent_id.excitation.designed import Stage
from consistent_id.excitation.path_search import FoundPath, random_candidate
from consistent_id.excitation.search_problem import SearchProblem
from consistent_id.excitation.searches import Lanes
from consistent_id.excitation.verification import Demands, PathProof
from consistent_id.excitation.work import Meter
from consistent_id.recordings.joint_paths import FourierTrajectory

_TRIAL = 0.1  # share of the work in which one of several forms is tried
_TRIED = 3  # steps that such a trial must have
_FIRST = 0.6  # share of the work after which the first of two stages ends
_LAST = 0.9  # share after which the last stage ends; the rest is for proofs
_AGAIN = 0.05  # share that a search gets at least to leave a path that is unproven
_MORE = 0.3  # the same if that was too little, or if it begins with other paths
_REFINED = 2  # paths that enter the second stage, for any number of lanes
_ATTEMPTS = 4  # tries of a proof, each with lower limits
_WORSE = 0.05  # logarithm by which another path may be worse than an unproven one
_CREST = 2.0  # peak over root mean square, of torque whose peak is not limited
_EQUAL = 1e-9  # difference of logarithms below which two paths are equally good
COMPARED = 8
"""Most random paths that a design must be better than."""


class _NothingYet(KeyboardInterrupt):
    """The user ended a search before it had a result."""


def compared_paths(problem: SearchProblem, starts: int) -> list[FoundPath]:
    """Return the random paths that a design must be better than, best first."""
    count = min(starts, COMPARED)
    found = [random_candidate(problem, number) for number in range(count)]
    return sorted(found, key=lambda one: (one.score, one.number))


@dataclass(frozen=True, slots=True)
class FormTrial:
    """The search of the most promising of several forms, and what it found so far."""

    problem: SearchProblem
    begun: tuple[FoundPath, ...]


def _scored(
    problem: SearchProblem, paths: Sequence[FoundPath]
) -> tuple[FoundPath, ...]:
    """Return candidates of another objective with this one's scores."""
    objective = problem.objective
    return tuple(
        replace(one, score=problem.score(objective, np.asarray(one.variables)))
        for one in paths
    )


def _bound(aim: Aim, reached: float) -> float:
    """Return the bound on the logarithm of the condition number."""
    if aim.condition_at_most is None:
        return reached + float(np.log(aim.growth))
    bound = float(np.log(aim.condition_at_most))
    if reached > bound:
        raise InfeasibleError(
            f"the least condition number found is {np.exp(reached):.4g}, above the "
            f"{aim.condition_at_most:g} that is allowed; allow more, give a longer "
            "time_limit, or wider limits"
        )
    return bound


def _unchanged(first: Stage, problem: SearchProblem) -> Stage:
    """Return a stage that ends where it began."""
    return replace(
        first,
        objective=problem.objective,
        value=_value(problem, first.accuracy),
        candidates=(replace(first.candidates[0], iterations=0),),
        improved=False,
    )


class FormSearch(NamedTuple):
    """The problem of the form that was searched, and the stages of its search."""

    problem: SearchProblem
    stages: tuple[Stage, ...]


class _TriedProof(NamedTuple):
    """A candidate and the proof that was tried."""

    found: FoundPath
    path: FourierTrajectory
    proof: PathProof


class _Again(NamedTuple):
    """A search with lower limits, its starts, and its least share of the work."""

    problem: SearchProblem
    starts: Sequence[FoundPath]
    share: float


@dataclass(slots=True)
class DesignSearch:
    """The search for a design: its stages share proofs and an allowance of work.

    Parameters
    ----------
    demands : Demands
    aim : Aim
    lanes : Lanes
    starts : int
        Random paths to search from.
    meter : Meter
        Allowance of each lane, and the work done so far.
    """

    demands: Demands
    aim: Aim
    lanes: Lanes
    starts: int
    meter: Meter
    _proofs: dict[bytes, PathProof] = field(default_factory=dict, init=False)

    def run(self, problems: Sequence[SearchProblem]) -> FormSearch:
        """Search the most promising of several forms; see `best_form` and `stages`."""
        trial = self.best_form(problems)
        return FormSearch(trial.problem, self.stages(trial))

    def best_form(self, problems: Sequence[SearchProblem]) -> FormTrial:
        """Return the most promising form; each of several has a short search.

        If such a search has hardly a step, for a robot of many bodies, it is the form
        with the fewest frequencies, whose steps take least.
        """
        work = _TRIAL * self.meter.allowed
        least = min(problems, key=lambda one: one.costs.step)
        if len(problems) == 1 or _TRIED * least.costs.step > work:
            return FormTrial(least, ())
        starts = [FoundPath(k) for k in range(min(self.starts, self.lanes.number))]
        tried = [self._run(problem, starts, work) for problem in problems]
        scores = [min((one.score for one in found), default=np.inf) for found in tried]
        k = int(np.argmin(scores))
        begun = tuple(one for one in tried[k] if one.variables is not None)
        return FormTrial(problems[k], begun)

    def stages(self, trial: FormTrial) -> tuple[Stage, ...]:
        """Search for the aim's objectives one after another, each from the best so far.

        Parameters
        ----------
        trial : FormTrial
            Its searches from random paths go on.

        Raises
        ------
        InfeasibleError
            If no path was found that keeps the limits; the message names the violated
            limit.
        NotExcitedError
            If no motion within the limits identifies all base parameters.
        """
        objectives = self.aim.objectives
        going_on = {one.number: one for one in trial.begun}
        last = len(objectives) == 1
        problem = replace(trial.problem, objective=objectives[0])
        known = compared_paths(problem, self.starts)
        drawn = {one.number: problem.drawn(one.number) for one in known}
        self.meter.spent += sum(one.work for one in drawn.values())
        starts = [FoundPath(k) for k in range(self.starts)]
        starts[: len(drawn)] = [
            FoundPath(k, drawn=drawn[k].path) for k in sorted(drawn)
        ]
        random = [going_on.get(one.number, one) for one in starts]
        first = self._stage(problem, random, known, _LAST if last else _FIRST)
        if last or self.lanes.interrupted():
            return (first,)
        best = first.candidates[:_REFINED]
        reached = problem.score("condition", np.asarray(best[0].variables))
        second = replace(
            problem, objective=objectives[1], spread_bound=_bound(self.aim, reached)
        )
        try:
            return first, self._stage(second, best, _scored(second, best[:1]), _LAST)
        except (InfeasibleError, _NothingYet):
            return first, _unchanged(first, second)

    def _run(
        self, problem: SearchProblem, starts: Sequence[FoundPath], work: float
    ) -> tuple[FoundPath, ...]:
        """Run searches, and count their work."""
        found = self.lanes.run(problem, starts, work)
        self.meter.spent += self.lanes.spent(found, starts)
        return found

    def _proof(self, path: FourierTrajectory) -> PathProof:
        """Prove a path, each once: a second stage may end at its start."""
        key = np.vstack([path.offset, path.sine, path.cosine]).tobytes()
        if key not in self._proofs:
            self._proofs[key] = self.demands.proof(path)
        return self._proofs[key]

    def _stage(
        self,
        problem: SearchProblem,
        starts: Sequence[FoundPath],
        known: Sequence[FoundPath],
        share: float,
    ) -> Stage:
        """Search; if no path can be proven, continue with lower limits.

        `known` are paths that keep the limits already: no worse one is returned.
        """
        interrupted, meter = self.lanes.interrupted, self.meter
        work = max(share * meter.allowed - meter.spent, 0.0)
        searches, cut_short = 0, False
        proofs: list[PathProof] = []
        for attempt in range(_ATTEMPTS):
            found = self._run(problem, starts, work)
            if attempt and not _usable(found):
                found = self._run(problem, starts, _MORE * meter.allowed)
            searches = searches or len(found)
            early = len(found) < len(starts) or not all(one.complete for one in found)
            cut_short |= early
            usable = _usable([*found, *known])
            if not usable and interrupted():
                raise _NothingYet
            if not usable:
                raise _nothing_found(found, early)
            last = attempt == _ATTEMPTS - 1 or interrupted()
            tried = self._tried(problem, usable, np.inf if last else _WORSE)
            one, path, proof = tried[-1]
            if proof.holds:
                best = min((path.score for path in known), default=np.inf)
                accuracy = self._accuracy(problem, path)
                return Stage(
                    objective=problem.objective,
                    trajectory=path,
                    value=_value(problem, accuracy),
                    accuracy=accuracy,
                    proof=proof,
                    candidates=(one, *_others(one, found)),
                    searches=searches,
                    cut_short=cut_short,
                    improved=one.score < best - _EQUAL,
                )
            proofs += [one.proof for one in tried]
            if interrupted():
                break
            again = self._tightened(problem, usable, proofs, tried[0].proof)
            problem, starts = again.problem, again.starts
            least = again.share * meter.allowed
            work = max(share * meter.allowed - meter.spent, least)
        proofs[0].require()
        raise InfeasibleError("no path was found that keeps all limits")

    def _tried(
        self, problem: SearchProblem, usable: Sequence[FoundPath], worse: float
    ) -> list[_TriedProof]:
        """Try to prove candidates, best first, until a proof holds.

        None is tried whose score is worse than the best one's by more than `worse`.
        """
        tried: list[_TriedProof] = []
        for one in usable:
            if one.score > usable[0].score + worse:
                break
            path = problem.basis.trajectory(np.asarray(one.variables))
            tried.append(_TriedProof(one, path, self._proof(path)))
            if tried[-1].proof.holds:
                break
        return tried

    def _tightened(
        self,
        problem: SearchProblem,
        usable: Sequence[FoundPath],
        proofs: Sequence[PathProof],
        best: PathProof,
    ) -> _Again:
        """Return the search with limits that are lower where proofs failed.

        It goes on from the best paths, which are near to paths that keep these limits;
        but it begins anew if torque of the best one violates a limit over time: for
        such limits they are far away.
        """
        near = [p.clearance for p in proofs if p.clearance is not None]
        failed = [(c.first, c.second) for c in near if not c.holds]
        peaks = _allowed_peaks(best)
        guards = tuple(g.tightened(failed, peaks) for g in problem.guards)
        problem = replace(problem, guards=guards)
        if peaks:
            anew = [FoundPath(number) for number in range(self.starts)]
            return _Again(problem, anew, _MORE)
        return _Again(problem, usable[:_REFINED], _AGAIN)

    def _accuracy(
        self, problem: SearchProblem, path: FourierTrajectory
    ) -> PredictedAccuracy:
        """Return the accuracy of the whole recording of a proven path."""
        model, base = problem.information.model, problem.information.base
        accuracy = predicted_accuracy(model, base, path, self.aim)
        if not np.isfinite(accuracy.condition.value) and not self.aim.recordings:
            raise NotExcitedError(
                "no motion within the limits identifies all base parameters; nothing "
                f"is known of {accuracy.weakest}. Look at the ranges and velocities of "
                "the joints that these belong to, and at their friction terms"
            )
        return accuracy


def _allowed_peaks(proof: PathProof) -> dict[str, float]:
    """Return peak limits for joints whose torque violates a limit over time.

    Rates and root mean squares are not rows of a search: they decrease with the peak.
    """
    margins = proof.margins.margins
    reached = {m.joint: m.bound for m in margins if m.quantity == "torque"}
    peaks: dict[str, float] = {}
    for margin in margins:
        if margin.quantity in ("torque rate", "torque RMS") and not margin.holds:
            peak = reached.get(margin.joint, _CREST * margin.limit)
            peak *= margin.limit / margin.bound
            peaks[margin.joint] = min(peak, peaks.get(margin.joint, np.inf))
    return peaks


def _usable(found: Sequence[FoundPath]) -> list[FoundPath]:
    """Return the candidates with a path, best first."""
    usable = [one for one in found if one.variables is not None]
    return sorted(usable, key=lambda one: one.score)


def _others(one: FoundPath, found: Sequence[FoundPath]) -> list[FoundPath]:
    """Return the searches' results without one of them."""
    return [
        other
        for other in found
        if other.variables is not None and other.number != one.number
    ]


def _value(problem: SearchProblem, accuracy: PredictedAccuracy) -> float:
    """Return the objective's own value at all samples that will be recorded."""
    M = accuracy.factor.T @ accuracy.factor + accuracy.earlier.T @ accuracy.earlier
    return float(np.exp(problem.criterion(problem.objective)(M).value))


def _nothing_found(found: Sequence[FoundPath], out_of_time: bool) -> InfeasibleError:
    obstacles = sorted({one.obstacle for one in found if one.obstacle})
    more = "give a longer time_limit, " if out_of_time else ""
    torque = any(text.startswith("torque") for text in obstacles)
    left = ". Without parameters, friction_share of it is reserved" if torque else ""
    return InfeasibleError(
        f"{len(found)} searches found no path that keeps {', '.join(obstacles)} within "
        f"its limit; {more}raise it, or narrow the joints' ranges to where less is "
        f"needed{left}"
    )
