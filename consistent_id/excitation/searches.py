"""Searches from many starts, side by side, none of whose work is lost.

Each process has a lane: every so many-th start, searched one after another with an
allowance of work of its own.  So what is found depends on neither the clock nor on how
processes are scheduled.
"""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from consistent_id._support.interrupts import Interrupted
from consistent_id._support.progress import counted
from consistent_id.excitation.lanes import helped, run_lane
from consistent_id.excitation.reports import read_reports
from consistent_id.excitation.search import Candidate
from consistent_id.excitation.search_problem import SearchProblem


def run_searches(
    problem: SearchProblem,
    starts: Sequence[Candidate],
    *,
    workers: int,
    work: float,
    interrupted: Interrupted,
    progress: bool = False,
) -> tuple[Candidate, ...]:
    """Run searches until all are done, their work is spent or the user interrupts.

    What is found comes back best first; fewer than the starts, if some never began or
    were lost with a process that was killed.

    Parameters
    ----------
    problem : SearchProblem
    starts : sequence of Candidate
    workers : int
        Processes, this one among them.
    work : float
        That each process may do, see `Meter`; the first start begins in any case.
    interrupted : callable
        Returns whether the user has asked to end.
    progress : bool
        Show a bar with the best value so far.
    """
    with (
        TemporaryDirectory(prefix="excitation-") as name,
        counted(len(starts), "starts", progress) as count,
    ):
        folder = Path(name)

        def show() -> None:
            found = list(read_reports(folder))
            if found:
                best = np.exp(min(one.score for one in found))
                complete = sum(one.complete for one in found)
                count(complete, f"(best {problem.objective}: {best:.4g})")

        lanes = [list(starts[k::workers]) for k in range(min(workers, len(starts)))]
        with helped(problem, lanes[1:], work, folder) as helpers:
            run_lane(problem, lanes[0], work, folder, interrupted, show)
            while not interrupted() and helpers.busy():
                show()
        found = list(read_reports(folder))
    return tuple(sorted(found, key=lambda one: (one.score, one.number)))


def lane_work(
    found: Sequence[Candidate], starts: Sequence[Candidate], workers: int
) -> float:
    """Return the work of the process that did most."""
    work = {one.number: one.work for one in found}
    lanes = (starts[k::workers] for k in range(workers))
    return max(sum(work.get(one.number, 0.0) for one in lane) for lane in lanes)
