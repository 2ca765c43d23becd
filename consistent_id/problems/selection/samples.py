"""Rows of the training data: motion, torque, and the block each row belongs to."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector
from consistent_id.problems.file import PreparationTable
from consistent_id.problems.preparation import prepared
from consistent_id.problems.selection.blocks import cells
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.masks import speed_share
from consistent_id.regression.motion_arrays import motion_of
from consistent_id.regression.regressor import TorqueModel


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """A training log as it was recorded.

    Parameters
    ----------
    raw : Recording
        The rows for training, and no others.
    period : float, optional, [s]
        Of a motion that repeats itself.
    """

    raw: Recording
    period: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Prepared rows of all training logs.

    Parameters
    ----------
    q, dq, ddq : ndarray, shape (samples, joints)
    torque : ndarray, shape (samples, torque joints)
    cell : ndarray, shape (samples,)
        See `blocks.cells`.
    speed : ndarray, shape (samples,)
        Share of top speed; see `speed_share`.
    inertial : ndarray, shape (torque joints, 10 links, samples)
        Regressor of the bodies.
    late : tuple of Late
        The torque before it was thinned, of each part.
    """

    q: Matrix
    dq: Matrix
    ddq: Matrix
    torque: Matrix
    cell: IntArray
    speed: Vector
    inertial: Array
    late: tuple["Late", ...]

    def delayed(self, seconds: float) -> "Samples":
        """Return the rows with the torque that was written so much later."""
        if seconds == 0.0:
            return self
        torque = np.concatenate([part.at(seconds) for part in self.late])
        return replace(self, torque=torque)

    @property
    def torque_rate(self) -> Matrix:
        """Derivative of the torque, shape (samples, torque joints)."""
        return np.concatenate([part.rate for part in self.late])


@dataclass(frozen=True, slots=True, eq=False)
class Late:
    """A part's torque with its clock, and which of its samples are kept."""

    time: Vector
    torque: Matrix
    kept: IntArray

    def at(self, delay: float) -> Matrix:
        """Return the torque so many seconds later."""
        late = self.time[self.kept] + delay
        return np.column_stack([np.interp(late, self.time, t) for t in self.torque.T])

    @property
    def rate(self) -> Matrix:
        """Return the torque's derivative in time."""
        return np.asarray(np.gradient(self.torque, self.time, axis=0)[self.kept])


def samples_of(
    bodies: TorqueModel,
    logs: Sequence[Log],
    table: PreparationTable,
    *,
    guard: float,
    thin: int,
) -> Samples:
    """Prepare logs, and compute the regressor of the bodies.

    Parameters
    ----------
    bodies : TorqueModel
        Without drive terms.
    logs : sequence of Log
    table : PreparationTable
    guard : float, [s]
        See `blocks.cells`.
    thin : int
        Of so many samples one is kept.

    Raises
    ------
    RecordingError
        If a log cannot be prepared.
    """
    table = msgspec.structs.replace(table, least_speed=None, decimate=1)
    parts, late = [], []
    for log in logs:
        start, duration = float(log.raw.time[0]), log.raw.duration
        for part in prepared(log.raw, table):
            time = part.time
            place = cells(time, start, duration, log.period, guard)
            inside = (time >= time[0] + guard) & (time <= time[-1] - guard)
            kept = np.flatnonzero(inside & (place >= 0))[::thin]
            motion = motion_of(bodies, part, None)
            state = (motion.q, motion.dq, motion.ddq, motion.torque)
            arrays = [*state, place, speed_share(part)]
            parts.append([array[kept] for array in arrays])
            late.append(Late(time, motion.torque, kept))
    q, dq, ddq, torque, cell, speed = (
        np.concatenate(arrays) for arrays in zip(*parts, strict=True)
    )
    inertial = bodies.regressor(q, dq, ddq)
    return Samples(q, dq, ddq, torque, cell, speed, inertial, tuple(late))
