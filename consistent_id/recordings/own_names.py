"""A log's own names of joints, and their mapping to the robot's.

Joints are never matched by their order alone: a message proposes the mapping, and the
user states it.
"""

import re
import shlex
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from functools import lru_cache
from operator import eq

from consistent_id.recordings.column_words import (
    HUMP,
    MEASURED,
    before_unit_of,
    channel_of,
    is_current,
    is_of_another,
    states,
)
from consistent_id.recordings.readers.units import is_unit

_PARTS = re.compile(r"[A-Za-z0-9]+|[^A-Za-z0-9]+")
_NUMBER_IN_BRACKETS = re.compile(r"\[\d+\]$")
_LETTER = re.compile(r"(?<![A-Za-z0-9])[A-Z](?![A-Za-z0-9])")  # a joint, not a word
_IN_UNIT = re.compile(r"[ _]*(?:[\[(]([^\[\]()]*)[\])]|_(deg|rad|mm))$")


def own_names(names: Sequence[str], channel: str = "position") -> tuple[str, ...]:
    """Return the parts in which the names of a channel's columns differ, in order.

    None, if these are numbers.

    Parameters
    ----------
    names : sequence of str
        All columns of the log.

    Examples
    --------
    >>> own_names(["time", "Base position", "Wrist 1 position", "Base torque"])
    ('Base', 'Wrist 1')
    >>> own_names(["Base angle [deg]", "Wrist angle [deg]", "Base torque [Nm]"])
    ('Base', 'Wrist')
    >>> own_names(["observation.state.pan.pos", "observation.state.lift.pos"])
    ('pan', 'lift')
    """
    return _own_names(tuple(names), channel)


# Called several times with the same names of a log.
@lru_cache(maxsize=8)
def _own_names(names: tuple[str, ...], channel: str) -> tuple[str, ...]:
    observed = states(names)
    groups: dict[tuple[str, str], list[str]] = defaultdict(list)
    for name in names:
        said = _LETTER.sub("", " ".join(_humps(name)))
        if channel_of(said, observed) != channel:
            continue
        bare = _without_measured(_without_unit(name))
        first, *others = _PARTS.findall(bare) or [""]
        *start, last = _humps(bare)
        if others and channel_of(others[-1]) == channel:
            mark = "".join(others[-2:]) + name[len(bare) :]
            groups["", mark].append(_without_measured(name.removesuffix(mark)))
        elif mark := _start_of(channel, [first, *others]):
            end = _closed(bare, mark) + name[len(bare) :]
            groups[mark, end].append(name.removeprefix(mark).removesuffix(end))
        elif start and channel_of(last) == channel:  # basePos
            mark = last + name[len(bare) :]
            groups["", mark].append(name.removesuffix(mark))
        elif start and channel_of(start[0]) == channel:  # posBase
            groups[start[0], ""].append(name.removeprefix(start[0]))
    for name in names if not groups else ():
        own = before_unit_of(channel, name)
        if own is None or channel_of(own) or is_current(own) or is_of_another(own):
            continue
        if not _NUMBER_IN_BRACKETS.search(own):  # else columns are numbered
            groups["", name.removeprefix(own)].append(own)
    found = max(groups.values(), key=len, default=[])
    differing = _without_common_start(found) if len(found) > 1 else ()
    if channel == "position" and not differing:
        others_own = list(_own_names(names, "torque"))
        return tuple(others_own) if set(others_own) <= set(names) else ()
    return () if any(_letters(name).isdigit() for name in differing) else differing


def _start_of(channel: str, parts: Sequence[str]) -> str:
    """Return the start of a name up to the words of a channel, and the mark behind."""
    for end in range(1, len(parts) - 1, 2):  # words and what is between take turns
        if channel_of("".join(parts[:end])) == channel:
            return "".join(parts[: end + 1])
    return ""


def _without_measured(name: str) -> str:
    """Return a name without last words that say that it is measured."""
    parts = _PARTS.findall(name)
    while len(parts) > 2 and parts[-1].lower() in MEASURED:
        del parts[-2:]
    return "".join(parts)


def _humps(name: str) -> list[str]:
    """Return the words of a name that capital letters begin; a letter may be one."""
    return HUMP.sub(" ", name).split(" ") if name.isalnum() else [name]


def _closed(name: str, mark: str) -> str:
    """Return the bracket that ends a name if the mark before it opens one."""
    pair = mark[-1:] + name[-1:]
    return pair[1] if pair in ("()", "[]", "{}") else ""


