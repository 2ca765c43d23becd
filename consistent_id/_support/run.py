"""A run: what it may read and write, what it has read, and what ended it early.

Outside the shell tool there is no run: files are written wherever the caller says, as
any Python library does, and sizes are limited all the same.

The first interrupt ends the work.  Work that has something worth keeping goes on to
show it, says that it was interrupted, and notes this in the run; all other work raises
`KeyboardInterrupt`.  The second interrupt stops at once.

A part of a result that fails loses only itself (`kept_going`).  A section of a report,
a figure or a table that raises a foreign error is a bug; all other parts go on, and a
page says where one is missing.  The shell tool names the part at its end, keeps the
traceback and returns exit code 70; elsewhere a warning is logged.
"""

import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import FrameType
from typing import Literal

from consistent_id.errors import ConsistentIdError, ProblemError

Stop = Literal["", "interrupted", "terminated", "out of time"]

Interrupted = Callable[[], bool]

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class Run:
    """Permissions of the user, and events so far.

    Parameters
    ----------
    force : bool
        Whether files may be overwritten that were read, or that others wrote.
    large_files : bool
        Whether files may be larger than robots and logs are.
    trust : bool
        Whether problem files may name files anywhere.
    executor : str
        Where independent work is done, see `Executor.named`; by default here, in two
        threads.
    beside : bool
        Whether another core may do independent work meanwhile, in a process of its own.
    inputs : set of tuple of int
        Device and inode of each file that was read.
    stopped : str
        The cause that ended the work early, if partial results were shown.
    faults : list of tuple of str and Exception, optional
        Parts of the result that could not be made, and why, if somebody says so at the
        end; see `kept_going`.
    signals : list of int
        Signals that were raised as exceptions.  A signal that is raised in an import,
        or in a library that calls Python, can come out as another exception.
    """

    force: bool = True
    large_files: bool = False
    trust: bool = False
    executor: str = ""
    beside: bool = False
    inputs: set[tuple[int, int]] = field(default_factory=set)
    stopped: Stop = ""
    faults: list[tuple[str, Exception]] | None = None
    signals: list[int] = field(default_factory=list)


_current: ContextVar[Run | None] = ContextVar("run", default=None)


def current_run() -> Run:
    """Return the run that goes on; outside the tool, one that nobody watches."""
    return _current.get() or Run()


@contextmanager
def running(run: Run) -> Iterator[Run]:
    """Make a run the current one."""
    token = _current.set(run)
    try:
        yield run
    finally:
        _current.reset(token)


@contextmanager
def large_files() -> Iterator[None]:
    """Lift the limits on the sizes of files that are read inside.

    Files of strangers can state any size.  So logs that unpack to much more than they
    have bytes are refused, and so are models and problem files of a size that no robot
    has; see ``SECURITY.md``.

    Examples
    --------
    >>> from consistent_id import large_files, load_problem
    >>> with large_files():
    ...     load_problem("problems/rx60").name
    'rx60'
    """
    with running(replace(current_run(), large_files=True)):
        yield


def note_input(status: os.stat_result) -> None:
    """Remember that a file was read, so that nothing is written onto it."""
    current_run().inputs.add((status.st_dev, status.st_ino))


def is_input(status: os.stat_result) -> bool:
    """Return whether a file was read in this run."""
    return (status.st_dev, status.st_ino) in current_run().inputs


def require_trusted(where: Path, sentence: str) -> None:
    """Refuse what only a problem file that is trusted may do.

    Raises
    ------
    ProblemError
        Unless the run trusts it.
    """
    if not current_run().trust:
        raise ProblemError(
            f"{where}: {sentence}; no run of yours wrote this name into this file. If "
            "you trust it, say --trust (in Python: load_problem(path, trust=True))"
        )


class OutOfTime(KeyboardInterrupt):
    """The time is over: an interrupt by the clock."""


class Terminated(BaseException):
    """The system wants the process to end, as by ``kill``."""


def note_stop(cause: BaseException) -> None:
    """Note in the run that work ended early and goes on to show its results."""
    stop: Stop = "interrupted"
    if isinstance(cause, OutOfTime):
        stop = "out of time"
    elif isinstance(cause, Terminated):
        stop = "terminated"
    current_run().stopped = stop


@contextmanager
def noted_interrupts(*, keeps_results: bool = False) -> Iterator[Interrupted]:
    """Note the first interrupt of the user; the second one is raised.

    So is a SIGTERM that `signals_raised` would raise: solvers that call Python, such as
    CasADi's, swallow exceptions that are raised in them.  A swallowed one is raised
    when the work is over.

    Outside the main thread, where Python lets nobody listen, none is noted.

    Parameters
    ----------
    keeps_results : bool
        Whether the work goes on to show its results after a SIGTERM, too, as after an
        interrupt.
    """
    noted, again, terminated = (threading.Event() for _ in range(3))
    if threading.current_thread() is not threading.main_thread():
        yield noted.is_set
        return

    def note(number: int, frame: FrameType | None) -> None:
        if number == signal.SIGTERM:
            terminated.set()
        elif noted.is_set():
            again.set()
            raise KeyboardInterrupt
        noted.set()

    watched = [signal.SIGINT]
    if callable(signal.getsignal(signal.SIGTERM)):
        watched.append(signal.SIGTERM)
    before = {number: signal.signal(number, note) for number in watched}
    try:
        yield noted.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if terminated.is_set() and not keeps_results:
        raise Terminated
    if again.is_set():
        raise KeyboardInterrupt
    if noted.is_set():
        note_stop(Terminated() if terminated.is_set() else KeyboardInterrupt())


@contextmanager
def signals_raised(run: Run) -> Iterator[None]:
    """Let SIGINT and SIGTERM unwind the work: nothing half-made is left behind.

    If the process ignores interrupts, as in the background, it still does.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, frame: FrameType | None) -> None:
        run.signals.append(number)
        raise Terminated if number == signal.SIGTERM else KeyboardInterrupt

    heard = [signal.SIGTERM]
    if callable(signal.getsignal(signal.SIGINT)):
        heard.append(signal.SIGINT)
    before = {number: signal.signal(number, end) for number in heard}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def interrupts_ignored() -> Iterator[None]:
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


@contextmanager
def kept_going(part: str) -> Iterator[list[str]]:
    """Go on after a block that makes one part of a result, should it fail.

    Errors of this package, of the system (a full disk, no memory) and interrupts pass
    through: they concern more than one part.

    Parameters
    ----------
    part : str
        The result of the block, in words.

    Yields
    ------
    list of str
        Empty; after the block, what went wrong in it, if anything did.

    Examples
    --------
    >>> with kept_going("the figure of nothing") as faults:
    ...     figure = 1 / 0
    >>> faults
    ['ZeroDivisionError: division by zero']
    """
    faults: list[str] = []
    try:
        yield faults
    except (ConsistentIdError, OSError, MemoryError):
        raise
    except Exception as cause:  # any other part is worth having nonetheless
        faults.append(f"{type(cause).__name__}: {cause}")
        noted = current_run().faults
        if noted is None:
            _log.warning("%s could not be made", part, exc_info=cause)
        else:
            noted.append((part, cause))
