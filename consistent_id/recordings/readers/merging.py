"""Parts of a sample that came in several messages, put together by their stamps."""

import logging
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from consistent_id._support.arrays import Array, BoolArray, IntArray
from consistent_id.errors import RecordingError

# Complete samples per sample of the joint that is seldom seen. Two topics or publishers
# that share a clock reach nearly 1; by chance, stamps of nanoseconds hardly ever meet.
_SHARED = 0.5

_log = logging.getLogger(__name__)


class Layout(NamedTuple):
    """Messages that name the same joints in the same order.

    Parameters
    ----------
    order : ndarray of int, shape (messages,)
        Place of each in the log.
    stamps : ndarray of int, shape (messages,), [ns]
    joints : ndarray of int, shape (columns,)
        Which of the wanted joints they hold.
    values : ndarray, shape (fields, messages, columns)
    """

    order: IntArray
    stamps: NDArray[np.int64]
    joints: IntArray
    values: Array


class Merged(NamedTuple):
    """Complete samples: stamps [ns], and values of shape (fields, samples, joints)."""

    stamps: NDArray[np.int64]
    values: Array


def merged(layouts: Sequence[Layout], joints: Sequence[str], where: str) -> Merged:
    """Return the stamps at which every joint was seen, increasing, with the values.

    A message that was logged twice counts once.

    Raises
    ------
    RecordingError
        If two messages of one stamp differ in a value, or if most samples of the joint
        that is seen least lack another joint.
    """
    stamps = np.unique(np.concatenate([layout.stamps for layout in layouts]))
    fields = len(layouts[0].values)
    values = np.full((fields, len(stamps), len(joints)), np.nan)
    seen = np.zeros((len(stamps), len(joints)), dtype=bool)
    for layout in layouts:
        rows = np.searchsorted(stamps, layout.stamps)
        cells = np.ix_(np.arange(fields), rows, layout.joints)
        fresh = ~seen[np.ix_(rows, layout.joints)]
        values[cells] = np.where(fresh, layout.values, values[cells])
        seen[np.ix_(rows, layout.joints)] = True
        differs = (values[cells] != layout.values).any(axis=0)
        if differs.any():
            message, column = np.argwhere(differs)[0]
            raise RecordingError(
                f"{where}: joint {joints[layout.joints[column]]!r} has two values "
                f"at {seconds(layout.stamps[message])} s; repair the log"
            )
    full: BoolArray = np.all(seen, axis=1)
    least = int(seen.sum(axis=0).argmin())
    if full.sum() < _SHARED * seen[:, least].sum():
        apart = int(seen[seen[:, least]].sum(axis=0).argmin())
        raise RecordingError(
            f"{where}: joints {joints[least]!r} and {joints[apart]!r} come in messages "
            f"that hardly ever share a stamp: {full.sum()} of "
            f"{seen[:, least].sum()} samples have all joints. Read them one by one and "
            "resample them onto one clock"
        )
    if not full.all():
        _log.warning(
            "%s: %d of %d samples lack a joint and are left out",
            where,
            len(full) - full.sum(),
            len(full),
        )
    return Merged(stamps[full], values[:, full])


def seconds(stamp: int) -> str:
    """Return a stamp [ns] in seconds, to its last digit."""
    whole, rest = divmod(int(stamp), 10**9)
    return f"{whole}.{rest:09d}"
