"""Columns of one source: the further words that the names of its channels share.

Of two arms in a log, or of references beside readings, ``left_q`` and ``right_tau`` are
equally good names; the torque of ``left_q`` is ``left_tau``.
"""

from collections.abc import Mapping, Sequence
from itertools import takewhile

from consistent_id.recordings.column_names import NamePattern, rank
from consistent_id.recordings.column_proposals import KnownColumns, candidates
from consistent_id.recordings.column_words import further_words
from consistent_id.recordings.readers.columns import Columns


def ordered_patterns(
    channel: str,
    names: Sequence[str],
    *,
    moved: tuple[str, ...],
    found: Columns,
    known: KnownColumns,
) -> list[NamePattern]:
    """Return patterns of a channel, the best first: of one source, if several are.

    Parameters
    ----------
    moved : tuple of str
        Joints whose columns are wanted.
    found : Columns
        The channels that are found so far.
    """
    patterns = candidates(channel, names, moved, known)
    patterns = _of_one_source(channel, patterns, names, found, known)
    return [p for p in patterns if not (known.flat and p.is_array)]


def _of_one_source(
    channel: str,
    patterns: Sequence[NamePattern],
    names: Sequence[str],
    found: Columns,
    known: KnownColumns,
) -> list[NamePattern]:
    """Return patterns; of equally good ones that of other channels' source first."""
    if channel != "position":
        return of_one_source(channel, patterns, found.position)
    others = [c for c in ("velocity", known.effort) if c not in known.channels]
    of_others = {c: candidates(c, names, known.joints, known) for c in others}
    stated = {c: [NamePattern(n, ())] for c, n in known.channels.items() if c != "time"}
    return most_common_source(patterns, of_others | stated)


def of_one_source(
    channel: str, patterns: Sequence[NamePattern], position: str
) -> list[NamePattern]:
    """Return patterns of a channel; of equally good ones that of the position first.

    Examples
    --------
    >>> both = [NamePattern(f"{arm}_tau{{joint}}", ("a",)) for arm in ("r", "l")]
    >>> of_one_source("torque", both, "l_q{joint}")[0].text
    'l_tau{joint}'
    """
    equal = _equally_good(channel, patterns)
    own = further_words(position)
    equal.sort(key=lambda p: len(further_words(p.text) ^ own))
    return [*equal, *patterns[len(equal) :]]


def most_common_source(
    patterns: Sequence[NamePattern], others: Mapping[str, Sequence[NamePattern]]
) -> list[NamePattern]:
    """Return patterns of positions, first one whose words most other channels have.

    As they are, if one of equally good ones has no further word.

    Parameters
    ----------
    others : mapping of str to sequence of NamePattern
        Patterns of the other channels.

    Examples
    --------
    >>> q, dq = ([NamePattern(f"{x}_{m}", ("a",)) for m in "rm"] for x in ("q", "dq"))
    >>> most_common_source(q, {"velocity": dq[1:]})[0].text
    'q_m'
    """
    equal = _equally_good("position", patterns)
    if not all(further_words(p.text) for p in equal):
        return list(patterns)
    words = [[further_words(p.text) for p in found] for found in others.values()]

    def apart(pattern: NamePattern) -> int:
        own = further_words(pattern.text)
        return sum(min(len(own ^ other) for other in found) for found in words if found)

    equal.sort(key=apart)
    return [*equal, *patterns[len(equal) :]]


def _equally_good(channel: str, patterns: Sequence[NamePattern]) -> list[NamePattern]:
    """Return the first patterns, which are of one rank."""
    best = [rank(channel, pattern) for pattern in patterns[:1]]
    return list(takewhile(lambda p: rank(channel, p) == best[0], patterns))
