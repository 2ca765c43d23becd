"""Where independent work is done: here, in processes, or on a Dask cluster.

Tasks are the same in all three, and results come in the order of the tasks, so that
they are the same to the last bit on one kind of processor.  A worker that is killed
takes nothing with it: its tasks are done again.
"""

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from time import sleep
from typing import Any, Literal, Self, TypeVar, get_args

from consistent_id._support.run import current_run
from consistent_id._support.workers import (
    Call,
    HandedTask,
    Workers,
    dask_cluster,
    processes,
)
from consistent_id.errors import ProblemError

_T = TypeVar("_T")
_R = TypeVar("_R")

Kind = Literal["serial", "processes", "dask"]

_AHEAD = 2  # tasks handed out per worker: one under way, one waiting
_PAUSE = 0.05  # s between looks at what is done


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
        this machine is started, and ended with this process.

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
        """Where files must be that workers are to see; None for temporary ones.

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
            If Dask is asked for and not installed, or no scheduler answers.
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
            with dask_cluster(call, number, self.address) as workers:
                yield workers


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


def _in_order(workers: Workers, tasks: Iterable[_T]) -> Iterator[Any]:
    """Yield results in the order of tasks; few are handed out at a time."""
    coming = (HandedTask(workers, task) for task in tasks)
    waiting = deque(islice(coming, _AHEAD * workers.number))
    while waiting:
        result = waiting.popleft().result()
        waiting.extend(islice(coming, 1))
        yield result


def _as_done(workers: Workers, tasks: Sequence[_T]) -> Iterator[dict[int, Any]]:
    """Yield what is done, until all is."""
    left = {k: HandedTask(workers, task) for k, task in enumerate(tasks)}
    while left:
        done = [k for k, handed in left.items() if handed.done()]
        yield {k: left.pop(k).result() for k in done}
        if left and not done:
            sleep(_PAUSE)
