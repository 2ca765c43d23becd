"""Windows of a stretch, each prepared with enough on either side to be as in memory.

Filters, splines and differences forget: what lies `reach` samples away changes a sample
by less than its last digit.  So a window is prepared with so many more at both ends,
which are then dropped.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from consistent_id._support.arrays import IntArray
from consistent_id.problems.file import PreparationTable
from consistent_id.problems.preparation import filtered, moving
from consistent_id.problems.streaming.stretches import Stretch
from consistent_id.recordings.readers.log_rows import RowSource
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.butterworth import settling
from consistent_id.recordings.signals.clocks import onto_clock
from consistent_id.recordings.signals.filters import (
    DECIMATION_ORDER,
    anti_aliased,
    decimation_cutoff,
)

WINDOW = 2**15  # samples; twenty channels of them and their copies take some 50 MB
SPLINE = 64  # samples after which a spline has forgotten: each leaves a half, or less
_DIFFERENCES = 4  # samples that central differences and their ends look at


@dataclass(frozen=True, eq=False)
class PreparedStretch:
    """A stretch of a log, and how it is prepared.

    Parameters
    ----------
    log : LogRows
    stretch : Stretch
    table : PreparationTable
        Of whose steps those to the standstill are done here.
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
        cutoffs = [c for c in (table.motion_cutoff, table.torque_cutoff) if c]
        if cutoffs:
            reach += settling(cutoff=min(cutoffs), rate=rate, order=4)
        if table.window is not None:
            reach += int(np.ceil(table.window * rate))
        if table.decimate > 1:
            cutoff = decimation_cutoff(rate, table.decimate)
            reach += settling(cutoff=cutoff, rate=rate, order=DECIMATION_ORDER)
        return reach

    def cuts(self, first: int, last: int) -> list[tuple[int, int]]:
        """Return consecutive windows of samples; each makes two rows or more."""
        size = max(WINDOW, 4 * self.reach, 4 * self.table.decimate)
        number = max(round((last - first) / size), 1)
        ends = np.linspace(first, last, number + 1).astype(int).tolist()
        return list(pairwise(ends))

    def windows(self, cuts: Iterable[tuple[int, int]]) -> Iterator[Recording]:
        """Yield what is prepared of ascending windows ``first <= sample < last``."""
        cuts = list(cuts)
        wide = [
            (max(first - self.reach, 0), min(last + self.reach, self.stretch.samples))
            for first, last in cuts
        ]
        rows = (self.stretch.rows_around(*window, SPLINE) for window in wide)
        for cut, window, raw in zip(cuts, wide, self.log.windows(rows), strict=True):
            yield self._kept(self._prepared(self.on_clock(raw, window)), cut)

    def on_clock(self, raw: Recording, window: tuple[int, int]) -> Recording:
        """Return a window's rows on the clock of the stretch."""
        clock = self.stretch.clock(*window)
        if self.stretch.marks is None:
            return replace(raw, time=clock, name=self.stretch.name)
        return onto_clock(replace(raw, name=self.stretch.name), clock)

    def samples_of(self, part: Recording) -> IntArray:
        """Return which samples of the clock those of a part are."""
        places = (part.time - self.stretch.begin) * self.stretch.rate
        return np.asarray(np.rint(places), dtype=np.intp)

    def _prepared(self, part: Recording) -> Recording:
        part = moving(filtered(part, self.table), self.table)
        factor = self.table.decimate
        return part if factor == 1 else anti_aliased(part, factor)

    def _kept(self, part: Recording, cut: tuple[int, int]) -> Recording:
        """Return the samples of the cut itself that are left after decimation."""
        own = self.samples_of(part)
        inside = (own >= cut[0]) & (own < cut[1])
        after_all = (own - self.lead) % self.table.decimate == 0
        return part.samples(np.flatnonzero(inside & after_all))


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
