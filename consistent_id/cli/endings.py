"""Begin and end of a run of the tool: permissions, time limit, exit code."""

import argparse
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from consistent_id._support.run import (
    OutOfTime,
    Run,
    Terminated,
    note_input,
    running,
    terminations_raised,
)
from consistent_id.cli.answers import print_error
from consistent_id.errors import ConsistentIdError, ProblemError

_TERMINATED = 143  # as a shell says of a process that SIGTERM has ended
_OUTPUTS = ("output", "report")  # options that name what is written


def run_to_its_end(
    options: argparse.Namespace, work: Callable[[argparse.Namespace], int]
) -> int:
    """Run a command with what the user allows; return the exit code.

    Parameters
    ----------
    work : callable
        From the options to an exit code.
    """
    _open_streams()
    faults = list[tuple[str, Exception]]()
    run = Run(
        faults=faults,
        force=getattr(options, "force", False),
        large_files=getattr(options, "large_files", False),
        trust=getattr(options, "trust", False),
        executor=getattr(options, "executor", None) or "",
    )
    code = _ended(options, work, run)
    for part, fault in faults:
        _bug(fault, f"{part} could not be made, all else was: ")
    return 70 if faults and code in (0, 1) else code


def _open_streams() -> None:
    """Let print write to nowhere where the shell has closed a stream."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))


def _ended(
    options: argparse.Namespace, work: Callable[[argparse.Namespace], int], run: Run
) -> int:
    """Run a command; say what ended it, and return the exit code."""
    try:
        with terminations_raised(), running(run):
            _note_inputs(options)
            code = int(work(options))
    except ConsistentIdError as error:
        return print_error(error)
    except OutOfTime:
        limit = getattr(options, "give_up_after", None)
        return _said(3, f"not done within {limit:g} s, given up")
    except KeyboardInterrupt:
        return _said(130, "interrupted")
    except Terminated:
        return _said(_TERMINATED, "terminated")
    except BrokenPipeError:
        sys.stderr.close()  # the reader, such as `head`, has gone
        return 0
    except MemoryError:
        return _said(3, "not enough memory")
    except OSError as cause:
        where = f"{cause.filename}: " if cause.filename is not None else ""
        return _said(2, f"{where}{cause.strerror or cause}")
    except Exception as bug:  # the last net: a foreign error is a fault of ours
        return _bug(bug)
    if run.stopped == "interrupted":
        return _said(130, "interrupted: this is the best so far")
    if run.stopped == "out of time":
        return _said(3, "out of time: this is the best so far")
    return code


def _note_inputs(options: argparse.Namespace) -> None:
    """Note the files that were named to be read, before any of them is."""
    for name, value in vars(options).items():
        if name not in _OUTPUTS:
            for file in value if isinstance(value, list) else [value]:
                if isinstance(file, Path) and file.is_file():
                    note_input(file.stat())


def _said(code: int, sentence: str) -> int:
    with suppress(OSError, ValueError):  # nobody listens
        print(f"consistent-id: {sentence}", file=sys.stderr)
    return code


def _bug(bug: Exception, where: str = "") -> int:
    """Keep the traceback in a file, say where it is, and return the exit code."""
    import tempfile
    import traceback

    text = "".join(traceback.format_exception(bug))
    try:
        handle, name = tempfile.mkstemp(prefix="consistent-id-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8", errors="replace") as file:
            file.write(text)
    except OSError:
        name = "nowhere: no file can be written"
    what = f"{type(bug).__name__}: {bug}".splitlines()[0][:200]
    return _said(
        70,
        f"{where}this is a bug, please report it: {what} (the traceback is in {name})",
    )


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
