"""Lanes: processes, each with starts of its own; one that is killed is replaced."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from consistent_id._support.interrupts import interrupts_ignored
from consistent_id.excitation.reports import (
    begun,
    has_begun,
    has_ended,
    read_reports,
    write_report,
)
from consistent_id.excitation.search import Candidate, search
from consistent_id.excitation.search_problem import SearchProblem

_WAIT = 0.2  # [s] between looks at whether the user has interrupted
_TRIES = 2  # of a start under way when a process was killed


def run_lane(
    problem: SearchProblem,
    starts: Sequence[Candidate],
    work: float,
    folder: Path,
    ended: Callable[[], bool],
    show: Callable[[], None] = lambda: None,
) -> None:
    """Search from one start after another; results go to the folder."""
    left = work
    for start in starts:
        if ended() or (left <= 0.0 and start is not starts[0]):
            return
        begun(folder, start.number)
        found = search(
            problem,
            start,
            work=left,
            ended=ended,
            report=lambda best: write_report(folder, best, complete=False),
        )
        write_report(folder, found)
        left -= found.work
        show()


@contextmanager
def helped(
    problem: SearchProblem,
    lanes: Sequence[Sequence[Candidate]],
    work: float,
    folder: Path,
) -> Iterator["Helpers"]:
    """Search in other processes, a lane each, until the caller has enough."""
    helpers = Helpers(problem, lanes, work, folder)
    try:
        yield helpers
    finally:
        helpers.end()


class Helpers:
    """Processes at work on lanes of starts.

    When one of them is killed, perhaps for want of memory, its lane goes on in a new
    process.  A start that was under way is tried again, from its beginning, so that the
    result is the same; after the second time it is given up.
    """

    def __init__(
        self,
        problem: SearchProblem,
        lanes: Sequence[Sequence[Candidate]],
        work: float,
        folder: Path,
    ) -> None:
        self._problem, self._work, self._folder = problem, work, folder
        self._tries: dict[int, int] = {}  # that were broken, by the start's number
        self._running: dict[Any, Sequence[Candidate]] = {}  # whole lanes
        self._executor: Any = None
        self._submit(lanes)

    def busy(self) -> bool:
        """Wait for a moment; return whether any is still at work."""
        from concurrent.futures.process import BrokenProcessPool

        from loky import wait

        wait(self._running, timeout=_WAIT)
        lost = []
        for future in [future for future in self._running if future.done()]:
            lane = self._running.pop(future)
            try:
                future.result()
            except BrokenProcessPool:
                lost.append(lane)
        if lost:
            # One process that is killed breaks the work of all others.
            lost += self._running.values()
            self._running.clear()
            self._count(lost)
            self._submit(lost)
        return bool(self._running)

    def end(self) -> None:
        """Kill what is still at work."""
        if self._running:
            self._executor.shutdown(wait=False, kill_workers=True)

    def _submit(self, lanes: Sequence[Sequence[Candidate]]) -> None:
        """Begin or go on with lanes."""
        from loky import get_reusable_executor

        spent = {one.number: one.work for one in read_reports(self._folder)}
        for lane in lanes:
            left = [one for one in lane if self._is_left(one)]
            done = [spent[one.number] for one in lane if self._has_ended(one)]
            work = self._work - sum(done)
            if not left or (done and work <= 0.0):
                continue
            with interrupts_ignored():
                self._executor = get_reusable_executor(max_workers=len(lanes))
                call = (_in_worker, self._problem, left, work, self._folder)
                self._running[self._executor.submit(*call)] = lane

    def _has_ended(self, start: Candidate) -> bool:
        return has_ended(self._folder, start.number)

    def _is_left(self, start: Candidate) -> bool:
        tried = self._tries.get(start.number, 0)
        return tried < _TRIES and not self._has_ended(start)

    def _count(self, lanes: Sequence[Sequence[Candidate]]) -> None:
        """Count a try of each start that was under way when processes were killed."""
        for lane in lanes:
            for start in lane:
                begun = has_begun(self._folder, start.number)
                if begun and self._is_left(start):
                    self._tries[start.number] = self._tries.get(start.number, 0) + 1
                    break


def _in_worker(
    problem: SearchProblem, starts: Sequence[Candidate], work: float, folder: Path
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where it was not inherited
    main = os.getppid()

    def ended() -> bool:
        # Nobody tells a worker that the process it works for was killed.
        return os.getppid() != main

    run_lane(problem, starts, work, folder, ended)
