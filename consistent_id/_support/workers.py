"""Workers in processes or on a Dask cluster; what is lost with one is done again."""

import logging
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from consistent_id._support.extras import needed
from consistent_id._support.interrupts import interrupts_ignored
from consistent_id._support.run import Run, running
from consistent_id.errors import ProblemError, SolverError

_TRIES = 4  # of a task whose worker is killed each time


@dataclass(frozen=True, slots=True)
class Call:
    """A function, and what the user allows; called in another process."""

    function: Callable[[Any], Any]
    run: Run

    def __call__(self, task: Any) -> Any:
        with running(self.run):
            return self.function(task)


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
        Of tasks that are done at a time.
    """

    submit: Callable[[Any], Any]
    broken: type[Exception]
    number: int


class HandedTask:
    """A task in the hands of a worker; of another one, if that is killed."""

    def __init__(self, workers: Workers, task: Any) -> None:
        self._workers, self._task, self._tries = workers, task, 1
        self._future = workers.submit(task)

    def done(self) -> bool:
        """Return whether there is a result; hand the task out again if it was lost."""
        if not self._future.done():
            return False
        try:
            self._future.result()
        except self._workers.broken as cause:
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


@contextmanager
def processes(call: Call, workers: int) -> Iterator[Workers]:
    """Yield how to hand tasks to processes; what is left at the end is killed."""
    from concurrent.futures.process import BrokenProcessPool

    from loky import get_reusable_executor

    pool: Any = None

    def submit(task: Any) -> Any:
        nonlocal pool
        with interrupts_ignored():
            while True:  # a broken pool is replaced by a new one
                pool = get_reusable_executor(max_workers=workers, initializer=_deaf)
                with suppress(BrokenProcessPool):  # since a moment ago
                    return pool.submit(call, task)

    try:
        yield Workers(submit, BrokenProcessPool, workers)
    except BaseException:
        if pool is not None:
            pool.shutdown(wait=False, kill_workers=True)
        raise


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


_OWN_CLUSTERS: dict[int, Any] = {}  # by their number of workers


def _own_cluster(workers: int) -> Any:
    """Return a cluster of this computer, the same one until it is closed.

    Dask closes it when the process ends.
    """
    distributed = needed("distributed", "cluster", "executor dask")
    cluster = _OWN_CLUSTERS.get(workers)
    if cluster is None or cluster.status != distributed.Status.running:
        cluster = _OWN_CLUSTERS[workers] = distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address="127.0.0.1:0",  # any free port: several clusters may run
            silence_logs=logging.CRITICAL,  # that a worker was killed changes nothing
        )
    return cluster
