"""A large log in windows: its clock, prepared stretches, and the used rows.

One pass over the times finds the stretches between gaps before anything else is read.
The response of filters, splines and differences decays: samples at a distance of
`reach` change a sample by less than its last digit.  So a window is prepared with this
number of additional samples at both ends, which are then dropped.  Used rows are those
of the file in motion, and fast enough; top speeds are those of the whole stretch, so
they need a separate pass.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from consistent_id._support.arrays import BoolArray, IntArray, Matrix, Vector
from consistent_id._support.executors import Executor
from consistent_id.errors import RecordingError
from consistent_id.problems.file import PreparationTable
from consistent_id.problems.preparation import filtered, moving
from consistent_id.recordings.readers.recording_file import RowSource
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import (
    jitter,
    largest_gap,
    onto_clock,
    require_rate,
    samples_at,
)
from consistent_id.recordings.signals.filtered_rows import (
    RowFilter,
    left_out,
    places_of_rows,
    row_filter,
)
from consistent_id.recordings.signals.filters import (
    DECIMATION_ORDER,
    anti_aliased,
    decimation_cutoff,
    settling,
)
from consistent_id.recordings.signals.masks import (
    STILL,
    speed_reach,
    speed_share,
    standstill,
)

_MARK = 4096  # rows between two whose times are kept

WINDOW = 2**15  # samples; twenty channels of them and their copies take some 50 MB
# Samples for the decay of a spline's response: at least a factor of two each
SPLINE = 64
_DIFFERENCES = 4  # samples that central differences and their ends look at

_AT_ONCE = 32  # windows that one worker takes: a million samples

Cuts = tuple[tuple[int, int], ...]


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


@dataclass(frozen=True, eq=False)
class PreparedStretch:
    """A stretch of a log, and how it is prepared.

    Parameters
    ----------
    log : LogRows
    stretch : Stretch
    table : PreparationTable
        Preparation, whose steps up to the standstill are done here.
    lead : int
        Samples that delays take from the beginning.
    """

    log: RowSource
    stretch: Stretch
    table: PreparationTable
    lead: int = 0

    @cached_property
    def reach(self) -> int:
        """Samples on either side that a window is prepared with."""
        table, rate = self.table, self.stretch.rate
        reach = SPLINE + _DIFFERENCES
        for delay in table.delays.values():
            reach += SPLINE + int(np.ceil(abs(float(delay)) * rate))
        if table.motion_cutoff is not None:
            reach += settling(cutoff=table.motion_cutoff, rate=rate, order=4)
        if table.window is not None:
            reach += int(np.ceil(table.window * rate))
        if table.least_speed is not None:
            reach += speed_reach(1.0 / rate)
        filters = []
        if table.torque_cutoff is not None:
            filters.append(RowFilter(table.torque_cutoff / rate))
        if table.decimate > 1:
            cutoff = decimation_cutoff(rate, table.decimate)
            filters.append(RowFilter(cutoff / rate, DECIMATION_ORDER))
        return reach + max((own.reach for own in filters), default=0)

    def cuts(self, first: int, last: int) -> list[tuple[int, int]]:
        """Return consecutive windows of samples; each makes two rows or more."""
        size = max(WINDOW, 4 * self.reach, 4 * self.table.decimate)
        number = max(round((last - first) / size), 1)
        ends = np.linspace(first, last, number + 1).astype(int).tolist()
        return list(pairwise(ends))

    def windows(self, cuts: Iterable[tuple[int, int]]) -> Iterator[Recording]:
        """Yield what is prepared of ascending windows ``first <= sample < last``.

        With `reach` samples more on either side, where there are any.
        """
        cuts = list(cuts)
        wide = [
            (max(first - self.reach, 0), min(last + self.reach, self.stretch.samples))
            for first, last in cuts
        ]
        rows = (self.stretch.rows_around(*window, SPLINE) for window in wide)
        for window, raw in zip(wide, self.log.windows(rows), strict=True):
            yield self._prepared(self.on_clock(raw, window))

    def on_clock(self, raw: Recording, window: tuple[int, int]) -> Recording:
        """Return a window's rows on the clock of the stretch."""
        clock = self.stretch.clock(*window)
        if self.stretch.marks is None:
            return replace(raw, time=clock, name=self.stretch.name)
        return onto_clock(replace(raw, name=self.stretch.name), clock)

    def samples_of(self, part: Recording) -> IntArray:
        """Return the numbers of a part's samples on the clock."""
        places = (part.time - self.stretch.begin) * self.stretch.rate
        return np.asarray(np.rint(places), dtype=np.intp)

    def _prepared(self, part: Recording) -> Recording:
        part = moving(filtered(part, self.table), self.table)
        factor = self.table.decimate
        part = part if factor == 1 else anti_aliased(part, factor)
        behind = part.torque_filter
        if behind is None:
            return part
        first = int(self.samples_of(part)[0]) - self.lead
        return replace(part, torque_filter=replace(behind, first=first))


