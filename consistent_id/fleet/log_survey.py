"""The clock of a large log: the stretches between its gaps.

One pass over the times finds them before anything else is read.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.problems.file import PreparationTable
from consistent_id.recordings.readers.recording_file import RowSource
from consistent_id.recordings.signals.clocks import (
    jitter,
    largest_gap,
    require_rate,
    samples_at,
)

_MARK = 4096  # rows between two whose times are kept


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch between two gaps of a log, and the clock of its preparation.

    Parameters
    ----------
    name : str
        In messages.
    first, rows : int
        Its rows in the log.
    begin, end : float, [s]
        Times of the first and the last row.
    rate : float, [Hz]
        Rate of the clock on which it is prepared.
    samples : int
        Number of samples of that clock.
    marks : ndarray, shape (any, 2), optional
        Row and time [s] of some rows, of a stretch that is resampled.
    """

    name: str
    first: int
    rows: int
    begin: float
    end: float
    rate: float
    samples: int
    marks: Matrix | None = None

    def clock(self, first: int, last: int) -> Vector:
        """Return the times of samples ``first <= sample < last`` [s]."""
        clock = self.begin + np.arange(first, last) / self.rate
        return np.asarray(np.minimum(clock, self.end))

    def rows_around(self, first: int, last: int, margin: int) -> tuple[int, int]:
        """Return the log's rows of these samples, with some before and after."""
        if self.marks is not None:
            clock, times = self.clock(first, last), self.marks[:, 1]
            before = max(int(np.searchsorted(times, clock[0], "right")) - 1, 0)
            after = int(np.searchsorted(times, clock[-1]))
            first = int(self.marks[before, 0]) - self.first
            last = self.rows
            if after < len(times):
                last = int(self.marks[after, 0]) - self.first + 1
            first, last = first - margin, last + margin
        return self.first + max(first, 0), self.first + min(last, self.rows)

    def rows_between(self, first: int, last: int) -> int:
        """Return the number of its rows from one row of the log to another."""
        return min(last + 1, self.first + self.rows) - max(first, self.first)

    def sample_at(self, row: int, time: float, *, after: bool) -> int:
        """Return the first sample that is not before a row; or the first after it.

        Parameters
        ----------
        row : int
            Row of the log.
        time : float, [s]
            Time of that row.
        after : bool
        """
        if self.marks is None:
            found = row - self.first + after
        else:
            near = int(max(time - self.begin, 0.0) * self.rate)
            near = min(max(near - 2, 0), self.samples)
            few = self.clock(near, min(near + 5, self.samples))
            found = near + int(np.searchsorted(few, time, "right" if after else "left"))
        return min(max(found, 0), self.samples)


@dataclass(frozen=True, eq=False)
class ClockSurvey:
    """The stretches of a log, and times of requested rows.

    Parameters
    ----------
    stretches : tuple of Stretch
    rows : int
        Number of rows of the log.
    times : dict of int to float, [s]
        By row.
    """

    stretches: tuple[Stretch, ...]
    rows: int
    times: dict[int, float]


def survey(
    log: RowSource, table: PreparationTable, wanted: tuple[int, ...] = ()
) -> ClockSurvey:
    """Read the times of a log once, cut it at gaps, and find the clock of each part.

    Parameters
    ----------
    log : LogRows
    table : PreparationTable
    wanted : tuple of int
        Rows whose times are to be known.

    Raises
    ------
    RecordingError
        If a time is not finite, time does not increase, or a clock does not fit what
        the table states.
    """
    name = log.path.name
    cut = np.inf if table.max_gap is None else table.max_gap
    found: list[_Seen] = []
    times: dict[int, float] = {}
    row, last = 0, None
    for batch in log.times():
        known = batch if last is None else np.append(last, batch)
        _check(name, known, row - (last is not None))
        times |= {w: float(batch[w - row]) for w in wanted if 0 <= w - row < len(batch)}
        gaps = np.flatnonzero(np.diff(known) > cut) + 1
        for first, stop in pairwise([0, *gaps.tolist(), len(known)]):
            new = last is None or first > 0
            if new:
                found.append(_Seen(row + first - (last is not None), known[first]))
            found[-1].see(known[first:stop], row + first - (last is not None), new)
        row, last = row + len(batch), batch[-1]
    if row < 2:
        raise RecordingError(f"{name}: {row} samples, expected 2 or more")
    parts = _long_enough(found, table, name)
    stretches = tuple(_stretch(part, table, label) for label, part in parts)
    return ClockSurvey(stretches, row, times)


