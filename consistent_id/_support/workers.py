"""Workers that tasks are handed to: processes of this computer, or a Dask cluster.

A worker that is killed takes nothing with it: its tasks are done again.
"""

import logging
import os
import pickle
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import count, islice
from pathlib import Path
from tempfile import TemporaryDirectory
from time import sleep
from typing import Any, TypeVar

from consistent_id._support.extras import needed
from consistent_id._support.run import Run, interrupts_ignored, running
from consistent_id.errors import ProblemError, SolverError

_T = TypeVar("_T")

_AHEAD = 2  # tasks handed out per worker: one under way, one waiting
_PAUSE = 0.05  # s between looks at what is done
_TRIES = 4  # of a task whose worker is killed each time

_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
_FREED_MEMORY_KEPT = {"distributed.nanny.pre-spawn-environ": dict.fromkeys(_THREADS, 1)}

_OWN_CLUSTERS: dict[int, Any] = {}  # by their number of workers


@dataclass(frozen=True, slots=True)
class Workers:
    """Workers that wait for tasks.

    Parameters
    ----------
    submit : callable
        From a task to its future.
    broken : type of Exception
        Raised by the future of a task that was lost with its worker.
    number : int
        The number of tasks that are done at a time.
    """

    submit: Callable[[Any], Any]
    broken: type[Exception]
    number: int


def in_order(workers: Workers, tasks: Iterable[_T]) -> Iterator[Any]:
    """Yield results in the order of tasks; few are handed out at a time."""
    coming = (HandedTask(workers, task) for task in tasks)
    waiting = deque(islice(coming, _AHEAD * workers.number))
    while waiting:
        result = waiting.popleft().result()
        waiting.extend(islice(coming, 1))
        yield result


def as_done(workers: Workers, tasks: Sequence[_T]) -> Iterator[dict[int, Any]]:
    """Yield what is done, until all is."""
    left = {k: HandedTask(workers, task) for k, task in enumerate(tasks)}
    while left:
        done = [k for k, handed in left.items() if handed.done()]
        yield {k: left.pop(k).result() for k in done}
        if left and not done:
            sleep(_PAUSE)


@dataclass(frozen=True, slots=True)
class Call:
    """A function, and what the user allows; called in another process."""

    function: Callable[[Any], Any]
    run: Run

    def __call__(self, task: Any) -> Any:
        with running(self.run):
            return self.function(task)


class HandedTask:
    """A task in the hands of a worker; of another one, if that is killed."""

    def __init__(self, workers: Workers, task: Any) -> None:
        self._workers, self._task, self._tries = workers, task, 1
        self._future = workers.submit(task)

    def done(self) -> bool:
        """Return whether there is a result; hand the task out again if it was lost."""
        if not self._future.done():
            return False
        cause = self._future.exception()
        if isinstance(cause, self._workers.broken):
            self._again(cause)
            return False
        return True

    def result(self) -> Any:
        """Wait for the result."""
        while True:
            try:
                return self._future.result()
            except self._workers.broken as cause:
                self._again(cause)

    def _again(self, cause: Exception) -> None:
        if self._tries == _TRIES:
            raise SolverError(
                f"workers were killed {_TRIES} times at the same task, perhaps for "
                f"want of memory: {cause}. Take fewer workers"
            ) from None
        self._future = self._workers.submit(self._task)
        self._tries += 1


_pool_sizes: list[int] = []  # of the reusable pool so far


def _reusable_pool(workers: int) -> Any:
    """Return the processes that are there, or new ones if their number is another.

    A pool is not resized: that waits for ever if a worker is killed meanwhile.
    """
    from loky import get_reusable_executor

    same = _pool_sizes[-1:] == [workers]
    _pool_sizes[:] = [workers]
    return get_reusable_executor(
        max_workers=workers, initializer=_deaf, reuse="auto" if same else False
    )


