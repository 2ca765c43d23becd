"""The shell tool: a file per command or two, each with ``add_NAME`` and ``run_NAME``.

``add_NAME(commands)`` defines the options, ``run_NAME(options)`` runs the command and
returns the exit code; `tool` lists the commands.
"""

import gc
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any

__all__ = ["main", "run"]

_Handler = Callable[[int, FrameType | None], Any] | signal.Handlers

# Objects allocated between two collections of garbage.  A command makes hardly any in
# cycles; Python's 700 cost it 2 to 5 % of its time, and 20 000 some 2 %.
_ALLOCATED = 200_000

# Of mallopt, and its numbers of settings: bytes that are kept, and from which on an
# array has pages of its own.
_KEPT, _LARGE = 2**28, 2**25
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3

# More threads make small matrices slower, and change last digits.
_BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_ENDS: dict[int, tuple[_Handler, int, bytes]] = {
    signal.SIGINT: (signal.default_int_handler, 130, b"consistent-id: interrupted\n"),
    signal.SIGTERM: (signal.SIG_DFL, 143, b"consistent-id: terminated\n"),
}  # signal: its handler at the start of Python, exit code, message


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the tool; return its exit code.

    Signal handlers are set before anything else is imported.
    """
    with _ended_by_signals():
        from consistent_id.cli.options import with_vectors
        from consistent_id.cli.tool import parsed, run_tool

        words = with_vectors(sys.argv[1:] if arguments is None else arguments)
        return run_tool(parsed(words))


def run() -> int:
    """Run the tool as a process of its own; return its exit code.

    A signal that comes while Python ends, such as a third interrupt, ends it at once:
    an exception there can abort the process.
    """
    gc.set_threshold(_ALLOCATED)
    _keep_pages()
    for name in _BLAS_THREADS:  # read when NumPy and SciPy are imported
        os.environ.setdefault(name, "1")
    try:
        return main()
    finally:
        _listen()
        # Else Python looks for garbage among all that is left before it ends: 0.1 s.
        gc.freeze()


def _keep_pages() -> None:
    """Let glibc keep the memory of large arrays that are freed for the next ones.

    Else their pages go back to the system, and each comes back with an interruption.
    Other C libraries have no such settings.
    """
    if not sys.platform.startswith("linux"):
        return
    from ctypes import CDLL

    settings = getattr(CDLL(None), "mallopt", None)
    if settings is not None:
        settings(_TRIM_THRESHOLD, _KEPT)
        settings(_MMAP_THRESHOLD, _LARGE)


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """End at once before the work begins; `run_to_its_end` has its own handlers.

    An exception that is raised in an import can become another error, or be lost.
    """
    heard = _listen()
    try:
        yield
    finally:
        for number in heard:
            signal.signal(number, _ENDS[number][0])


def _listen() -> list[int]:
    """Let signals end the process at once, but for those that are handled otherwise."""
    heard = [n for n, end in _ENDS.items() if signal.getsignal(n) is end[0]]
    try:
        for number in heard:
            signal.signal(number, _end)
    except ValueError:  # outside of the main thread nobody may listen
        return []
    return heard


def _end(number: int, frame: FrameType | None) -> None:
    _, code, message = _ENDS[number]
    try:
        os.write(2, message)
    finally:
        os._exit(code)
