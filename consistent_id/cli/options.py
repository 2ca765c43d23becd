"""Options that several commands share, each said once."""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from consistent_id.cli.option import Group, Option, positive

Run = Callable[[argparse.Namespace], int]

PRINTED = Group(
    "what is printed",
    (
        Option("--json", "JSON, not tables"),
        Option("--verbose", "everything, not only the first lines"),
        Option(
            "--quiet", "nothing but errors, and JSON if asked for; see the exit code"
        ),
    ),
)
# Leave to read what files of strangers must not ask for.
STRANGERS = Group(
    "files of strangers",
    (
        Option(
            "--trust",
            "let a problem file name files anywhere, and any environment variable",
        ),
        Option("--large-files", "read files larger than robots and logs are"),
    ),
)
PROBLEM = Option(
    "problem", "folder with a problem.toml, the file, or a folder of several", Path
)
ONE_PROBLEM = Option("problem", "folder with a problem.toml, or the file", Path)
FORCE = Option(
    "--force", "write even over an input, or a file that this tool did not write"
)
WRITES = (Option("--dry-run", "write nothing"), FORCE)
OUTPUT = (Option("--output FOLDER", "to write results to"), *WRITES)
RESULTS = (
    Option("--output FOLDER", "to write results to (default: results/NAME)"),
    *WRITES,
)
ACCEPT = Option(
    "--accept KIND",
    "overlook one kind of finding or reason, such as 'torque sign'; can be repeated, "
    "and is recorded in every file that is written",
    repeated=True,
)
TIME_LIMIT = Option(
    "--time-limit SECONDS",
    "give up after so long, with exit code 3 (default: never)",
    positive,
    dest="give_up_after",
)
SEED_OF_BOOTSTRAP = Option("--seed N", "of the bootstrap", int, default=0)


def _executor(text: str) -> str:
    """Return the name of an executor that there is."""
    from consistent_id._support.executors import Executor
    from consistent_id.errors import ProblemError

    try:
        Executor.named(text)
    except ProblemError as cause:
        raise argparse.ArgumentTypeError(str(cause)) from None
    return text


EXECUTOR = Option(
    "--executor WHERE",
    "serial, processes, processes:4, dask or dask:tcp://HOST:PORT, the scheduler of a "
    "cluster with a shared file system; the result is the same",
    _executor,
    default="serial",
)
# Of fits, where a machine's threads are the usual place.
FITS_EXECUTOR = replace(
    EXECUTOR, text=f"{EXECUTOR.text} (default: two threads)", default=None
)
# Of searches, and of robots that play what they find.
SEARCH_EXECUTOR = replace(
    EXECUTOR,
    text=f"{EXECUTOR.text} (default: processes of this computer)",
    default=None,
)


def add_command(
    commands: Any,
    name: str,
    text: str,
    run: Run,
    *options: Option | Group,
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
    options : Option or Group
        The command's own, in the order of its help.
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
    for option in (PRINTED, *((STRANGERS,) if reads else ()), *options):
        option.add_to(command)
    return command
