"""Options and arguments of commands as values, and those that several share."""

import argparse
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

_REPEATED = {"...": "+", "[...]": "*"}
_PATHS = ("FILE", "FOLDER")


@dataclass(frozen=True, slots=True)
class Option:
    """One option of a command, or one argument.

    Parameters
    ----------
    usage : str
        ``--trust`` is a switch, ``--cutoff HZ`` has a value, ``--lock JOINT ...`` one
        or more.  ``problem`` is an argument, ``[log]`` may be omitted, and ``log
        [...]`` may be any number of arguments.  Values named FILE or FOLDER are paths.
    text : str
        Text for the help, which adds the default.
    kind : callable, optional
        Function from the given word to the value.
    dest : str, optional
        The value's name, if it is not the option's.
    repeated : bool
        Whether it may be given several times; values are collected.
    const : bool, optional
        The value of a switch that is given, if its absence means None.

    Examples
    --------
    >>> parser = argparse.ArgumentParser()
    >>> for option in (
    ...     Option("--starts N", "searches", int, default=4),
    ...     Option("--lock JOINT ...", "joints that stand still"),
    ... ):
    ...     option.add_to(parser)
    >>> vars(parser.parse_args(["--lock", "a", "b"]))
    {'starts': 4, 'lock': ['a', 'b']}
    """

    usage: str
    text: str
    kind: Callable[[str], Any] | None = None
    default: Any = None
    choices: Sequence[str] | None = None
    dest: str | None = None
    required: bool = False
    repeated: bool = False
    const: bool | None = None

    @property
    def name(self) -> str:
        """The value's name."""
        word = self.usage.replace(",", "").split()[0].strip("[]")
        return self.dest or word.removeprefix("--").replace("-", "_")

    def add_to(self, parser: argparse._ActionsContainer) -> None:
        """Add the option to a parser, or to a group of its options."""
        words = self.usage.split()
        names = [word.strip(",") for word in words if word.startswith("--")]
        value = " ".join(words[len(names) :])
        if not names:
            parser.add_argument(
                words[0].strip("[]"), help=self.text, **self._argument()
            )
        elif value or self.choices:
            parser.add_argument(*names, help=self._help(), **self._valued(value))
        else:
            parser.add_argument(*names, help=self.text, **self._switch())

    def _argument(self) -> dict[str, Any]:
        name, *more = self.usage.split()
        nargs = "?" if name.startswith("[") else _REPEATED[more[0]] if more else None
        return {"nargs": nargs, "type": self.kind, "choices": self.choices}

    def _valued(self, value: str) -> dict[str, Any]:
        name, _, more = value.partition(" ")
        default = () if more == "..." and self.default is None else self.default
        settings = {
            "type": self.kind or (Path if name in _PATHS else None),
            "metavar": name or None,
            "choices": self.choices,
            "required": self.required,
            "default": [] if self.repeated else default,
        }
        if self.dest is not None:
            settings["dest"] = self.dest
        if self.repeated:
            return settings | {"action": "append"}
        return settings | {"nargs": _REPEATED.get(more)}

    def _switch(self) -> dict[str, Any]:
        named = {} if self.dest is None else {"dest": self.dest}
        if self.const is None:
            return {"action": "store_true", **named}
        return {"action": "store_const", "const": self.const, **named}

    def _help(self) -> str:
        usual = self.default
        usual = f"{usual:g}" if isinstance(usual, float) else usual
        return self.text if usual is None else f"{self.text} (default: {usual})"


@dataclass(frozen=True, slots=True)
class Group:
    """Options under a common title."""

    title: str
    options: tuple[Option, ...]
    text: str | None = None

    def add_to(self, parser: argparse._ActionsContainer) -> None:
        """Add the options to a parser."""
        group = parser.add_argument_group(self.title, self.text)
        for option in self.options:
            option.add_to(group)


def positive(text: str) -> float:
    """Read a positive number."""
    value = float(text)
    if not (value > 0.0 and math.isfinite(value)):
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value


