"""Columns of one channel whose names differ by more than the joint.

Some joints of many robots slide: ``J1 torque [Nm]`` is beside ``J3 force [N]``.  Such
names are a list in a pattern, one for each joint.
"""

import re
import shlex
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from consistent_id.errors import RecordingError
from consistent_id.recordings.column_names import (
    NamePattern,
    columns_of_pattern,
    name_patterns,
    shown,
)
from consistent_id.recordings.column_words import (
    channel_of,
    is_current,
    is_force,
    words,
)

_NUMBER = re.compile(r"\d+")


def mixed_patterns(
    channel: str,
    names: Sequence[str],
    patterns: Sequence[NamePattern],
    joints: tuple[str, ...],
    every: tuple[str, ...] = (),
    sliding: Collection[str] = (),
) -> list[NamePattern]:
    """Return patterns, a list of columns first if it has more joints than they have.

    Parameters
    ----------
    patterns : sequence of NamePattern
        The patterns of some joints, the best first.
    joints : tuple of str
        The joints whose columns are wanted.
    every : tuple of str
        All joints in their order, which numbers count; by default the same.
    sliding : collection of str
        Joints whose torque may be called force.
    """
    slide = tuple(joint for joint in joints if joint in sliding)
    forces = [] if channel != "torque" else name_patterns("force", names, slide, every)
    some = [*patterns, *forces]
    found: dict[str, str] = {}
    for pattern in some:
        if not pattern.is_array:
            of_pattern = columns_of_pattern(pattern)
            for joint, column in zip(pattern.joints, of_pattern, strict=True):
                found.setdefault(joint, column)
    if not patterns and set(found) < set(joints):
        found = _by_number(channel, names, joints, every or joints, sliding) or found
    most = max((len(pattern.joints) for pattern in some), default=1)
    if len(found) <= most or any(set("{},") & set(name) for name in found.values()):
        return some
    named = tuple(joint for joint in joints if joint in found)
    text = "{" + ",".join(found[joint] for joint in named) + "}"
    return [NamePattern(text, named), *some]


def _by_number(
    channel: str,
    names: Sequence[str],
    joints: Sequence[str],
    every: Sequence[str],
    sliding: Collection[str],
) -> dict[str, str]:
    """Return the only column of each joint with its number; empty if not of all."""
    for first in (1, 0):
        numbers = {str(first + every.index(joint)): joint for joint in joints}
        found: dict[str, list[str]] = {joint: [] for joint in joints}
        for name in names:
            for number, text in _numbered(name):
                joint = numbers.get(number)
                if joint is not None and _fits(channel, text, joint in sliding):
                    found[joint].append(name)
        if all(len(some) == 1 for some in found.values()):
            only = {joint: name for joint, (name,) in found.items()}
            return {} if _goes_on(only, numbers, names) else only
    return {}


def _goes_on(
    found: dict[str, str], numbers: dict[str, str], names: Sequence[str]
) -> bool:
    """Return whether a column of the same name has a number before or after all.

    Then which are the joints' is open, such as of q0 to q6 of an arm of six joints.
    """
    ends = (str(min(map(int, numbers)) - 1), str(max(map(int, numbers)) + 1))
    of_joints = {numbers[n]: n for n in numbers}
    return any(
        f"{before}{end}{after}" in names
        for joint, name in found.items()
        for before, mark, after in [name.rpartition(of_joints[joint])]
        for end in ends
        if mark
    )


def _numbered(name: str) -> Iterator[tuple[str, str]]:
    """Yield each number in a name, and the name with ``{joint}`` in its place."""
    for part in _NUMBER.finditer(name):
        yield part[0], f"{name[: part.start()]}{{joint}}{name[part.end() :]}"


def _fits(channel: str, text: str, slides: bool) -> bool:
    force = channel == "torque" and slides and is_force(text)
    return channel_of(text) == channel or (force and not channel_of(text))


def rivals(best: NamePattern, others: Sequence[NamePattern]) -> str:
    """Return the patterns of other columns for the same joints."""
    mine = columns_of_pattern(best)
    alike = [p for p in others if len(p.joints) == len(best.joints)]
    return ", ".join(p.text for p in alike if columns_of_pattern(p) != mine)


def require_one_torque(
    log: Path,
    best: NamePattern,
    others: Sequence[NamePattern],
    moved: Sequence[str],
    names: Sequence[str],
) -> None:
    """Refuse a log whose torques are named in two ways, of which one would be left out.

    Parameters
    ----------
    best : NamePattern
        Of the torque of some joints.
    others : sequence of NamePattern
        Further patterns of torque.
    moved : sequence of str
        The joints of which the log has positions.
    names : sequence of str
        Columns of the log; a name of a joint with the word force may be that of one
        that slides.

    Raises
    ------
    RecordingError
        If another pattern or name may hold the torque of further joints.
    """
    left = [joint for joint in moved if joint not in best.joints]
    unlisted = {
        joint: pattern.text
        for pattern in reversed(others)
        for joint in left
        if joint in pattern.joints
    }
    forces = {
        joint: name
        for joint in left
        for name in names
        if joint in name and {"force", "forces"} & words(name.replace(joint, "{joint}"))
    }
    if not (there := unlisted or forces):
        return
    of_best = dict(zip(best.joints, columns_of_pattern(best), strict=True))
    every = of_best | there
    both = "Name them alike, without units"
    if not unlisted and len(every) == len(moved):
        listed = "{" + ",".join(every[joint] for joint in moved) + "}"
        both = f"To read all: --torque {shlex.quote(listed)}"
    raise RecordingError(
        f"{log}: torque of {shown(best.joints)} is in {best.text}, that of "
        f"{shown(list(there))} may be in {', '.join(dict.fromkeys(there.values()))}. "
        f"{both}; or, if only the first is one: "
        f"--torque-joints {' '.join(best.joints)}"
    )


def require_torque(pattern: str | None, torque_gain: Sequence[float]) -> None:
    """Refuse motor currents as torque without a gain.

    Parameters
    ----------
    pattern : str, optional
        Name of the torque's columns.
    torque_gain : sequence of float
        The given gain; empty if there is none.

    Raises
    ------
    RecordingError
        If the name says current and not torque, and there is no gain.
    """
    if is_current(pattern or "") and not len(torque_gain):
        raise RecordingError(
            f"torque is read from {pattern}, whose name denotes a current, without a "
            f"gain. Give the N m per ampere of each joint, gear ratio included: "
            "--torque-gain (torque_gain); 1 if these columns are torques in N m"
        )
