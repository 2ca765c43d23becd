"""Interrupts and time limits: one rule for all long work.

The first interrupt ends the work.  Work that has something worth keeping goes on to
show it, says that it was interrupted, and notes this in the run; all other work raises
`KeyboardInterrupt`.  The second interrupt stops at once.
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from consistent_id._support.run import current_run

Interrupted = Callable[[], bool]


class OutOfTime(KeyboardInterrupt):
    """The time is over: an interrupt by the clock."""


class Terminated(BaseException):
    """The system wants the process to end, as by ``kill``."""


def note_stop(cause: KeyboardInterrupt) -> None:
    """Note in the run that work ended early and goes on to show what it has."""
    by_clock = isinstance(cause, OutOfTime)
    current_run().stopped = "out of time" if by_clock else "interrupted"


@contextmanager
def noted_interrupts() -> Iterator[Interrupted]:
    """Note the first interrupt of the user; the second one is raised.

    So is a SIGTERM that `terminations_raised` would raise: solvers that call Python,
    such as CasADi's, swallow what is raised in them.  What they have swallowed is
    raised when the work is over.

    Outside the main thread, where Python lets nobody listen, none is noted.
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
    if terminated.is_set():
        raise Terminated
    if again.is_set():
        raise KeyboardInterrupt
    if noted.is_set():
        note_stop(KeyboardInterrupt())


@contextmanager
def terminations_raised() -> Iterator[None]:
    """Let SIGTERM unwind the work, so that nothing half-made is left behind."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, frame: FrameType | None) -> None:
        raise Terminated

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


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
