"""Where independent work is done: here, in processes, or on a Dask cluster.

Tasks are the same in all three, and results come in the order of the tasks, so that
they are the same to the last bit on one kind of processor.  A worker that is killed
takes nothing with it: its tasks are done again.
"""

import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Literal, Self, TypeVar, get_args

from consistent_id._support.extras import needed
from consistent_id._support.interrupts import interrupts_ignored
from consistent_id._support.run import Run, current_run, running
from consistent_id.errors import ProblemError, SolverError

_T = TypeVar("_T")
_R = TypeVar("_R")
_Submit = Callable[[_T], Any]

Kind = Literal["serial", "processes", "dask"]

_AHEAD = 2  # tasks handed out per worker: one under way, one waiting
_TRIES = 4  # of a task whose worker is killed each time


@dataclass(frozen=True, slots=True)
class Executor:
    """Where tasks are done.

    Parameters
    ----------
    kind : {"serial", "processes", "dask"}
    workers : int
        Processes; by default as many as there are cores.
    address : str
        Of a Dask scheduler, such as ``tcp://10.0.0.5:8786``; by default a cluster of
        this machine is started, and ended when the work is done.

    Examples
    --------
    >>> Executor.named("processes:4")
    Executor(kind='processes', workers=4, address='')
    >>> list(Executor().map(abs, [-1, 2]))
    [1, 2]
    """

    kind: Kind = "serial"
    workers: int = 0
    address: str = ""

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind) or self.workers < 0:
            raise ProblemError(
                f"executor {self.kind!r} with {self.workers} workers, expected serial, "
                "processes or dask, and a number of workers"
            )

    @classmethod
    def named(cls, name: "str | Executor") -> Self:
        """Return the executor that a text names.

        Parameters
        ----------
        name : str or Executor
            ``serial``, ``processes``, ``processes:4``, ``dask``, ``dask:4`` or
            ``dask:tcp://host:port``.

        Raises
        ------
        ProblemError
            If there is no such executor.
        """
        if isinstance(name, Executor):
            return cls(name.kind, name.workers, name.address)
        kind, _, rest = name.partition(":")
        known: Kind | None = next((k for k in get_args(Kind) if k == kind), None)
        if known and not rest:
            return cls(known)
        if known and rest.isascii() and rest.isdigit() and int(rest):
            return cls(known, int(rest))
        if known == "dask" and "://" in rest:
            return cls(known, address=rest)
        raise ProblemError(
            f"executor {name!r}, expected serial, processes, processes:NUMBER, dask, "
            "dask:NUMBER or dask:tcp://HOST:PORT"
        )

    @classmethod
    def chosen(cls, given: "str | Executor | None") -> Self | None:
        """Return the executor that is given, else that of the run, if there is one.

        Raises
        ------
        ProblemError
            If there is no such executor.
        """
        name = current_run().executor if given is None else given
        return cls.named(name) if name else None

    def map(self, function: Callable[[_T], _R], tasks: Iterable[_T]) -> Iterator[_R]:
        """Yield the result of each task, in order; few are under way at a time.

        Parameters
        ----------
        function : callable
            At the top level of a module, so that it can be sent to other processes.
        tasks : iterable

        Raises
        ------
        ProblemError
            If Dask is asked for and not installed, or no scheduler answers.
        SolverError
            If the workers of one task are killed again and again.
        """
        if self.kind == "serial":
            yield from map(function, tasks)
            return
        call = _Call(function, replace(current_run(), inputs=set(), executor=""))
        workers = self.workers or os.cpu_count() or 1
        if self.kind == "processes":
            with _processes(call, workers) as (submit, broken):
                yield from _in_order(submit, broken, tasks, _AHEAD * workers)
        else:
            with _dask(call, workers, self.address) as (submit, broken, width):
                yield from _in_order(submit, broken, tasks, _AHEAD * width)


def tree_reduced(items: Iterable[_T], combine: Callable[[_T, _T], _T]) -> _T | None:
    """Combine items as a balanced tree does, holding few at a time; None of none.

    The tree depends on the number of items alone, so that rounding is the same
    whoever made them, and grows with the logarithm of their number.

    Examples
    --------
    >>> tree_reduced("abcde", lambda a, b: f"({a}{b})")
    '(((ab)(cd))e)'
    """
    waiting: list[tuple[int, _T]] = []  # height of each subtree, largest first
    for item in items:
        height = 0
        while waiting and waiting[-1][0] == height:
            item = combine(waiting.pop()[1], item)
            height += 1
        waiting.append((height, item))
    if not waiting:
        return None
    _, whole = waiting.pop()
    while waiting:
        whole = combine(waiting.pop()[1], whole)
    return whole


@dataclass(frozen=True, slots=True)
class _Call:
    """A function, and what the user allows; called in another process."""

    function: Callable[[Any], Any]
    run: Run

    def __call__(self, task: Any) -> Any:
        with running(self.run):
            return self.function(task)


def _in_order(
    submit: _Submit[_T],
    broken: tuple[type[Exception], ...],
    tasks: Iterable[_T],
    ahead: int,
) -> Iterator[Any]:
    """Yield results in the order of tasks; do again what was lost with a worker."""
    waiting: deque[tuple[_T, Any, int]] = deque()  # task, future, tries
    coming = iter(tasks)
    while True:
        while len(waiting) < ahead:
            try:
                task = next(coming)
            except StopIteration:
                break
            waiting.append((task, submit(task), 1))
        if not waiting:
            return
        task, future, tries = waiting.popleft()
        try:
            result = future.result()
        except broken as cause:
            if tries == _TRIES:
                raise SolverError(
                    f"workers were killed {tries} times at the same task, perhaps for "
                    f"want of memory: {cause}. Take fewer workers"
                ) from None
            waiting.appendleft((task, submit(task), tries + 1))
            continue
        yield result


@contextmanager
def _processes(
    call: _Call, workers: int
) -> Iterator[tuple[_Submit[Any], tuple[type[Exception], ...]]]:
    """Yield how to hand tasks to processes; what is left at the end is killed."""
    from concurrent.futures.process import BrokenProcessPool

    from loky import get_reusable_executor

    def submit(task: Any) -> Any:
        with interrupts_ignored():  # a broken pool is replaced by a new one
            pool = get_reusable_executor(max_workers=workers, initializer=_deaf)
            return pool.submit(call, task)

    try:
        yield submit, (BrokenProcessPool,)
    except BaseException:
        get_reusable_executor().shutdown(wait=False, kill_workers=True)
        raise


def _deaf() -> None:
    """Let interrupts of the terminal reach the process that waits alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _dask(
    call: _Call, workers: int, address: str
) -> Iterator[tuple[_Submit[Any], tuple[type[Exception], ...], int]]:
    """Yield how to hand tasks to a Dask cluster, and how many it does at a time."""
    distributed = needed("distributed", "cluster", "executor dask")
    try:
        client = (
            distributed.Client(address)
            if address
            else distributed.Client(
                n_workers=workers, threads_per_worker=1, dashboard_address=None
            )
        )
    except OSError as cause:
        raise ProblemError(
            f"executor dask: no scheduler answers at {address}: {cause}"
        ) from None
    with client:
        width = sum(client.nthreads().values()) or workers

        def submit(task: Any) -> Any:
            return client.submit(call, task, pure=False)

        yield submit, (distributed.KilledWorker,), width
