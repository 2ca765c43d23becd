"""Which samples of a stretch count: those of the file's rows, in motion, fast enough.

Top speeds are those of the whole stretch, so that they take a pass of their own.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import BoolArray, Matrix, Vector
from consistent_id._support.executors import Executor
from consistent_id.errors import RecordingError
from consistent_id.problems.streaming.windows import PreparedStretch
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.masks import (
    STILL,
    speed_reach,
    speed_share,
    standstill,
)

_AT_ONCE = 32  # windows that one worker takes: a million samples

Cuts = tuple[tuple[int, int], ...]


@dataclass(frozen=True, eq=False)
class KeptRows:
    """Samples of a stretch that count.

    Parameters
    ----------
    first, last : int
        Samples ``first <= sample < last``.
    top : ndarray, shape (joints,), optional, [rad/s or m/s]
        Top speed of each joint in them, if slow samples are to be left out.
    """

    whole: PreparedStretch
    first: int
    last: int
    top: Vector | None = None

    @property
    def cuts(self) -> list[tuple[int, int]]:
        """Consecutive windows."""
        return self.whole.cuts(self.first, self.last)

    @property
    def tasks(self) -> list["KeptWindows"]:
        """The windows, some at a time."""
        cuts = self.cuts
        starts = range(0, len(cuts), _AT_ONCE)
        return [KeptWindows(self, tuple(cuts[at : at + _AT_ONCE])) for at in starts]


@dataclass(frozen=True, eq=False)
class KeptWindows:
    """Some windows of the samples that count.

    Parameters
    ----------
    cuts : tuple of (int, int)
        Samples of each window, ascending.
    """

    rows: KeptRows
    cuts: Cuts

    def recordings(self) -> Iterator[tuple[Recording, BoolArray]]:
        """Yield what is prepared of each window, and which of its samples count."""
        rows, whole = self.rows, self.rows.whole
        least = whole.table.least_speed
        if rows.top is None or least is None:
            for part in whole.windows(self.cuts):
                yield part, np.ones(len(part), dtype=np.bool_)
            return
        step = whole.table.decimate
        reach = step * speed_reach(step / whole.stretch.rate)
        wide = [
            (max(first - reach, rows.first), min(last + reach, rows.last))
            for first, last in self.cuts
        ]
        for (first, last), part in zip(self.cuts, whole.windows(wide), strict=True):
            fast = speed_share(part, top=rows.top) >= least
            own = whole.samples_of(part)
            inside = np.flatnonzero((own >= first) & (own < last))
            yield part.samples(inside), fast[inside]


def kept_rows(
    whole: PreparedStretch, first: int, last: int, executor: Executor
) -> KeptRows:
    """Return the samples that count among ``first <= sample < last``.

    Raises
    ------
    RecordingError
        If no joint ever moves in them.
    """
    rows, table = KeptRows(whole, first, last), whole.table
    if table.trim_standstill is False and table.least_speed is None:
        return rows
    tasks = rows.tasks
    tops = np.vstack(list(executor.map(top_speeds, tasks)))
    if table.trim_standstill is not False:
        speed = table.trim_standstill
        still = STILL * float(tops.max()) if speed is True else float(speed)
        windows = [cut for task in tasks for cut in task.cuts]
        rows = _in_motion(rows, windows, tops, still)
    if table.least_speed is None:
        return rows
    if (rows.first, rows.last) != (first, last):
        tops = np.vstack(list(executor.map(top_speeds, rows.tasks)))
    return replace(rows, top=tops.max(axis=0))


def top_speeds(task: KeptWindows) -> Matrix:
    """Return the top speed of each joint in each window, shape (windows, joints)."""
    speeds = (part.velocity for part, _ in task.recordings())
    return np.array([abs(dq).max(axis=0) for dq in speeds if dq is not None])


def _in_motion(
    rows: KeptRows, windows: Sequence[tuple[int, int]], tops: Matrix, still: float
) -> KeptRows:
    """Cut off the standstill of all joints at both ends."""
    moving = np.flatnonzero(((tops >= still) & (tops > 0.0)).any(axis=1))
    if not len(moving):
        raise RecordingError(f"{rows.whole.stretch.name}: no joint ever moves")
    ends = dict.fromkeys((windows[moving[0]], windows[moving[-1]]))
    found = np.concatenate(
        [
            rows.whole.samples_of(part)[~standstill(part, still).all(axis=1)]
            for part, _ in KeptWindows(rows, tuple(ends)).recordings()
        ]
    )
    return replace(rows, first=int(found[0]), last=int(found[-1]) + 1)
