"""A large log in windows: prepared stretches, the used rows, and rows in turn.

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

from consistent_id._support.arrays import Array, BoolArray, IntArray, Matrix, Vector
from consistent_id._support.executors import Executor
from consistent_id.errors import RecordingError
from consistent_id.fleet.log_survey import Stretch
from consistent_id.problems.file import PreparationTable
from consistent_id.problems.preparation import filtered, moving
from consistent_id.recordings.readers.recording_file import RowSource
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import (
    onto_clock,
)
from consistent_id.recordings.signals.end_velocities import with_end_velocities
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
from consistent_id.regression.correlated_noise import SHOWN
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.motion_arrays import Motion, whole_counts
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regressor import TorqueModel

WINDOW = 2**15  # samples; twenty channels of them and their copies take some 50 MB
# Samples for the decay of a spline's response: at least a factor of two each
SPLINE = 64
_DIFFERENCES = 4  # samples that central differences and their ends look at

_AT_ONCE = 32  # windows that one worker takes: a million samples

Cuts = tuple[tuple[int, int], ...]


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
        if window[0] == 0 or window[1] == self.stretch.samples:
            raw = with_end_velocities(raw)
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


def middle_rows(
    model: TorqueModel, rows: KeptRows, counts: Sequence[int]
) -> "RowsInTurn":
    """Return the rows in the middle, by which correlated noise is known.

    Parameters
    ----------
    counts : sequence of int
        Rows of each window.
    """
    ends = np.cumsum(counts)
    shown = min(int(ends[-1]), SHOWN)
    start = (int(ends[-1]) - shown) // 2
    first = int(np.searchsorted(ends, start, side="right"))
    last = int(np.searchsorted(ends, start + shown))
    windows = KeptWindows(rows, tuple(rows.cuts[first : last + 1]))
    parts = (part for part in windows.recordings() if part is not None)
    motions = tuple(motion_of(model, part, None) for part in parts)
    start -= int(ends[first]) - counts[first]
    return RowsInTurn(motions).samples(start, start + shown)


@dataclass(frozen=True, eq=False)
class RowsInTurn:
    """Rows of consecutive windows as those of one recording.

    Parameters
    ----------
    motions : tuple of Motion
    """

    motions: tuple[Motion, ...]

    @property
    def q(self) -> Matrix:
        """Positions, shape (rows, joints)."""
        return np.concatenate([motion.q for motion in self.motions])

    @property
    def dq(self) -> Matrix:
        """Velocities, shape (rows, joints)."""
        return np.concatenate([motion.dq for motion in self.motions])

    @property
    def mixed(self) -> bool:
        """See `Motion.mixed`."""
        return any(motion.mixed for motion in self.motions)

    def samples(self, start: int, stop: int) -> "RowsInTurn":
        """Return consecutive rows."""
        parts, first = [], 0
        for motion in self.motions:
            low, high = max(start - first, 0), min(stop - first, len(motion.q))
            if low < high:
                parts.append(motion.samples(low, high))
            first += len(motion.q)
        return RowsInTurn(tuple(parts))

    def counts(self) -> IntArray:
        """See `Motion.counts`."""
        return whole_counts(np.sum([m.stood_for() for m in self.motions], axis=0))

    def noise_lost(self) -> Vector:
        """See `Motion.noise_lost`; windows are of robots on a fixed base."""
        return self.motions[0].noise_lost()

    def rows(
        self, model: TorqueModel, kept: Sequence[IntArray]
    ) -> Iterator[tuple[slice, Sequence[Matrix]]]:
        """See `Motion.rows`."""
        first = 0
        for motion in self.motions:
            for part, blocks in motion.rows(model, kept):
                yield slice(first + part.start, first + part.stop), blocks
            first += len(motion.q)

    def shifted(self, row: int) -> Array | None:
        """See `Motion.shifted`."""
        parts = [motion.shifted(row) for motion in self.motions]
        if all(part is None for part in parts):
            return None
        pairs = zip(parts, self.motions, strict=True)
        return np.concatenate(
            [np.zeros(len(m.q)) if part is None else part for part, m in pairs]
        )

    def drive_columns(self, terms: DriveTerms, joint: int, row: int) -> Matrix:
        """See `Motion.drive_columns`."""
        return np.vstack([m.drive_columns(terms, joint, row) for m in self.motions])
