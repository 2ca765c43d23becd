"""Columns whose names differ by a number or by a joint, as one pattern each."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class NumberedColumns:
    """Columns whose names differ only by a number.

    Parameters
    ----------
    before, after : str
        The text on either side of the number.
    """

    before: str
    after: str
    first: int
    last: int

    def __len__(self) -> int:
        return self.last - self.first + 1

    def __str__(self) -> str:
        return f"{self.before}{{{self.first}..{self.last}}}{self.after}"

    @property
    def pattern(self) -> str:
        """The pattern without its number, for words and units."""
        return f"{self.before}{{number}}{self.after}"

    def name(self, place: int) -> str:
        """Return the name at an index, from 0."""
        return f"{self.before}{self.first + place}{self.after}"


def numbered_columns(names: Sequence[str]) -> tuple[NumberedColumns, ...]:
    """Return runs of at least two names with consecutive numbers, in the log's order.

    Examples
    --------
    >>> [str(run) for run in numbered_columns(["t", "q1", "q2", "q3", "tau_0_Nm"])]
    ['q{1..3}']
    """
    known = frozenset(names)
    return tuple(dict.fromkeys(run for name in names for run in _runs(name, known)))


_DIGITS = re.compile(r"\d+")


def _runs(name: str, known: frozenset[str]) -> Iterator[NumberedColumns]:
    for found in _DIGITS.finditer(name):
        if found[0] not in ("0", "1"):
            continue
        before, after = name[: found.start()], name[found.end() :]
        first = int(found[0])
        if f"{before}{first - 1}{after}" in known:
            continue
        last = first
        while f"{before}{last + 1}{after}" in known:
            last += 1
        if last > first:
            yield NumberedColumns(before, after, first, last)


def with_joint(name: str, joints: Sequence[str]) -> str:
    """Return a name with ``{joint}`` in place of a joint's name, if it has one.

    Whole words are preferred, then longer names: joint_10 to joint_1.
    """
    within = [j for j in joints if j in name]
    whole = [j for j in within if _is_whole(j, name)] if len(within) > 1 else within
    inside = max(whole or within, key=len, default=None)
    return name if inside is None or "{" in name else name.replace(inside, "{joint}")


def _is_whole(joint: str, name: str) -> bool:
    """Return whether a name has a joint's in whole words: of b.tau, b and not a."""
    return re.search(rf"(?<![^\W_]){re.escape(joint)}(?![^\W_])", name) is not None


def shown(names: Sequence[str], joints: Sequence[str] = (), most: int = 12) -> str:
    """Return names for a message: as patterns if they have numbers or joints' names.

    Examples
    --------
    >>> shown(["time", "q1", "q2", "current1", "current2"])
    'time, q{1..2}, current{1..2}'
    >>> shown(["time", "q_hip", "q_knee"], ["hip", "knee"])
    'time, q_{joint}'
    """
    names = list(dict.fromkeys(with_joint(name, joints) for name in names))
    lines: list[str] = []
    gone: set[str] = set()
    runs = numbered_columns(names)
    for name in names:
        if name in gone:
            continue
        run = next((r for r in runs if name == r.name(0)), None)
        lines.append(name if run is None else str(run))
        if run is not None:
            gone |= {run.name(place) for place in range(len(run))}
    more = len(lines) - most
    return ", ".join(lines[:most]) + (f" and {more} more" if more > 0 else "")
