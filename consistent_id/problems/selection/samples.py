"""Rows of the training data: motion, torque, and the block of each row.

Cross-validation leaves out blocks of equal motion in turn.  If the motion is periodic,
a block is a phase of it, else a stretch of time; so the fitted rows contain no copy of
the rows left out.  The same part of every recording is left out at once, because two
recordings may have the same motion.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache

import msgspec
import numpy as np

from consistent_id._support.arrays import Array, BoolArray, IntArray, Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.problems.file import PreparationTable
from consistent_id.problems.preparation import prepared
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import estimated_period
from consistent_id.recordings.signals.filtered_rows import (
    RowFilter,
    require_filter,
    row_filter,
)
from consistent_id.recordings.signals.masks import speed_share
from consistent_id.recordings.signals.repetitions import whole_periods
from consistent_id.regression.motion_arrays import FilteredRows, Motion
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regressor import TorqueModel

NUMBERS = (8, 6)
"""Numbers of blocks over which errors are averaged.  Between single numbers of blocks,
a robot's error differed by up to 30 %.
"""

_SHORTEST_PERIOD = (
    0.02  # of the motion: with shorter periods, blocks need not be whole periods
)
_WHOLE_PERIODS = 2  # least number of periods of a motion that is left out by phase

EDGES = tuple(
    float(edge)
    for edge in sorted({Fraction(k, n) for n in NUMBERS for k in range(n + 1)})
)
"""Edges of all blocks, as shares of a motion; cells are the stretches between them."""


@dataclass(frozen=True, slots=True, eq=False)
class SampledLog:
    """A training log as it was recorded.

    Parameters
    ----------
    raw : Recording
        The rows for training only.
    period : float, optional, [s]
        Period of a periodic motion.
    """

    raw: Recording
    period: float | None


@dataclass(frozen=True, slots=True, eq=False)
class SampledPart:
    """Rows of one part of a log, filtered to the band in which torque is predicted.

    Parameters
    ----------
    motion : Motion
        The rows; `Motion.along` has all samples before the filter.
    time : ndarray, shape (samples along,), [s]
    torque : ndarray, shape (samples along, torque joints), [N m or N]
        Torque before the filter.
    load : ndarray, shape (samples along, torque joints), optional, [N m or N]
        Torque of the nominal bodies.
    speed : ndarray, shape (samples along,)
        Share of top speed; see `speed_share`.
    cell : ndarray of int, shape (rows,)
        See `cells`.
    """

    motion: Motion
    time: Vector
    torque: Matrix
    load: Matrix | None
    speed: Vector
    cell: IntArray

    @property
    def rows(self) -> FilteredRows:
        """The filtered rows."""
        if self.motion.filtered is None:
            raise RecordingError("the rows of a selection are filtered")
        return self.motion.filtered

    def masked(self, least_speed: float) -> "SampledPart":
        """Return the rows that are fast enough; slow samples are zero in the filter."""
        rows = self.rows
        fast = self.speed >= least_speed
        known = rows.along.weights
        weights = np.ones_like(self.torque) if known is None else known
        along = rows.along._replace(weights=weights * fast[:, None])
        kept = fast[rows.kept]
        motion = _rows_of(along, rows.by, rows.kept[kept])
        return replace(self, motion=motion, cell=self.cell[kept])

    def late(self, seconds: float) -> tuple[Matrix, Matrix]:
        """Return torque that was logged with another delay, and its rate of change."""
        torque = self.torque
        if seconds:
            late = self.time + seconds
            torque = np.column_stack([np.interp(late, self.time, v) for v in torque.T])
        rate = np.gradient(torque, self.time, axis=0)
        return self.motion.through(torque), self.motion.through(rate)


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Prepared rows of all training logs.

    Parameters
    ----------
    parts : tuple of SampledPart
    torque, torque_rate : ndarray, shape (rows, torque joints)
    inertial : ndarray, shape (torque joints, 10 links, rows)
        Regressor of the bodies.
    """

    parts: tuple[SampledPart, ...]
    torque: Matrix
    torque_rate: Matrix
    inertial: Array

    @staticmethod
    def of(bodies: TorqueModel, parts: Sequence[SampledPart]) -> "Samples":
        """Return the rows of parts."""
        inertial = [part.motion.regressor(bodies) for part in parts]
        torque, rate = _joined_late(parts, 0.0)
        return Samples(tuple(parts), torque, rate, np.concatenate(inertial, axis=2))

    @property
    def cell(self) -> IntArray:
        """The cell of each row, shape (rows,); see `cells`."""
        return np.concatenate([part.cell for part in self.parts])

    @property
    def speed(self) -> Vector:
        """Share of top speed at each row, shape (rows,)."""
        return np.concatenate([part.speed[part.rows.kept] for part in self.parts])

    @property
    def dq(self) -> Matrix:
        """Velocities at each row, shape (rows, joints), [rad/s or m/s]."""
        return np.concatenate([part.motion.dq for part in self.parts])

    @property
    def top_speeds(self) -> Vector:
        """Top speed of each joint, shape (joints,), [rad/s or m/s]."""
        return np.asarray(abs(self.dq).max(axis=0))

    def masked(self, bodies: TorqueModel, least_speed: float) -> "Samples":
        """Return the rows that are fast enough; slow samples are zero in the filter."""
        return Samples.of(bodies, [part.masked(least_speed) for part in self.parts])

    def delayed(self, seconds: float) -> "Samples":
        """Return the rows with torque that was logged with another delay."""
        if seconds == 0.0:
            return self
        torque, rate = _joined_late(self.parts, seconds)
        return replace(self, torque=torque, torque_rate=rate)

    def filtered(
        self, row: int, columns: Callable[[SampledPart], Sequence[Vector]]
    ) -> Matrix:
        """Return columns of a joint's rows, filtered like the torque.

        Parameters
        ----------
        row : int
            Place among the torque joints.
        columns : callable
            Returns columns along all samples of a part, before the filter.

        Returns
        -------
        ndarray, shape (rows, columns)
        """
        parts = []
        for part in self.parts:
            full = np.empty((len(part.time), len(found := columns(part))))
            for k, column in enumerate(found):
                full[:, k] = column
            parts.append(part.motion.through(full, row))
        return np.concatenate(parts)


