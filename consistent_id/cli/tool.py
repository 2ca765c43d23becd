"""The shell tool: ``consistent-id COMMAND``; its help lists the commands.

A run begins with permissions and a time limit, and ends with an exit code: 0 done,
1 do not use (the estimate, or a faulty log), 2 wrong usage or input, 3 solver failure
or out of time, 70 a bug, 130 interrupted, 143 terminated.
"""

import argparse
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn, TextIO, cast

from consistent_id._support.run import (
    OutOfTime,
    Run,
    Terminated,
    current_run,
    note_input,
    running,
    signals_raised,
)
from consistent_id.cli.answers import lead_nowhere, print_error, warnings_unless
from consistent_id.errors import ConsistentIdError, ProblemError

_TERMINATED = 143  # the code of a shell for a process that SIGTERM ended
_OF_ONE_PROBLEM = ("select", "compress", "excite", "rehearse")  # and of no logs
_OUTPUTS = ("output", "report")  # options that name written files


def run_to_its_end(
    options: argparse.Namespace, work: Callable[[argparse.Namespace], int]
) -> int:
    """Run a command with the user's permissions; return the exit code.

    Parameters
    ----------
    work : callable
        Function from the options to an exit code.
    """
    with _streams_that_never_break():
        return _run_to_its_end(options, work)


def _run_to_its_end(
    options: argparse.Namespace, work: Callable[[argparse.Namespace], int]
) -> int:
    from consistent_id._support.executors import cores

    faults = list[tuple[str, Exception]]()
    run = Run(
        faults=faults,
        force=getattr(options, "force", False),
        large_files=getattr(options, "large_files", False),
        trust=getattr(options, "trust", False),
        executor=getattr(options, "executor", None) or "",
        beside=cores() > 1,
    )
    code = _ended(options, work, run)
    for part, fault in faults:
        _bug(fault, f"{part} could not be made, all else was: ")
    return 70 if faults and code in (0, 1) else code


class _Stream:
    """A stream that discards its output when its reader, such as ``head``, has gone.

    The exit code depends on the work alone, not on how much of its output was read.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except BrokenPipeError:
            lead_nowhere(self._stream)
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except BrokenPipeError:
            lead_nowhere(self._stream)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def _streams_that_never_break() -> Iterator[None]:
    """Replace streams that are closed, so that printing to them does not fail."""
    before = sys.stdout, sys.stderr
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # the shell has closed it
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))
        setattr(sys, name, _Stream(getattr(sys, name)))
    try:
        yield
    finally:
        with suppress(OSError, ValueError):  # a full disk has been reported
            sys.stdout.flush()
            sys.stderr.flush()
        sys.stdout, sys.stderr = before


def _ended(
    options: argparse.Namespace, work: Callable[[argparse.Namespace], int], run: Run
) -> int:
    """Run a command; print what ended it, and return the exit code."""
    try:
        with signals_raised(run), running(run):
            _note_inputs(options)
            code = int(work(options))
    except OutOfTime:
        return _ended_by(signal.SIGALRM, options)
    except KeyboardInterrupt:
        return _ended_by(signal.SIGINT, options)
    except Terminated:
        return _ended_by(signal.SIGTERM, options)
    except Exception as cause:
        if run.signals:  # a library, or an import, turned it into another error
            return _ended_by(run.signals[-1], options)
        return _failed(cause, getattr(options, "words", ()))
    if run.stopped == "interrupted":
        return _said(130, "interrupted: this is the best so far")
    if run.stopped == "terminated":
        return _said(_TERMINATED, "terminated: this is the best so far")
    if run.stopped == "out of time":
        return _said(3, "out of time: this is the best so far")
    return code


def _ended_by(number: int, options: argparse.Namespace) -> int:
    """Print which signal ended the command, and return the exit code."""
    if number == signal.SIGINT:
        return _said(130, "interrupted")
    if number == signal.SIGTERM:
        return _said(_TERMINATED, "terminated")
    limit = getattr(options, "give_up_after", None)
    return _said(3, f"not done within {limit:g} s, given up")


def _failed(cause: Exception, words: Sequence[str]) -> int:
    """Print the error, and return the exit code."""
    if isinstance(cause, ConsistentIdError):
        return print_error(cause, words)
    if isinstance(cause, MemoryError):
        return _said(3, "not enough memory")
    if isinstance(cause, OSError):
        where = f"{cause.filename}: " if cause.filename is not None else ""
        return _said(2, f"{where}{cause.strerror or cause}")
    return _bug(cause)  # any other exception is a bug of this package


def _note_inputs(options: argparse.Namespace) -> None:
    """Record the input files that the options name, before any of them is read."""
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
    """Write the traceback to a file, print its name, and return the exit code."""
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
    """Raise `OutOfTime` in work that takes longer.

    Raises
    ------
    ProblemError
        If the system has no alarm signal for processes.
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
    current_run().signals.append(signum)
    raise OutOfTime


