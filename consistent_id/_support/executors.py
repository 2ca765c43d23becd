"""The place of independent work: here, threads or processes, or a Dask cluster.

Tasks are the same everywhere, and results come in the order of the tasks, so that they
are the same to the last bit on one kind of processor.  A worker that is killed takes
nothing with it: its tasks are done again.  BLAS has one thread: more are slower and
change last bits.
"""

import logging
import os
import pickle
import signal
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache, wraps
from itertools import accumulate, count, islice
from pathlib import Path
from tempfile import TemporaryDirectory
from time import sleep
from typing import Any, Literal, ParamSpec, Self, TypeVar, get_args
from warnings import catch_warnings, simplefilter

from consistent_id._support.extras import needed
from consistent_id._support.run import Run, current_run, interrupts_ignored, running
from consistent_id.errors import ProblemError, SolverError

_T = TypeVar("_T")
_R = TypeVar("_R")
_P = ParamSpec("_P")

Kind = Literal["serial", "processes", "dask"]

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


@dataclass(frozen=True, slots=True)
class Executor:
    """The place where tasks are done.

    Parameters
    ----------
    kind : {"serial", "processes", "dask"}
    workers : int
        Processes; by default as many as there are cores.
    address : str
        The address of a Dask scheduler, such as ``tcp://10.0.0.5:8786``; by default a
        cluster of this machine is started, and ended with this process.

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

    @property
    def place(self) -> Path | None:
        """The folder for files that workers are to read; None for a temporary one.

        A cluster sees the folder that the work was called from.
        """
        return Path.cwd() if self.address else None

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
            If Dask is requested and not installed, or no scheduler answers.
        SolverError
            If the workers of one task are killed again and again.
        """
        if self.kind == "serial":
            yield from map(function, tasks)
            return
        with self._at_work(function) as workers:
            yield from _in_order(workers, tasks)

    def as_done(
        self, function: Callable[[_T], _R], tasks: Sequence[_T]
    ) -> Generator[dict[int, _R], None, None]:
        """Hand out all tasks, and yield at each look what was done since the last one.

        The first look comes as soon as the tasks are handed out.  Whoever has enough
        closes the iterator, and what is still under way is ended.

        Parameters
        ----------
        function : callable
            See `map`.
        tasks : sequence

        Yields
        ------
        dict
            Results by the place of their tasks; often none.

        Raises
        ------
        ProblemError, SolverError
            See `map`.
        """
        if self.kind == "serial":
            yield from ({k: function(task)} for k, task in enumerate(tasks))
        elif tasks:
            with self._at_work(function, len(tasks)) as workers:
                yield from _as_done(workers, tasks)

    @contextmanager
    def _at_work(
        self, function: Callable[[Any], Any], most: int | None = None
    ) -> Iterator[Workers]:
        """Yield workers for a function, at most so many."""
        call = Call(function, replace(current_run(), inputs=set(), executor=""))
        number = self.workers or os.cpu_count() or 1
        number = number if most is None else min(number, most)
        if self.kind == "processes":
            with processes(call, number) as workers:
                yield workers
        else:
            with _dask_cluster(call, number, self.address) as workers:
                yield workers


@contextmanager
def beside(
    function: Callable[[_T], _R], task: _T
) -> Generator[Callable[[], _R], None, None]:
    """Yield how to get the result of work that another process does meanwhile.

    If the run has no core for it (`Run.beside`), it is done here when it is needed.
    Results are equal to the last bit.

    Parameters
    ----------
    function : callable
        At the top level of a module.
    task : object
        Its argument.

    Examples
    --------
    >>> with beside(abs, -2) as size:
    ...     size()
    2
    """
    run = current_run()
    call = Call(function, replace(run, inputs=set(), executor="", beside=False))
    if not run.beside:
        yield lambda: function(task)
    elif sys.platform == "linux" and not _openmp():
        with _in_a_copy(call, task) as result:
            yield result
    else:  # libraries of other systems may break in a copy of a process
        with processes(call, 1) as workers:
            yield _HandedTask(workers, task).result