def _without_unit(name: str) -> str:
    """Return a name without the unit that ends it."""
    found = _IN_UNIT.search(name)
    is_one = found is not None and is_unit(found[1] or found[2])
    return name[: found.start()] if found is not None and is_one else name


def _without_common_start(names: Sequence[str]) -> tuple[str, ...]:
    """Return names without the words that all begin with, unless numbers are left."""
    parts = [_PARTS.findall(name) for name in names]
    common = 0
    while all(len(p) > common + 1 for p in parts) and (
        len({p[common] for p in parts}) == 1
    ):
        common += 1
    while common and (
        any(p[common].isdigit() for p in parts) or not parts[0][common][0].isalnum()
    ):
        common -= 1
    return tuple("".join(p[common:]) for p in parts)


def mapping_option(own: Sequence[str], joints: Sequence[str]) -> str:
    """Return the option that maps a log's names to the robot's joints, filled in.

    A name that equals a joint's, or that alone contains it or is a part of it, is that
    joint's; the rest are matched in their order.

    Examples
    --------
    >>> mapping_option(["Wrist 1", "A"], ["wrist_1_joint", "a2"])
    "--names 'Wrist 1=wrist_1_joint' A=a2"
    """
    pairs = pairs_of(own, joints)
    return "--names " + " ".join(shlex.quote(f"{n}={j}") for n, j in pairs)


def pairs_of(own: Sequence[str], joints: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Return pairs of a log's name and a joint that may be meant.

    Equal names first, then those that are alike and have no rival; the rest in order.
    """
    if affixes := _affixes(own, joints):
        before, after = affixes[0]
        return tuple((name, f"{before}{name}{after}") for name in own)
    left, open_ = list(own), list(joints)
    found: dict[str, str] = {}
    for related in (eq, _alike):
        found.update(_alone(left, open_, related))
        left = [name for name in left if name not in found]
        open_ = [joint for joint in open_ if joint not in found.values()]
    found.update(zip(left, open_, strict=False))
    return tuple((name, found[name]) for name in own if name in found)


def _affixes(own: Sequence[str], joints: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Return what stands before and after all names in joints' names, in their order.

    Examples
    --------
    >>> _affixes(["s0", "s1"], ["head", "left_s0", "left_s1", "right_s0", "right_s1"])
    (('left_', ''), ('right_', ''))
    """
    known = frozenset(joints)
    found = [
        (before, after)
        for joint in joints
        for before, mark, after in [joint.partition(own[0])]
        if mark and all(f"{before}{name}{after}" in known for name in own)
    ]
    return tuple(found) if len(own) > 1 else ()


def _alone(
    names: Sequence[str], joints: Sequence[str], related: Callable[[str, str], bool]
) -> list[tuple[str, str]]:
    """Return the pairs that are related, and neither of them to any other."""
    letters, of_joints = ([_letters(word) for word in some] for some in (names, joints))
    pairs = [
        (n, j)
        for n, one in enumerate(letters)
        for j, other in enumerate(of_joints)
        if related(one, other)
    ]
    of_names, of_others = (Counter(pair[k] for pair in pairs) for k in (0, 1))
    return [
        (names[n], joints[j])
        for n, j in pairs
        if of_names[n] == 1 and of_others[j] == 1
    ]


def mapping_advice(own: Sequence[str], joints: Sequence[str]) -> str:
    """Return a sentence that proposes the mapping of a log's names, filled in."""
    pairs = pairs_of(own, joints)
    what = f" The log's own names of joints are {', '.join(own)}"
    if rivals := _affixes(own, joints)[1:]:
        others = " and ".join(f"{before}{own[0]}{after}" for before, after in rivals)
        what += f" ({pairs[0][1]} and so on; {others} would fit as well)"
    if len(pairs) < len(joints):
        given = {joint for _, joint in pairs}
        rest = ", ".join(joint for joint in joints if joint not in given)
        what += f"; the robot has {len(joints)} joints, {rest} would be locked at zero"
    elif len(pairs) < len(own):
        named = {name for name, _ in pairs}
        rest = ", ".join(name for name in own if name not in named)
        what += f"; the robot has {len(joints)} joints, {rest} would not be read"
    return (
        f"{what}. Map them, after a check of the order: {mapping_option(own, joints)}"
    )


def _alike(one: str, other: str) -> bool:
    return one in other or other in one


def _letters(word: str) -> str:
    return re.sub("[^a-z0-9]", "", word.lower())
