"""Giving up after a time."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from consistent_id._support.interrupts import OutOfTime
from consistent_id.errors import ProblemError


@contextmanager
def within(seconds: float | None) -> Iterator[None]:
    """Raise `OutOfTime` in the work that takes longer.

    Raises
    ------
    ProblemError
        Where the system has no alarm clock for processes.
    """
    if seconds is None:
        yield
        return
    here = threading.current_thread() is threading.main_thread()
    if not (hasattr(signal, "setitimer") and here):
        raise ProblemError("--time-limit is not available on this system")
    before = signal.signal(signal.SIGALRM, _ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _ring(signum: int, frame: FrameType | None) -> None:
    raise OutOfTime
