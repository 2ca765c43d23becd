"""What a run may read and write, what it has read, and what ended it early.

Outside the shell tool there is no run: files are written wherever the caller says, as
any Python library does, and sizes are limited all the same.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from consistent_id.errors import ProblemError

Stop = Literal["", "interrupted", "out of time"]


@dataclass(slots=True)
class Run:
    """What the user allows, and what has happened so far.

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
    inputs : set of tuple of int
        Device and inode of each file that was read.
    stopped : str
        What ended the work early, if it went on to show what it had.
    """

    force: bool = True
    large_files: bool = False
    trust: bool = False
    executor: str = ""
    inputs: set[tuple[int, int]] = field(default_factory=set)
    stopped: Stop = ""


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
            f"{where}: {sentence}. If you trust this problem file, say --trust "
            "(in Python: load_problem(path, trust=True))"
        )