# A command is a file of this folder, imported when it is run or its help is shown.
_FILES = {
    **dict.fromkeys(("demo", "help", "completion"), "shipped"),
    "compress": "fleet",
    "gains": "payload",
    "lint": "repair",
}  # of several commands
_COMMANDS = {
    "init": "write a commented problem file for a robot, and a log if there is one",
    "info": "show a problem's robot, datasheet and base parameters",
    "check": "look for faults of a log",
    "select": "choose the model from the training data",
    "excite": "design an exciting trajectory within the robot's limits",
    "rehearse": "play a designed motion on simulated robots with known parameters",
    "identify": "estimate parameters by every method",
    "compare": "compare least squares with constrained estimates",
    "report": "write everything about a problem into one HTML file",
    "export": "write the estimate that identify delivers for other programs",
    "lint": "find faults in a URDF or MJCF file",
    "repair": "make the inertials of a URDF physically consistent, by undoing mistakes",
    "reproduce": "repeat the study of a paper: experiments, tables, verification",
    "rollout": "replay logged commands in MuJoCo",
    "compress": "compress recordings of any size into a regression",
    "fleet": "identify robots of one type together, and name outliers",
    "payload": "weigh what a robot carries, and write it in the forms of controllers",
    "gains": "identify gains between currents and torque by a load, or by the model",
    "servo": "identify hobby servos from position, goal and duty, without torque",
    "demo": "copy the example problems into a folder",
    "help": "print a page of the documentation, or the meaning of a reason",
    "completion": "print a script for tab completion",
}
_EPILOG = """examples:
  consistent-id identify robot.urdf log.csv --output results/robot
  consistent-id init robot.urdf log.csv
  consistent-id info problems
  consistent-id check robot.urdf log.csv --position q_{joint} --torque tau_{joint}
  consistent-id select problems/ur10e --dry-run
  consistent-id excite problems/rx60 --time-limit 3 --output results/motion
  consistent-id compare problems/rx60
  consistent-id report problems/ur10e --output ur10e.html
  consistent-id export problems/ur10e --format urdf --output ur10e.urdf
  consistent-id lint robot.urdf
  consistent-id repair robot.urdf --dry-run
  consistent-id reproduce problems/rx60 --quick
  consistent-id rollout problems/unitree_go2 --refine
  consistent-id compress problem.toml --output regression.json
  consistent-id fleet 'logs/*/problem.toml' --output results/fleet
  consistent-id payload robot.urdf empty.csv --loaded carrying.csv --link tool0
  consistent-id gains problems/ur10e --loaded carrying.csv --known-mass 2.805
  consistent-id servo arm.urdf a.csv b.csv --validate c.csv

consistent-id COMMAND --help has more. Exit codes: 0 done, 1 do not use (the
estimate, or a faulty log), 2 wrong usage or input, 3 solver failure or out of time,
70 a bug, 130 interrupted (what is shown then is the best so far), 143 terminated.
"""


def run_tool(options: argparse.Namespace) -> int:
    """Run the command that options of `tool_parser` name; return the exit code."""
    return run_to_its_end(options, _run)


def _run(options: argparse.Namespace) -> int:
    limit = getattr(options, "give_up_after", None)
    with warnings_unless(options.quiet), within(limit):
        return int(options.run(options))


