"""How a field of a `Statement` is declared, and read from words of the shell.

There is one reader for each kind of value.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from consistent_id.errors import ProblemError

if TYPE_CHECKING:
    from consistent_id.recordings.readers.units import Units
    from consistent_id.recordings.signals import PDGains

Names = str | Sequence[str]
"""The name of one array, or the names of columns."""

Part = Literal["robot", "log", "base", "model", "selection"]
"""Part that a field describes.  A selection has no key, because a problem file contains
its result.
"""


@dataclass(frozen=True, slots=True)
class Declaration:
    """The forms in which one field of `Statement` is stated.

    Parameters
    ----------
    part : {"robot", "log", "base", "model", "selection"}
    usage : str
        The option in the form of `Option`, such as ``--lock JOINT ...``.
    text : str
        One sentence, with the unit and the default.
    key : str
        The key in the problem file, such as ``model.locked``; empty if it has none.
    read : callable
        Function from the words of the option to the value.
    choices : tuple of str
        Words that the option accepts, if only these.
    """

    part: Part
    usage: str
    text: str
    key: str = ""
    read: Callable[[Any], Any] = str
    choices: tuple[str, ...] = ()

    @property
    def option(self) -> str:
        """The option's name, such as ``--lock``."""
        return self.usage.split()[0]


def positive(usage: str) -> Callable[[str], float]:
    """Return a reader of positive numbers for an option."""

    def read(word: str) -> float:
        with suppress(ValueError):
            if 0.0 < (value := float(word)) < float("inf"):
                return value
        raise ProblemError(f"{usage} {word}: expected a positive number")

    return read


def speed(word: str) -> float | Literal["model"]:
    """Read the speed beyond which rows are left out."""
    if word == "model":
        return "model"
    return positive("--most-joint-speed SPEED (or model)")(word)


def numbers(words: Sequence[str]) -> tuple[float, ...]:
    """Read factors from columns to torque."""
    try:
        return tuple(map(float, words))
    except ValueError:
        given = " ".join(words)
        raise ProblemError(f"--torque-gain {given}: expected numbers") from None


def vector(text: str) -> tuple[float, float, float]:
    """Read the acceleration of gravity [m/s^2]."""
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        raise ProblemError(
            f"--gravity {text}: expected X,Y,Z in m/s^2, such as 0,0,-9.81"
        ) from None
    return x, y, z


def read_position(word: str) -> tuple[str, float]:
    """Read a joint and its position, by default zero.

    Examples
    --------
    >>> read_position("elbow=0.5"), read_position("wrist")
    (('elbow', 0.5), ('wrist', 0.0))
    """
    joint, equals, position = word.partition("=")
    try:
        return joint, float(position) if equals else 0.0
    except ValueError:
        raise ProblemError(
            f"--lock {word}: {position!r} is no number, expected a position in rad or m"
        ) from None


def positions(words: Sequence[str]) -> dict[str, float]:
    """Read joints and where they stand still."""
    return dict(map(read_position, words))


def folders(words: Sequence[str]) -> tuple[Path, ...]:
    """Read paths."""
    return tuple(map(Path, words))


def pairs(usage: str) -> Callable[[Sequence[str]], dict[str, str]]:
    """Return a reader of ``LEFT=RIGHT`` for an option."""

    def read(words: Sequence[str]) -> dict[str, str]:
        parts = [word.partition("=") for word in words]
        for word, (left, equals, right) in zip(words, parts, strict=True):
            if not (left and equals and right):
                raise ProblemError(f"{usage.split()[0]} {word}: expected {usage}")
        return {left: right for left, _, right in parts}

    return read


def values(usage: str) -> Callable[[Sequence[str]], dict[str, float]]:
    """Return a reader of ``JOINT=NUMBER`` for an option."""

    def read(words: Sequence[str]) -> dict[str, float]:
        found = {}
        for joint, value in pairs(usage)(words).items():
            try:
                found[joint] = float(value)
            except ValueError:
                raise ProblemError(
                    f"{usage.split()[0]} {joint}={value}: {value!r} is no number"
                ) from None
        return found

    return read


def contacts(words: Sequence[str]) -> dict[str, str]:
    """Read columns of contacts by frame."""
    usage = "--contact FRAME=COLUMN, FRAME=always, or none alone"
    return {} if list(words) == ["none"] else pairs(usage)(words)


def columns(text: str) -> Names:
    """Read an array's name, or columns' names with commas between them."""
    return tuple(text.split(",")) if "," in text else text


def rows(usage: str) -> Callable[[Sequence[str]], dict[str, tuple[int, ...]]]:
    """Return a reader of row numbers, of all logs or behind ``LOG=`` of one."""

    def read(words: Sequence[str]) -> dict[str, tuple[int, ...]]:
        found: dict[str, tuple[int, ...]] = {}
        for word in words:
            log, _, numbers = word.rpartition("=")
            try:
                rows = tuple(int(number) for number in numbers.split(","))
            except ValueError:
                raise ProblemError(
                    f"{usage.split()[0]} {word}: expected {usage}, counted from 1"
                ) from None
            found[log] = (*found.get(log, ()), *rows)
        return found

    return read


def units(words: Sequence[str]) -> "Units":
    """Return units by channel; with commas between them, one for each joint.

    A unit without a channel is for the channels that can have it; an angle or a length
    is for the position and, per second, for its derivatives.

    Examples
    --------
    >>> units(["deg", "%"])["velocity"], units(["velocity=rpm"])
    ('deg/s', {'velocity': 'rpm'})
    """
    bare = [word for word in words if "=" not in word]
    named = (word.partition("=") for word in words if "=" in word)
    found: dict[str, str | list[str]] = {}
    for word in bare:
        found |= _fitting(word)
    for channel, _, unit in named:
        found[channel] = unit.split(",") if "," in unit else unit
    return found


def _fitting(unit: str) -> dict[str, str]:
    """Return the channels that have a unit."""
    from consistent_id.errors import RecordingError
    from consistent_id.recordings.readers.units import KNOWN, standard_unit

    fits = {}
    for channel in KNOWN:
        with suppress(RecordingError):
            fits[channel] = standard_unit(channel, unit)
    if not fits:
        known = ", ".join(dict.fromkeys(u for each in KNOWN.values() for u in each))
        raise RecordingError(f"--units: no unit {unit!r}; known: {known}")
    if moved := fits.get("position"):
        speed = f"{moved}/s"
        fits |= {"velocity": speed, "velocity_command": speed}
        fits |= {"acceleration": f"{moved}/s^2"}
    return fits


def gains(words: Sequence[str]) -> "PDGains":
    """Read gains of PD-controlled joints: one for all, or one each."""
    import numpy as np

    from consistent_id.recordings.signals import PDGains

    kp, kd, limit = np.array([_gain(word) for word in words]).T
    one = (kp[0], kd[0], limit[0])
    return PDGains(*one) if len(words) == 1 else PDGains(kp, kd, limit)


def _gain(word: str) -> tuple[float, float, float]:
    try:
        kp, kd, *limit = map(float, word.split(","))
        (most,) = limit or [float("inf")]
    except ValueError:
        raise ProblemError(
            f"--gains {word}: is no gain, expected KP,KD such as 60,1.5, or KP,KD,LIMIT"
        ) from None
    return kp, kd, most


def masses(word: str) -> str:
    """Read whether the model's masses are known: a file calls them the datasheet's."""
    return "datasheet" if word == "model" else word


def switched_off(given: bool) -> bool:
    """Read a switch that turns something off."""
    return not given
