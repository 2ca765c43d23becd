"""Lanes: starts that are searched one after another, with work of their own.

A lane's result depends on nothing but the lane.  A process that is killed is replaced:
what it had finished is in the folder, and the start that was under way is searched
again from its beginning, so that the result is the same.
"""

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from consistent_id.excitation.reports import read_reports, times_begun, write_report
from consistent_id.excitation.search import Candidate, search
from consistent_id.excitation.search_problem import SearchProblem

_TRIES = 3  # of a start under way when a process was killed; the executor has one more


def run_lane(
    problem: SearchProblem,
    starts: Sequence[Candidate],
    work: float,
    folder: Path,
    ended: Callable[[], bool],
    show: Callable[[], None] = lambda: None,
) -> tuple[Candidate, ...]:
    """Search from one start after another; what is found goes to the folder, too.

    Parameters
    ----------
    problem : SearchProblem
    starts : sequence of Candidate
    work : float
        For all of them, see `Meter`; the first begins in any case.
    folder : Path
        With what is known of them already.
    ended : callable
        Returns whether to end at once with what there is.
    show : callable
        Called after each start.
    """
    known = {one.number: one for one in read_reports(folder, ended=True)}
    found: list[Candidate] = []
    left = work
    for start in starts:
        if ended() or (left <= 0.0 and found):
            break
        one = known.get(start.number)
        if one is None:
            if times_begun(folder, start.number) > _TRIES:
                continue
            one = search(
                problem,
                start,
                work=left,
                ended=ended,
                report=lambda best: write_report(folder, best, complete=False),
            )
            write_report(folder, one)
        found.append(one)
        left -= one.work
        show()
    return tuple(found)


def run_lane_elsewhere(
    problem: SearchProblem, work: float, folder: Path, starts: Sequence[Candidate]
) -> tuple[Candidate, ...]:
    """Run a lane in another process, for as long as anybody waits for it."""
    main, seen = os.getppid(), folder.exists()

    def ended() -> bool:
        # Nobody tells a worker that the process it works for was killed, or has enough.
        return os.getppid() != main or (seen and not folder.exists())

    return run_lane(problem, starts, work, folder, ended)