def finite(text: str) -> float:
    """Read a number that is neither infinite nor none at all."""
    value = float(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not a finite number")
    return value


def whole(text: str) -> int:
    """Read a whole number above zero."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number above 0")
    return int(text)


def page_file(text: str) -> Path:
    """Read the name of a page, which is HTML."""
    if Path(text).suffix.lower() in _NO_PAGES:
        raise argparse.ArgumentTypeError(
            f"{text}: the report is an HTML file, name it {Path(text).stem}.html; a "
            "browser prints it as PDF"
        )
    return Path(text)


_NO_PAGES = (".pdf", ".md", ".docx", ".tex", ".png")
_VECTORS = ("--gravity", "--tool")
_NUMBERS = re.compile(r"[-+.\d][-+.,\deE]*")


def with_vectors(words: Sequence[str]) -> list[str]:
    """Return the words of a command with vectors as one word each.

    A vector may be three words, or begin with a minus, which argparse takes for an
    option.

    Examples
    --------
    >>> with_vectors(["check", "--gravity", "0", "-9.81", "0", "arm.urdf"])
    ['check', '--gravity=0,-9.81,0', 'arm.urdf']
    >>> with_vectors(["--gravity", "-9.81,0,0", "1.urdf"])
    ['--gravity=-9.81,0,0', '1.urdf']
    """
    found = list[str]()
    for word in words:
        last = found[-1] if found else ""
        option, equals, value = last.partition("=")
        is_open = option in _VECTORS and (not equals or value.count(",") < 2)
        if is_open and _NUMBERS.fullmatch(word):
            found[-1] = f"{last}{',' if equals else '='}{word}"
        else:
            found.append(word)
    return found


Run = Callable[[argparse.Namespace], int]

PRINTED = Group(
    "what is printed",
    (
        Option("--json", "print JSON, not tables"),
        Option("--verbose", "print everything, not only the first lines"),
        Option("--quiet", "print only errors, and JSON with --json; see the exit code"),
    ),
)
# Permissions that files of strangers must not have.
STRANGERS = Group(
    "files from others",
    (
        Option(
            "--trust",
            "let a problem file name files anywhere, and any environment variable",
        ),
        Option("--large-files", "read files above the usual limits of size"),
    ),
)
ONE_PROBLEM = Option("problem", "folder with a problem.toml, or the file", Path)
FORCE = Option(
    "--force", "write even over an input, or a file that this tool did not write"
)
WRITES = (Option("--dry-run", "write nothing"), FORCE)
OUTPUT = (Option("--output FOLDER", "folder to write results to"), *WRITES)
RESULTS = (
    Option("--output FOLDER", "folder to write results to (default: results/NAME)"),
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
    "give up after this time, with exit code 3 (default: never)",
    positive,
    dest="give_up_after",
)
SEED_OF_BOOTSTRAP = Option("--seed N", "seed of the bootstrap", int, default=0)


def _executor(text: str) -> str:
    """Return the name of an executor after checking it."""
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
# For fits; by default in threads of this computer.
FITS_EXECUTOR = replace(
    EXECUTOR, text=f"{EXECUTOR.text} (default: two threads)", default=None
)
# For searches, and for robots that play designed motions.
SEARCH_EXECUTOR = replace(
    EXECUTOR,
    text=f"{EXECUTOR.text} (default: processes of this computer)",
    default=None,
)


def add_command(
    command: argparse.ArgumentParser,
    run: Run,
    *options: Option | Group,
    more: str = "",
    examples: str,
    reads: bool = True,
) -> None:
    """Give a command its options, and those that every command takes.

    Parameters
    ----------
    command : argparse.ArgumentParser
        A parser with one line of description.
    run : callable
        Function from the given options to the exit code.
    options : Option or Group
        The command's own, in the order of its help.
    more : str
        Further text of the command's own help.
    examples : str
        Lines, each a valid call.
    reads : bool
        Whether it reads files.
    """
    shown = "\n".join(f"  {line}" for line in examples.strip().splitlines())
    command.description = f"{command.description}\n{more}".strip()
    command.epilog = f"examples:\n{shown}"
    command.set_defaults(run=run)
    for option in (PRINTED, *((STRANGERS,) if reads else ()), *options):
        option.add_to(command)
