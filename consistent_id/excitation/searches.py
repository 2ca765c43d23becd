"""Searches from many starts, side by side, none of whose work is lost.

Starts are dealt to lanes, every so many-th to each, and each lane has an allowance of
work of its own.  So what is found depends on neither the clock nor on where lanes are
run.
"""

from collections.abc import Sequence
from contextlib import closing
from functools import partial

import numpy as np

from consistent_id._support.executors import Executor
from consistent_id._support.interrupts import Interrupted
from consistent_id._support.progress import counted
from consistent_id.excitation.lanes import run_lane, run_lane_elsewhere
from consistent_id.excitation.reports import read_reports, report_folder
from consistent_id.excitation.search import Candidate
from consistent_id.excitation.search_problem import SearchProblem


def run_searches(
    problem: SearchProblem,
    starts: Sequence[Candidate],
    *,
    lanes: int,
    work: float,
    interrupted: Interrupted,
    executor: Executor | None = None,
    progress: bool = False,
) -> tuple[Candidate, ...]:
    """Run searches until all are done, their work is spent or the user interrupts.

    What is found comes back best first; fewer than the starts, if some never began or
    were lost with a process that was killed.

    Parameters
    ----------
    problem : SearchProblem
    starts : sequence of Candidate
    lanes : int
        Shares of the starts; what is found depends on their number.
    work : float
        Of each lane, see `Meter`; its first start begins in any case.
    interrupted : callable
        Returns whether the user has asked to end.
    executor : Executor, optional
        Where lanes are run; what is found does not depend on it.  By default one in
        this process, and each other one in a process of its own.
    progress : bool
        Show a bar with the best value so far.
    """
    dealt = [list(starts[k::lanes]) for k in range(min(lanes, len(starts)))]
    with (
        report_folder(None if executor is None else executor.place) as folder,
        counted(len(starts), "starts", progress) as count,
    ):

        def show() -> None:
            found = list(read_reports(folder))
            if found:
                best = np.exp(min(one.score for one in found))
                complete = sum(one.complete for one in found)
                count(complete, f"(best {problem.objective}: {best:.4g})")

        here = _here(executor, len(dealt))
        others = Executor("processes") if executor is None else executor
        elsewhere = partial(run_lane_elsewhere, problem, work, folder)
        found: list[Candidate] = []
        with closing(others.as_done(elsewhere, dealt[here:])) as looks:
            next(looks, None)  # they begin
            for lane in dealt[:here]:
                found += run_lane(problem, lane, work, folder, interrupted, show)
            while not interrupted() and (done := next(looks, None)) is not None:
                found += [one for lane in done.values() for one in lane]
                show()
        known = {one.number: one for one in [*read_reports(folder), *found]}
    return tuple(sorted(known.values(), key=lambda one: (one.score, one.number)))


def _here(executor: Executor | None, lanes: int) -> int:
    """Return how many of the lanes are run in this process."""
    if executor is None:
        return 1
    return lanes if executor.kind == "serial" else 0


def lane_work(
    found: Sequence[Candidate], starts: Sequence[Candidate], lanes: int
) -> float:
    """Return the work of the lane that did most."""
    work = {one.number: one.work for one in found}
    dealt = (starts[k::lanes] for k in range(lanes))
    return max(sum(work.get(one.number, 0.0) for one in lane) for lane in dealt)
