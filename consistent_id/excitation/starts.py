"""Searches from many starts, side by side, none of whose work is lost."""

import time as clock
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from consistent_id._arrays import Matrix
from consistent_id.excitation.criteria import Objective
from consistent_id.excitation.search import Found, Searcher, search
from consistent_id.excitation.search_task import SearchTask


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """One search: what for, from where.

    Parameters
    ----------
    objective : Objective
    seed : int
    start : ndarray, optional
        By default a random path of this seed.
    spread_bound : float
        See `search`.
    """

    objective: Objective
    seed: int
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
    progress: bool = False,
) -> Outcome:
    """Run searches until all are done, time is up or the user interrupts.

    Parameters
    ----------
    task : SearchTask
    jobs : sequence of Job
    workers : int
        Processes; with one, everything happens in this one.
    deadline : float, [s]
        Time of the clock.
    progress : bool
        Show a bar with the best value so far.
    """
    from tqdm import tqdm

    found: list[Found] = []
    interrupted = False
    with (
        TemporaryDirectory(prefix="excitation-") as folder,
        tqdm(total=len(jobs), disable=not progress, unit="start") as bar,
    ):
        run = _here if workers == 1 or len(jobs) == 1 else _side_by_side
        try:
            for one in run(task, jobs, deadline, Path(folder), workers):
                found.append(one)
                bar.update()
                best = min(f.score for f in found)
                bar.set_postfix_str(f"{jobs[0].objective}: {np.exp(best):.4g}")
        except KeyboardInterrupt:
            interrupted = True
        if not found and not interrupted and not any(Path(folder).glob("*.npz")):
            # Processes take a second to begin: some path is better than none.
            found += [_run(task, job, deadline, Path(folder)) for job in jobs[:1]]
        done = {one.seed for one in found}
        found += [one for one in _left_behind(Path(folder)) if one.seed not in done]
    usable = sorted(found, key=lambda one: (one.score, one.seed))
    late = clock.time() > deadline
    return Outcome(tuple(usable), interrupted, late)


def _here(
    task: SearchTask, jobs: Sequence[Job], deadline: float, folder: Path, _: int
) -> Iterator[Found]:
    for job in jobs:
        if clock.time() > deadline:
            return
        yield _run(task, job, deadline, folder)


def _side_by_side(
    task: SearchTask, jobs: Sequence[Job], deadline: float, folder: Path, workers: int
) -> Iterator[Found]:
    from joblib import Parallel, delayed

    parallel = Parallel(
        n_jobs=workers, return_as="generator_unordered", pre_dispatch=workers
    )
    waiting = (
        delayed(_in_worker)(task, job, deadline, folder)
        for job in jobs
        if clock.time() < deadline
    )
    results: Any = parallel(waiting)
    try:
        yield from (one for one in results if one is not None)
    finally:
        results.close()


def _in_worker(
    task: SearchTask, job: Job, deadline: float, folder: Path
) -> Found | None:
    import signal

    # The terminal interrupts every process at once; the one that waits decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if clock.time() > deadline:
        return None
    return _run(task, job, deadline, folder)


def _run(task: SearchTask, job: Job, deadline: float, folder: Path) -> Found:
    def report(score: float, variables: Matrix) -> None:
        temporary = folder / f"{job.seed}.partial"
        with temporary.open("wb") as file:
            np.savez(file, score=score, variables=variables)
        temporary.replace(folder / f"{job.seed}.npz")

    searcher = Searcher(task, deadline, report)
    return search(
        searcher,
        job.objective,
        job.seed,
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