def prepared_stretches(
    log: RowSource, stretches: Iterable[Stretch], table: PreparationTable
) -> tuple[PreparedStretch, ...]:
    """Return stretches ready to be prepared window by window."""
    return tuple(
        replace(whole, lead=_lead(whole))
        for stretch in stretches
        for whole in [PreparedStretch(log, stretch, table)]
    )


def _lead(whole: PreparedStretch) -> int:
    """Return the samples that delays take from the beginning of a stretch."""
    if not whole.table.delays:
        return 0
    few = min(8 * whole.reach, whole.stretch.samples)
    rows = whole.stretch.rows_around(0, few, SPLINE)
    raw = next(whole.log.windows([rows]))
    part = filtered(whole.on_clock(raw, (0, few)), whole.table)
    return int(whole.samples_of(part)[0])


@dataclass(frozen=True, eq=False)
class KeptRows:
    """The used samples of a stretch.

    Parameters
    ----------
    first, last : int
        Samples ``first <= sample < last``.
    top : ndarray, shape (joints,), optional, [rad/s or m/s]
        Top speed of each joint in them, if slow samples are to be left out.
    asked : tuple of (int, int), optional
        Samples that the problem asks for, before standstill was cut off.
    """

    whole: PreparedStretch
    first: int
    last: int
    top: Vector | None = None
    asked: tuple[int, int] | None = None

    @property
    def cuts(self) -> list[tuple[int, int]]:
        """Consecutive windows."""
        return self.whole.cuts(self.first, self.last)

    def counted(self, part: Recording, own: IntArray) -> BoolArray:
        """Return whether each sample of a prepared window counts.

        Parameters
        ----------
        part : Recording
        own : ndarray of int
            The samples of the clock that it has.
        """
        counts = np.ones(len(part), dtype=np.bool_)
        if self.asked is not None:  # what lies outside stays in the filter
            before, after = self.asked
            counts &= (own < before) | (own >= self.first)
            counts &= (own < self.last) | (own >= after)
        least = self.whole.table.least_speed
        if self.top is not None and least is not None:
            here = np.flatnonzero((own >= self.first) & (own < self.last))
            if len(here) > 1:
                share = speed_share(part.samples(here), top=self.top)
                counts[here] &= share >= least
        return counts

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

    def every_sample(self) -> Iterator[Recording]:
        """Yield what is prepared of each window, whether it counts or not."""
        whole = self.rows.whole
        for (first, last), part in zip(
            self.cuts, whole.windows(self.cuts), strict=True
        ):
            own = whole.samples_of(part)
            yield part.samples(np.flatnonzero((own >= first) & (own < last)))

    def recordings(self) -> Iterator[Recording | None]:
        """Yield what counts of each prepared window; None where nothing does."""
        rows, whole = self.rows, self.rows.whole
        for (first, last), part in zip(
            self.cuts, whole.windows(self.cuts), strict=True
        ):
            own = whole.samples_of(part)
            counts = rows.counted(part, own)
            inside = (own >= first) & (own < last)
            step = whole.table.decimate
            thin = (own - whole.lead) % step == 0
            kept = np.flatnonzero(inside & counts & thin)
            if len(kept) < 2:
                yield None
                continue
            few = left_out(part, ~counts).samples(kept)
            behind = few.torque_filter
            if behind is None:
                yield few
                continue
            behind = replace(behind, thinned=step)  # few samples may be further apart
            rows_there = len(places_of_rows(behind, row_filter(few).step)) > 0
            yield replace(few, torque_filter=behind) if rows_there else None


def kept_rows(
    whole: PreparedStretch, first: int, last: int, executor: Executor
) -> KeptRows:
    """Return the samples that count among ``first <= sample < last``.

    Raises
    ------
    RecordingError
        If no joint ever moves in them.
    """
    rows, table = KeptRows(whole, first, last, asked=(first, last)), whole.table
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
    speeds = (part.velocity for part in task.every_sample())
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
            for part in KeptWindows(rows, tuple(ends)).every_sample()
        ]
    )
    return replace(rows, first=int(found[0]), last=int(found[-1]) + 1)
