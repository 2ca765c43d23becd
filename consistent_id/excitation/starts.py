"""Searches from many starts, side by side, none of whose work is lost."""

import signal
import threading
import time as clock
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id._support.interrupts import Asked
from consistent_id.excitation.criteria import Objective
from consistent_id.excitation.search import Found, Searcher, search
from consistent_id.excitation.search_task import SearchTask

_WAIT = 0.2  # s between looks at whether the user has asked to end


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """One search: what for, from where.

    Parameters
    ----------
    objective : Objective
    number : int
        Which of the task's random paths it begins with, or began with.
    start : ndarray, optional
        In place of the random path.
    spread_bound : float
        See `search`.
    """

    objective: Objective
    number: int
    start: Matrix | None = None
    spread_bound: float = np.inf


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What searches have found, best first, and whether all of them came to an end.

    Parameters
    ----------
    found : tuple of Found
    interrupted : bool
        By the user.
    out_of_time : bool
        By the deadline: another run may find something else.
    """

    found: tuple[Found, ...]
    interrupted: bool
    out_of_time: bool


def run_searches(
    task: SearchTask,
    jobs: Sequence[Job],
    *,
    workers: int,
    deadline: float,
    interrupted: Asked,
    progress: bool = False,
) -> Outcome:
    """Run searches until all are done, time is up or the user interrupts.

    Parameters
    ----------
    task : SearchTask
    jobs : sequence of Job
    workers : int
        Processes, this one among them.
    deadline : float, [s]
        Time of the clock.
    interrupted : callable
        Says whether the user has asked to end.
    progress : bool
        Show a bar with the best value so far.
    """
    from tqdm import tqdm

    found: list[Found] = []

    def ended() -> bool:
        return interrupted() or clock.time() > deadline

    with (
        TemporaryDirectory(prefix="excitation-") as folder,
        tqdm(total=len(jobs), disable=not progress, unit="start") as bar,
    ):
        place = Path(folder)
        for one in _shared_out(task, jobs, workers, deadline, ended, place):
            found.append(one)
            bar.update()
            best = min(f.score for f in found)
            bar.set_postfix_str(f"best {jobs[0].objective}: {np.exp(best):.4g}")
        done = {one.number for one in found}
        found += [one for one in _left_behind(place) if one.number not in done]
        if not found and not interrupted():
            # Processes take a second to begin: some path is better than none.
            found += [_run(task, job, ended, place) for job in jobs[:1]]
    best_first = sorted(found, key=lambda one: (one.score, one.number))
    late = clock.time() > deadline or len(found) < len(jobs)
    return Outcome(tuple(best_first), interrupted(), late and not interrupted())


def _shared_out(
    task: SearchTask,
    jobs: Sequence[Job],
    workers: int,
    deadline: float,
    ended: Asked,
    folder: Path,
) -> Iterator[Found]:
    """Yield results as they come; this process searches while others start and do."""
    waiting = deque(jobs)
    if workers == 1 or len(jobs) == 1:
        while waiting and not ended():
            yield _run(task, waiting.popleft(), ended, folder)
        return
    from loky import get_reusable_executor, wait

    with _deaf_children():
        executor = get_reusable_executor(max_workers=workers - 1)
    running: list[Any] = []
    try:
        while running or (waiting and not ended()):
            while len(running) < workers - 1 and len(waiting) > 1 and not ended():
                job = waiting.popleft()
                with _deaf_children():
                    future = executor.submit(_in_worker, task, job, deadline, folder)
                running.append(future)
            if waiting and not ended():
                yield _run(task, waiting.popleft(), ended, folder)
            elif ended() and clock.time() < deadline:
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
def _deaf_children() -> Iterator[None]:
    """Start processes that no interrupt reaches, not even while they begin.

    The terminal interrupts every process at once; the one that waits decides.  Being
    deaf to it is inherited; so for that moment this process is, too.
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
    task: SearchTask, job: Job, deadline: float, folder: Path
) -> Found | None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where it was not inherited
    if clock.time() > deadline:
        return None
    return _run(task, job, lambda: clock.time() > deadline, folder)


def _run(task: SearchTask, job: Job, ended: Asked, folder: Path) -> Found:
    def report(score: float, variables: Matrix) -> None:
        temporary = folder / f"{job.number}.partial"
        with temporary.open("wb") as file:
            np.savez(file, score=score, variables=variables)
        temporary.replace(folder / f"{job.number}.npz")

    searcher = Searcher(task, ended, report)
    return search(
        searcher,
        job.objective,
        job.number,
        start=job.start,
        spread_bound=job.spread_bound,
    )


def _left_behind(folder: Path) -> Iterator[Found]:
    """Yield what searches have reported, ended or not."""
    for file in sorted(folder.glob("*.npz")):
        with np.load(file) as saved:
            yield Found(
                saved["variables"], float(saved["score"]), int(file.stem), np.nan
            )
