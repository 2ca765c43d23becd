"""The rows of a log that are used: not omitted, complete, with increasing time."""

import logging
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, IntArray, Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.time_stamps import LATEST

_log = logging.getLogger(__name__)

Duplicates = Literal["refuse", "first", "last"]
"""The row that is used if several have one time stamp."""

Missing = Literal["refuse", "omit"]
"""Whether rows with empty or NaN values are left out."""


class NoValueError(RecordingError):
    """A joint has no value of a channel in any row.

    Parameters
    ----------
    channel : str
    said : str
        The fact, without advice.
    """

    def __init__(self, said: str, channel: str, advice: str, options: str = "") -> None:
        super().__init__(said + advice, options=options)
        self.said, self.channel = said, channel


class EmptyTableError(RecordingError):
    """A table has a header, and no row."""


class FaultyRowsError(RecordingError):
    """Rows of a table that cannot be read.

    Parameters
    ----------
    said : str
        The first fault, without advice.
    every : bool
        Whether no row can be read.
    """

    def __init__(
        self, said: str, advice: str, options: str = "", *, every: bool = False
    ) -> None:
        super().__init__(said + advice, options=options)
        self.said, self.every = said, every


class UsedRows(NamedTuple):
    """The rows of a log that a recording is made of.

    Parameters
    ----------
    omit : collection of int
        Rows to leave out, counted from 1.
    duplicates : {"refuse", "first", "last"}
        The row that is used if several successive ones have one time stamp.
    missing : {"refuse", "omit"}
        Whether rows in which a value is missing are left out.
    numbers : ndarray of int, shape (rows,), optional
        Numbers of the rows in the file, by default from 1 on.
    """

    omit: Collection[int] = ()
    duplicates: Duplicates = "refuse"
    missing: Missing = "refuse"
    numbers: IntArray | None = None


OMIT_MISSING = "--missing omit"

MISSING_ADVICE = f". Rows with missing values are left out by {OMIT_MISSING}"

_MOST = 20  # rows to leave out that are listed; more are no single broken ones

_GAP = 10.0  # usual steps without a sample

_SHORTEST = 4  # rows between two gaps of the clock, of which fewer are broken ones

_LEAST_OF_A_RECORDING = 100
"""Rows of a part of a file that is a recording of its own."""

BREAK = 3.0
"""Time between recordings that one file contains one after another [s]."""


def of_one_clock(time: Vector, keep: BoolArray, second: float, where: str) -> Vector:
    """Return the time of recordings that one file contains one after another.

    Where the clock goes back, a recording ends, if all are long and nowhere else the
    clock stands or goes back; the next one follows after a break.  Otherwise, or if a
    few wild stamps make it go back, the clock is returned as it is, and refused later.

    Parameters
    ----------
    time : ndarray, shape (rows,)
    keep : ndarray of bool, shape (rows,)
        Rows in use.
    second : float
        In the unit of `time`.
    """
    rows = np.flatnonzero(keep & (abs(time) <= LATEST))
    steps = np.diff(time[rows])
    ends = np.flatnonzero(steps <= 0.0)
    if not len(ends) or (steps[ends] == 0.0).any():
        return time
    lengths = np.diff(np.concatenate([[-1], ends, [len(rows) - 1]]))
    if lengths.min() < _LEAST_OF_A_RECORDING or len(broken_samples(time[rows], ())):
        return time
    late = np.zeros(len(time))
    late[rows[ends + 1]] = BREAK * second - steps[ends]
    shown = ", ".join(str(row + 1) for row in rows[ends[:_MOST] + 1].tolist())
    _log.warning(
        "%s: the clock goes back at row %s; the parts are read as recordings one after "
        "another, %g s apart",
        where,
        shown,
        BREAK,
    )
    return np.asarray(time + np.cumsum(late))