@contextmanager
def _in_a_copy(call: "Call", task: Any) -> Iterator[Callable[[], Any]]:
    """Yield how to get the result of a copy of this process.

    It begins at once, with all modules and data of this process.  If it cannot begin,
    fails or is killed, the work is done here.
    """
    from multiprocessing import get_context

    with TemporaryDirectory(prefix="consistent-id-") as folder:
        path = Path(folder) / "result"
        copy = get_context("fork").Process(
            target=_write_result, args=(call, task, path), daemon=True
        )
        with interrupts_ignored(), catch_warnings():
            # Python warns of other threads: those of BLAS, which survive it, and idle
            # ones of libraries that the work does not use.
            simplefilter("ignore", DeprecationWarning)
            begun = True
            try:
                copy.start()
            except (OSError, AssertionError):  # no more processes, or none of a daemon
                begun = False
        if not begun:
            yield lambda: call.function(task)
            return

        def result() -> Any:
            copy.join()
            done = copy.exitcode == 0
            return pickle.loads(path.read_bytes()) if done else call.function(task)

        try:
            yield result
        finally:
            copy.kill()
            copy.join()


def _openmp() -> bool:
    """Return whether BLAS uses OpenMP, whose threads would hang in a copy."""
    layers = (one.get("threading_layer") for one in _controller().info())
    return "openmp" in layers


def _write_result(call: "Call", task: Any, path: Path) -> None:
    """Write the result of a call; if it fails, end without a word."""
    try:
        _spooled(call(task), path)
    except BaseException:
        os._exit(1)


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


def all_but_each(parts: Sequence[_T], joined: Callable[[_T, _T], _T]) -> list[_T]:
    """Return, for each of two parts or more, all others joined in their order.

    Examples
    --------
    >>> all_but_each(["a", "b", "c"], lambda first, second: first + second)
    ['bc', 'ac', 'ab']
    """
    before = list(accumulate(parts[:-1], joined))
    after = list(accumulate(reversed(parts[1:]), lambda a, b: joined(b, a)))[::-1]
    middle = [joined(a, b) for a, b in zip(before, after[1:], strict=False)]
    return [after[0], *middle, before[-1]]


def single_threaded(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Limit BLAS to one thread while the function runs."""

    @wraps(function)
    def run(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with _controller().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return run


@contextmanager
def worker_threads(count: int) -> Iterator[ThreadPoolExecutor]:
    """Yield threads for parallel work; tasks that wait when an error comes are dropped.

    So an interrupt need not wait until all requested work is done.
    """
    pool = ThreadPoolExecutor(count)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


@lru_cache(maxsize=1)
def _controller() -> Any:
    # SciPy brings a BLAS of its own, which must be there to be found.
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def _in_order(workers: Workers, tasks: Iterable[_T]) -> Iterator[Any]:
    """Yield results in the order of tasks; few are handed out at a time."""
    coming = (_HandedTask(workers, task) for task in tasks)
    waiting = deque(islice(coming, _AHEAD * workers.number))
    while waiting:
        result = waiting.popleft().result()
        waiting.extend(islice(coming, 1))
        yield result


def _as_done(workers: Workers, tasks: Sequence[_T]) -> Iterator[dict[int, Any]]:
    """Yield what is done, until all is."""
    left = {k: _HandedTask(workers, task) for k, task in enumerate(tasks)}
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


class _HandedTask:
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
        name = _spooled((call, task), Path(folder) / f"{next(numbers)}.task")
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
    return _spooled(call(task), Path(f"{name}.{os.getpid()}.result"))


def _spooled(value: Any, path: Path) -> str:
    """Write what processes of this run hand each other; return the file's name."""
    from cloudpickle import dumps

    path.write_bytes(dumps(value))
    return str(path)


def _unspooled(name: str) -> Any:
    return pickle.loads(Path(name).read_bytes())


def _deaf() -> None:
    """Let interrupts of the terminal reach the process that waits alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _dask_cluster(call: Call, workers: int, address: str) -> Iterator[Workers]:
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