def _joined_late(parts: Sequence[SampledPart], seconds: float) -> tuple[Matrix, Matrix]:
    both = zip(*(part.late(seconds) for part in parts), strict=True)
    torque, rate = map(np.concatenate, both)
    return torque, rate


def _rows_of(along: Motion, by: RowFilter, kept: IntArray) -> Motion:
    """Return filtered rows of a motion."""
    rows = FilteredRows(along, by, kept)
    return Motion(
        along.q[kept],
        along.dq[kept],
        along.ddq[kept],
        rows.through(along.torque),
        None,
        filtered=rows,
    )


def samples_of(
    bodies: TorqueModel,
    logs: Sequence[SampledLog],
    table: PreparationTable,
    *,
    guard: float,
    thin: int,
) -> Samples:
    """Prepare logs, and compute the regressor of the bodies.

    Parameters
    ----------
    bodies : TorqueModel
        The model without drive terms.
    table : PreparationTable
        Its `torque_cutoff` is the band in which torque is predicted.
    guard : float, [s]
        See `cells`.
    thin : int
        Step between samples that are kept.

    Raises
    ------
    RecordingError
        If a log cannot be prepared.
    """
    table = msgspec.structs.replace(table, least_speed=None, decimate=1)
    parts = []
    for log in logs:
        start, duration = float(log.raw.time[0]), log.raw.duration
        for part in prepared(log.raw, table):
            time = part.time
            place = cells(time, start, duration, log.period, guard)
            inside = (time >= time[0] + guard) & (time <= time[-1] - guard)
            kept = np.flatnonzero(inside & (place >= 0))[::thin]
            parts.append(_sampled(bodies, part, kept, place[kept]))
    return Samples.of(bodies, parts)


def _sampled(
    bodies: TorqueModel, part: Recording, kept: IntArray, cell: IntArray
) -> SampledPart:
    """Return the rows of a prepared part at some samples."""
    behind, by = require_filter(part), row_filter(part)
    along = motion_of(bodies, part, None).along
    state, nominal = (along.q, along.dq, along.ddq), bodies.robot.nominal
    speed = np.ones(len(behind.source))
    speed[behind.kept] = speed_share(part)
    return SampledPart(
        motion=_rows_of(along, by, behind.kept[kept]),
        time=behind.source.time,
        torque=along.torque,
        load=None if nominal is None else bodies.rigid_torque(nominal, state),
        speed=speed,
        cell=cell,
    )


@lru_cache(maxsize=1)
def folds() -> tuple[tuple[int, tuple[int, ...]], ...]:
    """Return the blocks: the number of blocks that each belongs to, and its cells.

    Examples
    --------
    >>> folds()[0]
    (8, (0,))
    >>> len(folds()), folds()[8]
    (14, (6, (0, 1)))
    """
    middles = (np.array(EDGES[1:]) + np.array(EDGES[:-1])) / 2
    found = []
    for n in NUMBERS:
        for k in range(n):
            inside = np.flatnonzero((middles > k / n) & (middles < (k + 1) / n))
            found.append((n, tuple(inside.tolist())))
    return tuple(found)


@lru_cache(maxsize=1)
def left_out() -> BoolArray:
    """Return the cells that each block consists of, shape (blocks, cells)."""
    cells = np.arange(len(EDGES) - 1)
    return np.array([np.isin(cells, out) for _, out in folds()])


def motion_period(raw: Recording) -> float | None:
    """Return the period [s] of a periodic motion, else None."""
    try:
        period = estimated_period(raw, shortest=_SHORTEST_PERIOD * raw.duration)
    except RecordingError:
        return None
    step = raw.duration / (len(raw) - 1)
    whole = whole_periods(raw.duration, period, step)
    return period if whole >= _WHOLE_PERIODS else None


def cells(
    time: Vector, start: float, duration: float, period: float | None, guard: float
) -> IntArray:
    """Return the cell of each sample; -1 for those near an edge.

    Parameters
    ----------
    time : ndarray, [s]
    start, duration : float, [s]
        Beginning and duration of the recording.
    period : float, optional, [s]
        Period of a periodic motion.
    guard : float, [s]
        Samples nearer to an edge than this belong to no cell: filters and the
        correlation of noise mix them with samples beyond the edge.
    """
    length = duration if period is None else period
    share = np.clip((time - start) / length, 0.0, None)
    share = np.minimum(share, 1.0 - 1e-12) if period is None else share % 1.0
    edges = np.array(EDGES)
    place = np.clip(np.searchsorted(edges, share, "right") - 1, 0, len(edges) - 2)
    nearest = np.minimum(share - edges[place], edges[place + 1] - share)
    return np.where(nearest * length < guard, -1, place)


def velocity_scales(speeds: Vector) -> tuple[float, ...]:
    """Return widths of friction's change of sign to try, from top speeds of joints."""
    top = float(np.median(speeds))
    series = [m * 10.0**e for e in range(-6, 4) for m in (1.0, 2.0, 5.0)]
    return tuple(float(f"{s:.1g}") for s in series if 0.004 <= s / top <= 0.3)