def broken_samples(time: Vector, arrays: Iterable[Array]) -> IntArray:
    """Return samples without which the clock increases and all values are finite.

    Few samples between two gaps of the clock, or between a gap and an end, are among
    them, unless the gap is one of other samples that are left out, and so is one of two
    samples where the clock goes back by less than a gap.  Empty if long parts of a log
    contradict each other: leaving out samples does not mend that.

    Examples
    --------
    >>> time = np.array([0.0, 2.7e154, 50.0, 50.1, 50.2, 50.3, 50.4])
    >>> broken_samples(time, [])
    array([0, 1])
    """
    good = np.isfinite(time) & (abs(time) <= LATEST)
    for values in arrays:
        good &= np.isfinite(values).reshape(len(time), -1).all(axis=1)
    places = np.flatnonzero(good)
    steps = np.diff(time[places])
    if not (steps > 0.0).any():
        return np.empty(0, dtype=int)
    longest = _GAP * float(np.median(steps[steps > 0.0]))
    short = np.split(places, np.flatnonzero((steps <= 0.0) | (steps > longest)) + 1)
    back = np.flatnonzero((steps < 0.0) & (steps >= -longest))
    alone = [p for p in short if len(p) < _SHORTEST]
    doubtful = np.unique(np.concatenate([*alone, places[back], places[back + 1]]))
    good[doubtful] = False

    def fits(sample: int) -> bool:
        before, after = np.flatnonzero(good[:sample]), np.flatnonzero(good[sample:])
        near = [time[before[-1]]] if len(before) else []
        near += [time[sample]]
        near += [time[sample + after[0]]] if len(after) else []
        return all(0.0 < b - a <= longest for a, b in pairwise(near))

    if len(doubtful) <= _MOST:
        for sample in [*doubtful.tolist()[::-1], *doubtful.tolist()]:
            good[sample] = good[sample] or fits(sample)
    if not good.any() or (np.diff(time[good]) <= 0.0).any():
        return np.empty(0, dtype=int)
    return np.flatnonzero(~good)


def omit_advice(rows: Sequence[int], of: int) -> str:
    """Return the sentence that names broken rows to leave out, counted from 1.

    Empty if they are many, or most of the `of` rows.
    """
    if not rows or len(rows) > _MOST or 2 * len(rows) > of:
        return ""
    which = "that row is" if len(rows) == 1 else "those rows are"
    them = "it" if len(rows) == 1 else "them"
    given = ",".join(map(str, rows))
    return (
        f". If only {which} broken, leave {them} out: --omit {given} (omit = "
        f"{list(rows)} of read_recording and [[data.recordings]])"
    )


def distinct(time: Vector, duplicates: Duplicates) -> BoolArray:
    """Return the rows to use if several have one stamp; all, to refuse them later."""
    repeated = np.zeros(len(time), dtype=bool)
    if duplicates == "first":
        repeated[1:] = time[1:] == time[:-1]
    elif duplicates == "last":
        repeated[:-1] = time[1:] == time[:-1]
    return ~repeated


def complete(
    time: Vector, channels: Mapping[str, Matrix], joints: Sequence[str], where: str
) -> BoolArray:
    """Return the rows in which no value is missing.

    Raises
    ------
    RecordingError
        If there are none.
    """
    complete = ~np.isnan(time)
    for values in channels.values():
        complete &= ~np.isnan(values).any(axis=1)
    if not complete.any():
        for channel, values in channels.items():
            _require_written(channel, values, joints, where)
        counts = ", ".join(
            str(int((~np.isnan(values)).all(axis=1).sum()))
            for values in channels.values()
        )
        raise RecordingError(
            f"{where}: no row of {len(time)} has all values: the channels have "
            f"{counts} complete rows, but not the same ones. They were written at "
            "other times: export them resampled to one clock"
        )
    return np.asarray(complete)


def _require_written(
    channel: str, values: Matrix, joints: Sequence[str], where: str
) -> None:
    """Refuse a channel in which a joint has no value at all."""
    empty = np.flatnonzero(np.isnan(values).all(axis=0)).tolist()
    if not empty:
        return
    names = ", ".join(joints[j] for j in empty)
    said = f"{where}: the {channel} of {names} has no value in any row"
    others = " ".join(joint for j, joint in enumerate(joints) if j not in empty)
    if channel != "torque" or not others:
        raise NoValueError(said, channel, ": record it, or name other columns")
    options = f"--torque-joints {others}"
    advice = f". To use the torque of the others: {options}"
    raise NoValueError(said, channel, advice, options)


def kept(rows: int, omit: Collection[int], where: str) -> BoolArray:
    """Return the rows to use if some are omitted, counted from 1.

    Raises
    ------
    RecordingError
        If there is no such row.
    """
    keep = np.ones(rows, dtype=np.bool_)
    for row in omit:
        if not 1 <= row <= rows:
            raise RecordingError(
                f"{where}: omit names row {row}, but there are {rows}, counted from 1"
            )
        keep[row - 1] = False
    return keep