def parsed(words: Sequence[str]) -> argparse.Namespace:
    """Return the options that the words of a command line state.

    Ends the process with code 2 if they are wrong.  An option that the command does not
    have is answered with the nearest that it has, without the usage of them all.
    """
    wanted = next((word for word in words if not word.startswith("-")), "")
    parser = tool_parser(wanted)
    if not words:
        parser.exit(2, parser.format_help())
    options, unknown = parser.parse_known_args(words)
    if unknown and not any(word.startswith("-") for word in unknown):
        words = _in_one_row(words, unknown, parser, wanted)
        options, unknown = parser.parse_known_args(words)
    if unknown:
        (commands,) = cast(Any, parser)._subparsers._group_actions
        known = list(commands.choices[wanted]._option_string_actions)
        first = next((word for word in unknown if word.startswith("-")), unknown[0])
        names = [option.lstrip("-") for option in known]
        near = get_close_matches(first.partition("=")[0].lstrip("-"), names, n=1)
        hint = f"; did you mean --{near[0]}?" if near else ""
        what = "there is no option" if first.startswith("-") else "not understood:"
        if wanted in _OF_ONE_PROBLEM and not first.startswith("-"):
            hint = (
                f". It takes one problem: consistent-id init {options.problem} {first} "
                f"--output problem.toml writes that of a robot and a log; then "
                f"consistent-id {wanted} problem.toml"
            )
        commands.choices[wanted].error(f"{what} {first}{hint}")
    options.words = tuple(words)
    return options


def _in_one_row(
    words: Sequence[str],
    late: Sequence[str],
    parser: argparse.ArgumentParser,
    wanted: str,
) -> list[str]:
    """Return words with files that follow an option moved behind the first ones.

    argparse takes files in one row alone: of ``robot.urdf --no-select log.csv``, only
    the first.
    """
    rest = list(words)
    for word in late:
        del rest[len(rest) - 1 - rest[::-1].index(word)]
    options, _ = parser.parse_known_args(rest)
    (commands,) = cast(Any, parser)._subparsers._group_actions
    given = list[str]()
    for action in commands.choices[wanted]._get_positional_actions():
        value = getattr(options, action.dest, None)
        given += map(str, value if isinstance(value, list) else [value])
    last = max((rest.index(word) for word in given if word in rest), default=0)
    return [*rest[: last + 1], *late, *rest[last + 1 :]]


_NOT_READ = re.compile(r"invalid (int|float|positive|finite) value: ('.*')")
_KINDS = {
    "int": "whole number",
    "float": "number",
    "positive": "positive number",
    "finite": "number",
}


def _not_read(found: re.Match[str]) -> str:
    """Return argparse's words on a value that is no number, without Python's types."""
    kind, value = found.groups()
    return f"{value} is not a {_KINDS[kind]}"


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line: the usage of all options would hide it."""

    def error(self, message: str) -> NoReturn:
        message = _NOT_READ.sub(_not_read, message)
        listed = "options" if " " in self.prog else "commands"
        end = "" if message.endswith("?") else ";"
        said = f"{self.prog}: {message}{end} {self.prog} --help lists the {listed}\n"
        self.exit(2, said)


def tool_parser(wanted: str | None = None) -> argparse.ArgumentParser:
    """Return the parser of all commands; with the options of one, or of all."""
    from consistent_id import __version__

    parser = _Parser(
        prog="consistent-id",
        description="Identify dynamic parameters of robots that are physically "
        "consistent.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=__version__)
    if wanted and wanted not in _COMMANDS:
        near = get_close_matches(wanted, _COMMANDS, n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        parser.error(f"there is no command {wanted!r}{hint}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, text in _COMMANDS.items():
        command = commands.add_parser(
            name,
            help=text,
            description=f"{text[0].upper()}{text[1:]}.",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if wanted in (None, name):
            file = import_module(f"consistent_id.cli.{_FILES.get(name, name)}")
            getattr(file, f"add_{name}")(command)
    parser.set_defaults(tool_parser=tool_parser)  # for the completion script
    return parser
