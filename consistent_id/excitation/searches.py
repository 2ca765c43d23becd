"""Searches from many starts, side by side, none of whose work is lost."""

import os
import signal
import threading
import time as clock
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id._support.interrupts import Interrupted
from consistent_id.errors import SolverError
from consistent_id.excitation.search import Candidate, search
from consistent_id.excitation.search_problem import SearchProblem

_WAIT = 0.2  # [s] between looks at whether the user has interrupted


def run_searches(
    problem: SearchProblem,
    starts: Sequence[Candidate],
    *,
    workers: int,
    deadline: float,
    interrupted: Interrupted,
    progress: bool = False,
) -> tuple[Candidate, ...]:
    """Run searches until all are done, time is up or the user interrupts.

    What is found comes back best first; fewer than the starts, if some never began.

    Parameters
    ----------
    problem : SearchProblem
    starts : sequence of Candidate
    workers : int
        Processes, this one among them.
    deadline : float, [s]
        On the monotonic clock, which all processes share.
    interrupted : callable
        Returns whether the user has asked to end.
    progress : bool
        Show a bar with the best value so far.
    """
    from tqdm import tqdm

    found: list[Candidate] = []

    def ended() -> bool:
        return interrupted() or clock.monotonic() > deadline

    with (
        TemporaryDirectory(prefix="excitation-") as name,
        tqdm(total=len(starts), disable=not progress, unit="start") as bar,
    ):
        folder = Path(name)
        for one in _distributed(problem, starts, workers, deadline, ended, folder):
            found.append(one)
            bar.update()
            best = min(f.score for f in found)
            bar.set_postfix_str(f"best {problem.objective}: {np.exp(best):.4g}")
        done = {one.number for one in found}
        found += [one for one in _left_behind(folder) if one.number not in done]
        if not found and not interrupted():
            # Processes take a second to begin: some path is better than none.
            found += [_run(problem, one, ended, folder) for one in starts[:1]]
    return tuple(sorted(found, key=lambda one: (one.score, one.number)))


def _distributed(
    problem: SearchProblem,
    starts: Sequence[Candidate],
    workers: int,
    deadline: float,
    ended: Callable[[], bool],
    folder: Path,
) -> Iterator[Candidate]:
    """Yield results as they come; this process searches while others start and do."""
    waiting = deque(starts)
    if workers == 1 or len(starts) == 1:
        while waiting and not ended():
            yield _run(problem, waiting.popleft(), ended, folder)
        return
    from loky import get_reusable_executor, wait

    with _interrupts_ignored():
        executor = get_reusable_executor(max_workers=workers - 1)
    running: list[Any] = []
    try:
        with _killed_workers_named():
            while running or (waiting and not ended()):
                while len(running) < workers - 1 and len(waiting) > 1 and not ended():
                    call = (_in_worker, problem, waiting.popleft(), deadline, folder)
                    with _interrupts_ignored():
                        running.append(executor.submit(*call))
                if waiting and not ended():
                    yield _run(problem, waiting.popleft(), ended, folder)
                elif ended() and clock.monotonic() < deadline:
                    break  # the user has: what others have reported so far is enough
                else:
                    wait(running, timeout=_WAIT)
                for future in [future for future in running if future.done()]:
                    running.remove(future)
                    if (one := future.result()) is not None:
                        yield one
    finally:
        if running:
            executor.shutdown(wait=False, kill_workers=True)


@contextmanager
def _killed_workers_named() -> Iterator[None]:
    """Say of a process that was killed what it was."""
    from concurrent.futures.process import BrokenProcessPool

    try:
        yield
    except BrokenProcessPool as cause:
        raise SolverError(
            "a process of the search was killed, perhaps for want of memory; search "
            f"with fewer workers ({str(cause).splitlines()[0]})"
        ) from None


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Start processes that no interrupt reaches, not even while they begin.

    The terminal interrupts every process at once; the one that waits decides.  That
    interrupts are ignored is inherited; so for a moment this process ignores them too.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _in_worker(
    problem: SearchProblem, start: Candidate, deadline: float, folder: Path
) -> Candidate | None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where it was not inherited
    main = os.getppid()

    def ended() -> bool:
        # Nobody tells a worker that the process it works for was killed.
        return clock.monotonic() > deadline or os.getppid() != main

    return None if ended() else _run(problem, start, ended, folder)


def _run(
    problem: SearchProblem, start: Candidate, ended: Callable[[], bool], folder: Path
) -> Candidate:
    def report(score: float, variables: Matrix) -> None:
        temporary = folder / f"{start.number}.partial"
        with temporary.open("wb") as file:
            np.savez(file, score=score, variables=variables)
        temporary.replace(folder / f"{start.number}.npz")

    return search(problem, start, ended=ended, report=report)


def _left_behind(folder: Path) -> Iterator[Candidate]:
    """Yield what searches have reported, ended or not."""
    for file in sorted(folder.glob("*.npz")):
        with np.load(file) as saved:
            score = float(saved["score"])
            yield Candidate(int(file.stem), saved["variables"], score, complete=False)