class _Seen:
    """The rows of a stretch that were read so far."""

    def __init__(self, first: int, begin: float) -> None:
        self.first, self.begin = first, float(begin)
        self.rows, self.end, self.latest = 0, float(begin), abs(float(begin))
        self.shortest, self.longest = np.inf, 0.0
        self.medians: list[float] = []
        self.marks: list[tuple[int, float]] = []

    def see(self, times: Vector, row: int, new: bool) -> None:
        """Take in times, the first of which is known already unless it is new."""
        steps = np.diff(times)
        if len(steps):
            self.shortest = min(self.shortest, float(steps.min()))
            self.longest = max(self.longest, float(steps.max()))
            self.medians.append(float(np.median(steps)))
        self.rows += len(times) - (not new)
        self.end = float(times[-1])
        self.latest = max(self.latest, abs(self.end))
        places = np.arange(-row % _MARK, len(times), _MARK)
        self.marks += [(row + int(i), float(times[i])) for i in places]

    @property
    def mean_step(self) -> float:
        return (self.end - self.begin) / (self.rows - 1)


def _check(name: str, times: Vector, row: int) -> None:
    if not np.isfinite(times).all():
        bad = int(np.argmin(np.isfinite(times)))
        raise RecordingError(f"{name}: time of sample {row + bad} is {times[bad]}")
    steps = np.diff(times)
    if (steps <= 0.0).any():
        bad = int(np.argmax(steps <= 0.0))
        raise RecordingError(
            f"{name}: time goes from {times[bad]:.9g} s (sample {row + bad}) to "
            f"{times[bad + 1]:.9g} s; it must increase. Sort the samples, and drop "
            "repeated ones"
        )


def _long_enough(
    found: list[_Seen], table: PreparationTable, name: str
) -> list[tuple[str, _Seen]]:
    """Return the parts that are kept, and what messages call them."""
    if table.max_gap is None:
        return [(name, found[0])]
    shortest = 1.0 if table.shortest_part is None else table.shortest_part
    kept = [s for s in found if s.rows >= 2 and s.end - s.begin >= shortest]
    if not kept:
        raise RecordingError(
            f"{name}: none of {len(found)} parts has two samples and lasts "
            f"{shortest:g} s"
        )
    return [(f"{name} (part {k})", part) for k, part in enumerate(kept, 1)]


def _stretch(seen: _Seen, table: PreparationTable, name: str) -> Stretch:
    """Return a stretch with its clock: that of the table, or its own if uniform."""
    mean = seen.mean_step
    ends = seen.begin, seen.end
    own = Stretch(name, seen.first, seen.rows, *ends, 1.0 / mean, seen.rows)
    if table.resample is None:
        off = max(seen.longest - mean, mean - seen.shortest)
        if off > jitter(mean, seen.latest):
            raise RecordingError(
                f"{name}: steps from {seen.shortest:.6g} s to {seen.longest:.6g} s, "
                f"their mean {mean:.6g} s; the clock is not uniform. Give its rate as "
                "resample in [data.preparation]"
            )
        return own
    own_rate = max(1.0 / mean, 1.0 / float(np.median(seen.medians)))
    require_rate(name, table.resample, 1.0 / mean, own_rate)
    limit = largest_gap(1.0 / mean, table.max_gap)
    if seen.longest > limit:
        raise RecordingError(
            f"{name}: a gap of {seen.longest:.4g} s, longer than {limit:.4g} s. Cut "
            "the log there with max_gap"
        )
    return replace(
        own,
        rate=table.resample,
        samples=samples_at(table.resample, seen.end - seen.begin),
        marks=np.array([(seen.first, seen.begin), *seen.marks]),
    )
