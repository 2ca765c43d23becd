"""Rows of the training data: motion, torque, and the block each row belongs to."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

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
    torque, torque_rate : ndarray, shape (samples, torque joints)
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
    torque_rate: Matrix
    cell: IntArray
    speed: Vector
    inertial: Array
    late: tuple["Late", ...]

    def delayed(self, seconds: float) -> "Samples":
        """Return the rows with the torque that was written so much later."""
        if seconds == 0.0:
            return self
        torque, rate = (
            np.concatenate([part.at(seconds, of) for part in self.late])
            for of in ("torque", "rate")
        )
        return replace(self, torque=torque, torque_rate=rate)


@dataclass(frozen=True, slots=True, eq=False)
class Late:
    """A part's torque with its derivative and clock, and which samples are kept."""

    time: Vector
    torque: Matrix
    rate: Matrix
    kept: IntArray

    def at(self, delay: float, channel: Literal["torque", "rate"]) -> Matrix:
        """Return a channel so many seconds later."""
        late, values = self.time[self.kept] + delay, getattr(self, channel)
        return np.column_stack([np.interp(late, self.time, v) for v in values.T])


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
            rate = np.gradient(motion.torque, time, axis=0)
            arrays.append(rate)
            parts.append([array[kept] for array in arrays])
            late.append(Late(time, motion.torque, rate, kept))
    q, dq, ddq, torque, cell, speed, rate = (
        np.concatenate(arrays) for arrays in zip(*parts, strict=True)
    )
    inertial = bodies.regressor(q, dq, ddq)
    return Samples(q, dq, ddq, torque, rate, cell, speed, inertial, tuple(late))
