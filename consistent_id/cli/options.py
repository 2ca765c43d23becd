"""Options that several commands share, each said once."""

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

Run = Callable[[argparse.Namespace], int]


def add_command(
    commands: Any,
    name: str,
    text: str,
    run: Run,
    *,
    more: str = "",
    examples: str,
    reads: bool = True,
) -> argparse.ArgumentParser:
    """Add a command to a parser's commands, with what every command takes.

    Parameters
    ----------
    commands : object
        What ``argparse.ArgumentParser.add_subparsers`` returns.
    name : str
    text : str
        One line, for the list of commands.
    run : callable
        From the options that were given to the exit code.
    more : str
        Further text of the command's own help.
    examples : str
        Lines, each a call that works.
    reads : bool
        Whether it reads files.
    """
    shown = "\n".join(f"  {line}" for line in examples.strip().splitlines())
    command: argparse.ArgumentParser = commands.add_parser(
        name,
        help=text,
        description=f"{text[0].upper()}{text[1:]}.\n{more}".strip(),
        epilog=f"examples:\n{shown}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.set_defaults(run=run)
    printed = command.add_argument_group("what is printed")
    printed.add_argument("--json", action="store_true", help="JSON, not tables")
    printed.add_argument(
        "--verbose", action="store_true", help="everything, not only the first lines"
    )
    printed.add_argument(
        "--quiet",
        action="store_true",
        help="nothing but errors, and JSON if asked for; see the exit code",
    )
    if reads:
        _add_leave(command)
    return command


def _add_leave(command: argparse.ArgumentParser) -> None:
    """Take leave to read what files of strangers must not ask for."""
    files = command.add_argument_group("files of strangers")
    files.add_argument(
        "--trust",
        action="store_true",
        help="let a problem file name files anywhere, and any environment variable",
    )
    files.add_argument(
        "--large-files",
        action="store_true",
        help="read files larger than robots and logs are",
    )


def add_problem(command: argparse.ArgumentParser) -> None:
    """Take one problem, or a folder of several."""
    command.add_argument(
        "problem",
        type=Path,
        help="folder with a problem.toml, the file, or a folder of several",
    )


def add_output(command: argparse.ArgumentParser, default: str | None) -> None:
    """Take a folder for results, and leave to write nothing."""
    usual = "" if default is None else f" (default: {default})"
    command.add_argument(
        "--output", type=Path, metavar="FOLDER", help=f"to write results to{usual}"
    )
    add_dry_run(command)


def add_dry_run(command: argparse.ArgumentParser) -> None:
    """Take leave to do everything but write files, or to write over any file."""
    command.add_argument("--dry-run", action="store_true", help="write nothing")
    add_force(command)


def add_force(command: argparse.ArgumentParser) -> None:
    """Take leave to write over files that are inputs or others'."""
    command.add_argument(
        "--force",
        action="store_true",
        help="write even over an input, or a file that this tool did not write",
    )


def add_accept(command: argparse.ArgumentParser) -> None:
    """Take kinds of findings and reasons that the verdict is to overlook."""
    command.add_argument(
        "--accept",
        action="append",
        default=[],
        metavar="KIND",
        help="overlook one kind of finding or reason, such as 'torque sign'; can be "
        "repeated, and is recorded in every file that is written",
    )


def add_time_limit(command: argparse.ArgumentParser) -> None:
    """Take a number of seconds after which to give up."""
    command.add_argument(
        "--time-limit",
        dest="give_up_after",
        type=positive,
        metavar="SECONDS",
        help="give up after so long, with exit code 3 (default: never)",
    )


def add_executor(
    command: argparse.ArgumentParser, default: str | None = "serial"
) -> None:
    """Take where independent work is done; by default, if None, in two threads."""
    command.add_argument(
        "--executor",
        default=default,
        type=_executor,
        metavar="WHERE",
        help="serial, processes, processes:4, dask or dask:tcp://HOST:PORT, the "
        "scheduler of a cluster with a shared file system (default: "
        f"{default or 'two threads'}); the result is the same",
    )


def _executor(text: str) -> str:
    """Return the name of an executor that there is."""
    from consistent_id._support.executors import Executor
    from consistent_id.errors import ProblemError

    try:
        Executor.named(text)
    except ProblemError as cause:
        raise argparse.ArgumentTypeError(str(cause)) from None
    return text


def positive(text: str) -> float:
    """Read a positive number."""
    value = float(text)
    if not (value > 0.0 and math.isfinite(value)):
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value
