"""The place of independent work: here, threads or processes, or a Dask cluster.

Tasks are the same everywhere, and results come in the order of the tasks, so that they
are the same to the last bit on one kind of processor.  A worker that is killed takes
nothing with it: its tasks are done again.  BLAS has one thread: more are slower and
change last bits.
"""

import os
import pickle
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache, wraps
from itertools import accumulate, count
from pathlib import Path
from typing import Any, Literal, ParamSpec, Self, TypeVar, get_args
from warnings import catch_warnings, simplefilter

from consistent_id._support.run import current_run, interrupts_ignored
from consistent_id._support.workers import (
    Call,
    HandedTask,
    Workers,
    as_done,
    dask_cluster,
    dumped,
    in_order,
    processes,
)
from consistent_id.errors import ProblemError

_T = TypeVar("_T")
_R = TypeVar("_R")
_P = ParamSpec("_P")

Kind = Literal["serial", "processes", "dask"]

FEW_SAMPLES = 1_000_000
"""With more samples of logs, a second process at work would need too much memory."""


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
            yield from in_order(workers, tasks)

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
                yield from as_done(workers, tasks)

    @contextmanager
    def _at_work(
        self, function: Callable[[Any], Any], most: int | None = None
    ) -> Iterator[Workers]:
        """Yield workers for a function, at most so many."""
        call = Call(function, replace(current_run(), inputs=set(), executor=""))
        number = self.workers or cores()
        number = number if most is None else min(number, most)
        if self.kind == "processes":
            with processes(call, number) as workers:
                yield workers
        else:
            with dask_cluster(call, number, self.address) as workers:
                yield workers


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def beside(
    function: Callable[[_T], _R], task: _T, *, copied: bool = False
) -> Generator[Callable[[], _R], None, None]:
    """Yield how to get the result of work that another process does meanwhile.

    If the run has no core for it (`Run.beside`), it is done here when it is needed.
    Results are equal to the last bit; they can be pickled, and what the work notes in
    the run, or keeps in caches, is lost.  The work may share work in its turn, so for a
    moment there are more processes than cores.

    Parameters
    ----------
    function : callable
        At the top level of a module; any, if `copied`.
    task : object
        Its argument.
    copied : bool
        Only a copy of this process may do the work, which begins at once: for work that
        takes no longer than the start of another one.

    Examples
    --------
    >>> with beside(abs, -2) as size:
    ...     size()
    2
    """
    run = current_run()
    if copied or not run.beside or _can_be_copied():
        with companion(lambda _: function(task)) as handed:
            yield (lambda: function(task)) if handed is None else handed(None)
    else:
        call = Call(function, replace(run, inputs=set(), executor="", beside=False))
        with processes(call, 1) as workers:
            yield HandedTask(workers, task).result


def in_halves(
    function: Callable[[_T], _R], tasks: Sequence[_T], *, samples: int = 0
) -> Iterator[_R]:
    """Yield the results of tasks in their order.

    A copy of this process, which has the tasks already, does the second half, see
    `beside`.  Without one, each task is done here when its result is needed.

    Parameters
    ----------
    samples : int
        Samples of the logs behind all tasks; many are not worked on side by side.

    Examples
    --------
    >>> list(in_halves(abs, [-1, 2, -3]))
    [1, 2, 3]
    """

    def from_there_on(first: int) -> list[_R]:
        return [function(task) for task in tasks[first:]]

    middle = (len(tasks) + 1) // 2
    if middle == len(tasks) or samples > FEW_SAMPLES:
        yield from map(function, tasks)
        return
    with companion(from_there_on) as handed:
        if handed is None:
            yield from map(function, tasks)
            return
        others = handed(middle)
        yield from map(function, tasks[:middle])
        yield from others()


@contextmanager
def companion(
    function: Callable[[_T], _R],
) -> Iterator[Callable[[_T], Callable[[], _R]] | None]:
    """Yield how to hand tasks to a copy of this process, and how to get each result.

    It is None where no copy can be made.  The copy stays until the end, and keeps what
    it computes, so that many short tasks do not each begin one.  It does one after
    another.  If it fails or is killed, tasks are done here.  Tasks and results go
    through a pipe, so they should be small.
    """
    run = current_run()
    if not (run.beside and _can_be_copied()):
        yield None
        return
    from multiprocessing import get_context

    fork = get_context("fork")
    call = Call(function, replace(run, inputs=set(), executor="", beside=False))
    here, there = fork.Pipe()
    copy = fork.Process(target=_serve, args=(call, here, there), daemon=True)
    if not _begun(copy):
        here.close()
        there.close()
        yield None
        return
    there.close()  # else its end would not be seen here
    numbers, owner = count(), os.getpid()
    answers: dict[int, tuple[bool, Any]] = {}

    def handed(task: _T) -> Callable[[], _R]:
        if os.getpid() != owner:  # another copy must not read from the same pipe
            return lambda: function(task)
        number = next(numbers)
        with suppress(OSError):
            here.send_bytes(dumped((number, task)))

        def result() -> _R:
            try:
                while number not in answers:
                    answered, *answers[answered] = pickle.loads(here.recv_bytes())
            except (EOFError, OSError):
                answers[number] = False, None
            done, found = answers[number]
            return found if done else function(task)

        return result

    try:
        yield handed
    finally:
        copy.kill()
        copy.join()
        here.close()


def _serve(call: "Call", here: Any, there: Any) -> None:
    """Do tasks that come through a pipe, until its other end is closed."""
    here.close()
    while True:
        try:
            number, task = pickle.loads(there.recv_bytes())
        except (EOFError, OSError):
            os._exit(0)
        try:
            answer = dumped((number, True, call(task)))
        except BaseException:
            answer = dumped((number, False, None))
        there.send_bytes(answer)


def _can_be_copied() -> bool:
    """Return whether a copy of this process can work; elsewhere libraries may break."""
    return sys.platform == "linux" and not _openmp()


def _begun(copy: Any) -> bool:
    """Begin a copy of this process; return False if there can be no more of them."""
    with interrupts_ignored(), catch_warnings():
        # Python warns of other threads: those of BLAS, which survive it, and idle
        # ones of libraries that the work does not use.
        simplefilter("ignore", DeprecationWarning)
        try:
            copy.start()
        except (OSError, AssertionError):  # no more processes, or none of a daemon
            return False
    return True


def _openmp() -> bool:
    """Return whether BLAS uses OpenMP, whose threads would hang in a copy."""
    layers = (one.get("threading_layer") for one in _controller().info())
    return "openmp" in layers


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
