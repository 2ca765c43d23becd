"""Parallel searches from many starts, whose results survive a killed process.

Starts are distributed to lanes in turn.  A lane searches its starts one after another,
with its own allowance of work.  So the result depends neither on the clock nor on where
lanes run. Results so far are kept in files.  A killed process is replaced: its finished
results are in the folder, and the unfinished start is searched again from its
beginning, so the result is the same.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any

import numpy as np

from consistent_id._support.executors import Executor
from consistent_id._support.progress import counted
from consistent_id._support.run import Interrupted
from consistent_id.excitation.path_search import FoundPath, searched_path
from consistent_id.excitation.search_problem import SearchProblem

_TRIES = 3  # tries of a start after a process was killed; the executor has one more


@dataclass(frozen=True, slots=True)
class Lanes:
    """The lanes that search side by side.

    Parameters
    ----------
    number : int
        Shares of the starts; the result depends on their number.
    interrupted : callable
        Returns whether the user has interrupted the search.
    executor : Executor, optional
        Where lanes run; the result does not depend on it.  By default one in this
        process, and each other one in a separate process.
    progress : bool
        Show a bar with the best value so far.
    """

    number: int
    interrupted: Interrupted
    executor: Executor | None = None
    progress: bool = False

    def run(
        self, problem: SearchProblem, starts: Sequence[FoundPath], work: float
    ) -> tuple[FoundPath, ...]:
        """Run searches until all are done, their work is spent or the user interrupts.

        Results are sorted, the best first.  There are fewer than starts if some never
        began or were lost with a killed process.

        Parameters
        ----------
        problem : SearchProblem
        starts : sequence of FoundPath
        work : float
            Work of each lane, see `Meter`; its first start begins in any case.
        """
        executor, interrupted = self.executor, self.interrupted
        dealt = self._dealt(starts)
        with (
            report_folder(None if executor is None else executor.place) as folder,
            counted(len(starts), "starts", self.progress) as count,
        ):

            def show() -> None:
                reports = list(read_reports(folder))
                if reports:
                    complete = sum(one.complete for one in reports)
                    count(complete, f"({_best(problem, reports)})")

            here = self._here(len(dealt))
            others = Executor("processes") if executor is None else executor
            elsewhere = partial(run_lane_elsewhere, problem, work, folder)
            found: list[FoundPath] = []
            with closing(others.as_done(elsewhere, dealt[here:])) as looks:
                next(looks, None)  # they begin
                for lane in dealt[:here]:
                    for one in run_lane(problem, lane, work, folder, interrupted):
                        found.append(one)
                        show()
                while not interrupted() and (done := next(looks, None)) is not None:
                    found += [one for lane in done.values() for one in lane]
                    show()
            known = {one.number: one for one in [*read_reports(folder), *found]}
            if known:
                said = [_best(problem, known.values())]
                if ended := sum(not one.complete for one in known.values()):
                    said.append(f"{ended} ended by the limit or an interrupt")
                count(len(known), f"({', '.join(said)})")
        return tuple(sorted(known.values(), key=lambda one: (one.score, one.number)))

    def spent(self, found: Sequence[FoundPath], starts: Sequence[FoundPath]) -> float:
        """Return the largest work of a lane."""
        work = {one.number: one.work for one in found}
        lanes = self._dealt(starts)
        return max(sum(work.get(one.number, 0.0) for one in lane) for lane in lanes)

    def _dealt(self, starts: Sequence[FoundPath]) -> list[list[FoundPath]]:
        """Return the starts of each lane."""
        lanes = min(self.number, len(starts))
        return [list(starts[k :: self.number]) for k in range(lanes)]

    def _here(self, lanes: int) -> int:
        """Return the number of lanes in this process."""
        if self.executor is None:
            return 1
        return lanes if self.executor.kind == "serial" else 0


def _best(problem: SearchProblem, found: Iterable[FoundPath]) -> str:
    """Return the best value of the objective, in words."""
    return f"best {problem.objective}: {np.exp(min(one.score for one in found)):.4g}"


def run_lane(
    problem: SearchProblem,
    starts: Sequence[FoundPath],
    work: float,
    folder: Path,
    ended: Callable[[], bool],
) -> Iterator[FoundPath]:
    """Search from one start after another; results are also written to the folder.

    Parameters
    ----------
    problem : SearchProblem
    starts : sequence of FoundPath
    work : float
        Work for all of them, see `Meter`; the first begins in any case.
    folder : Path
        Folder with earlier results.
    ended : callable
        Returns whether to end at once with the results so far.
    """
    known = {one.number: one for one in read_reports(folder, ended=True)}
    left, first = work, True
    for start in starts:
        if ended() or (left <= 0.0 and not first):
            return
        one = known.get(start.number)
        if one is None:
            if times_begun(folder, start.number) > _TRIES:
                continue
            one = searched_path(
                problem,
                start,
                work=left,
                ended=ended,
                report=lambda best: write_report(folder, best, complete=False),
            )
            write_report(folder, one)
        left, first = left - one.work, False
        yield one


def run_lane_elsewhere(
    problem: SearchProblem, work: float, folder: Path, starts: Sequence[FoundPath]
) -> tuple[FoundPath, ...]:
    """Run a lane in another process, as long as its caller waits for it."""
    main, seen = os.getppid(), folder.exists()

    def ended() -> bool:
        # A worker is not informed if its calling process was killed, or has ended.
        return os.getppid() != main or (seen and not folder.exists())

    return tuple(run_lane(problem, starts, work, folder, ended))


@contextmanager
def report_folder(place: Path | None = None) -> Iterator[Path]:
    """Yield a new folder, which disappears at once at the end.

    Parameters
    ----------
    place : Path, optional
        Parent of the folder; by default that of temporary files.
    """
    folder = last = Path(mkdtemp(prefix="excitation-", dir=place))
    try:
        yield folder
    finally:
        with suppress(OSError):  # of systems that rename no folder in use
            last = folder.rename(folder.with_suffix(".over"))
        rmtree(last, ignore_errors=True)


def times_begun(folder: Path, number: int) -> int:
    """Note that a search begins, and its process; return how often it has begun."""
    file = folder / f"{number}.begun"
    try:
        with file.open("a") as noted:
            noted.write(f"{os.getpid()}\n")
        return len(file.read_text().splitlines())
    except FileNotFoundError:  # a folder that this computer cannot access
        return 1


def write_report(
    folder: Path, found: FoundPath, *, complete: bool | None = None
) -> None:
    """Write the result of a search, completely or not at all.

    Parameters
    ----------
    folder : Path
    found : FoundPath
    complete : bool, optional
        Instead of the candidate's own: a running search is not complete.
    """
    temporary = folder / f"{found.number}-{os.getpid()}.partial"
    known: dict[str, Any] = {
        "score": found.score,
        "complete": found.complete if complete is None else complete,
        "ended": complete is None,
        "obstacle": found.obstacle,
        "iterations": found.iterations,
        "work": found.work,
    }
    if found.variables is not None:
        known["variables"] = found.variables
    # The folder may have been removed before a process is killed.
    with suppress(FileNotFoundError):
        with temporary.open("wb") as file:
            np.savez(file, **known)
        temporary.replace(folder / f"{found.number}.npz")


def read_reports(folder: Path, *, ended: bool = False) -> Iterator[FoundPath]:
    """Yield results of all searches, ended or not; or only of those that have ended."""
    for file in sorted(folder.glob("*.npz")):
        with np.load(file) as saved:
            if ended and not saved["ended"]:
                continue
            yield FoundPath(
                int(file.stem),
                saved["variables"] if "variables" in saved else None,
                float(saved["score"]),
                complete=bool(saved["complete"]),
                obstacle=str(saved["obstacle"]),
                iterations=int(saved["iterations"]),
                work=float(saved["work"]),
            )