@contextmanager
def processes(call: Call, workers: int) -> Iterator[Workers]:
    """Yield processes that take tasks; those that are left at the end are killed.

    Tasks and results go through files, and only their names through pipes.  A worker
    that is killed while it writes a large result to a pipe leaves a part of it there,
    and whoever reads the pipe waits for the rest for ever; a name is written at once.
    """
    from concurrent.futures.process import BrokenProcessPool

    pool: Any = None

    def submit(task: Any) -> Any:
        nonlocal pool
        name = spooled((call, task), Path(folder) / f"{next(numbers)}.task")
        with interrupts_ignored():
            while True:  # a broken pool is replaced by a new one
                pool = _reusable_pool(workers)
                with suppress(BrokenProcessPool):  # since a moment ago
                    return _SpooledFuture(pool.submit(_called, name), name)

    numbers = count()
    # Workers that are ended may still write.
    with TemporaryDirectory(
        prefix="consistent-id-", ignore_cleanup_errors=True
    ) as folder:
        try:
            yield Workers(submit, BrokenProcessPool, workers)
        except BaseException:
            if pool is not None:
                pool.shutdown(wait=False, kill_workers=True)
            raise


@dataclass(frozen=True, slots=True)
class _SpooledFuture:
    """A future whose result is in a file."""

    future: Any
    task: str

    def done(self) -> bool:
        """Return whether there is a result or an error."""
        return bool(self.future.done())

    def exception(self) -> BaseException | None:
        """Wait for the end, and return the error that it came to."""
        error: BaseException | None = self.future.exception()
        return error

    def result(self) -> Any:
        """Wait for the result, once."""
        name = self.future.result()
        found = _unspooled(name)
        for path in (name, self.task):
            Path(path).unlink()
        return found


def _called(name: str) -> str:
    """Do a task that is in a file; return the name of the file with the result."""
    call, task = _unspooled(name)
    return spooled(call(task), Path(f"{name}.{os.getpid()}.result"))


def spooled(value: Any, path: Path) -> str:
    """Write what processes of this run hand each other; return the file's name."""
    path.write_bytes(dumped(value))
    return str(path)


def dumped(value: Any) -> bytes:
    """Return what processes of this run hand each other, functions and all."""
    from cloudpickle import dumps

    found: bytes = dumps(value)
    return found


def _unspooled(name: str) -> Any:
    return pickle.loads(Path(name).read_bytes())


def _deaf() -> None:
    """Let interrupts of the terminal reach the process that waits alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def dask_cluster(call: Call, workers: int, address: str) -> Iterator[Workers]:
    """Yield how to hand tasks to a Dask cluster, and how many it does at a time."""
    distributed = needed("distributed", "cluster", "executor dask")
    try:
        with interrupts_ignored():
            client = distributed.Client(address or _own_cluster(workers))
    except OSError as cause:
        raise ProblemError(
            f"executor dask: no scheduler answers at {address}: {cause}"
        ) from None
    with client:
        width = sum(client.nthreads().values()) or workers

        def submit(task: Any) -> Any:
            return client.submit(call, task, pure=False)

        try:
            yield Workers(submit, distributed.KilledWorker, width)
        except BaseException:
            if not address:
                _own_cluster(workers).close()
            raise


def _own_cluster(workers: int) -> Any:
    """Return a cluster of this computer, the same one until it is closed.

    Dask closes it when the process ends.
    """
    distributed = needed("distributed", "cluster", "executor dask")
    cluster = _OWN_CLUSTERS.get(workers)
    if cluster is None or cluster.status != distributed.Status.running:
        # Dask makes malloc return each freed array to the system, page by page, which
        # takes as long as the work itself.
        with needed("dask", "cluster", "executor dask").config.set(_FREED_MEMORY_KEPT):
            cluster = _OWN_CLUSTERS[workers] = distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",  # any free port: others may run
                silence_logs=logging.CRITICAL,  # a worker killed changes nothing
            )
    return cluster
