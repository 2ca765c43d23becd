"""Options and arguments of a command as values, written as a line of usage has them."""

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
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
        or more. ``problem`` is an argument, ``[log]`` may be left out, of ``log [...]``
        there may be any number. What is called FILE or FOLDER is a path.
    text : str
        For the help, which adds the default.
    kind : callable, optional
        From the word that was given to the value.
    dest : str, optional
        The value's name, if it is not the option's.
    repeated : bool
        Whether it may be given several times; values are collected.
    const : bool, optional
        What a switch means when it is given, if nothing means None.

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
        """Let a parser, or a group of its options, take it."""
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
    """Options under a title of their own."""

    title: str
    options: tuple[Option, ...]
    text: str | None = None

    def add_to(self, parser: argparse._ActionsContainer) -> None:
        """Let a parser take them."""
        group = parser.add_argument_group(self.title, self.text)
        for option in self.options:
            option.add_to(group)


def positive(text: str) -> float:
    """Read a positive number."""
    value = float(text)
    if not (value > 0.0 and math.isfinite(value)):
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value
