"""Rows of a block of samples, and the triangular factor that they extend.

A sample's row fades with its age, and counts less near rest, where dry friction has any
value up to its level.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Matrix, Vector
from consistent_id.errors import ProblemError
from consistent_id.recordings.recording import Recording
from consistent_id.regression.linear import extended, triangle
from consistent_id.regression.motion_arrays import motion_of
from consistent_id.regression.regressor import TorqueModel
from consistent_id.service.load_watch import PARTS, WatchedRows
from consistent_id.service.local_motion import require_unfiltered
from consistent_id.service.residual_spread import SLOW


def blocks_of(log: Recording, length: float) -> Iterator[Recording]:
    """Yield consecutive blocks of a log, of two samples at least."""
    for part in parts_of(log.time, length):
        yield log.samples(part)


def parts_of(time: Vector, length: float) -> Iterator[slice]:
    """Yield consecutive parts of a clock, of two samples at least.

    Raises
    ------
    ProblemError
        If the length is not positive.
    """
    if not length > 0.0:
        raise ProblemError(f"blocks of {length} s, expected more than 0")
    number = np.floor((time - time[0]) / length + 1e-9)
    starts = np.flatnonzero(np.diff(number, prepend=-1.0))
    first = 0
    for end in [*starts[1:].tolist(), len(time)]:
        if end - first >= 2 and len(time) - end != 1:
            yield slice(first, end)
            first = end


@dataclass(frozen=True, slots=True, eq=False)
class FadedRows:
    """Rows of samples.

    Parameters
    ----------
    time : ndarray, shape (samples,), [s]
    regressor : ndarray, shape (samples, torque joints, parameters)
    torque : ndarray, shape (samples, torque joints), [N m or N]
    velocity : ndarray, shape (samples, torque joints), [rad/s or m/s]
    known : ndarray of bool, shape (samples, torque joints), optional
        Where the torque is that of the model; by default everywhere.
    """

    time: Vector
    regressor: Array
    torque: Matrix
    velocity: Matrix
    known: BoolArray | None

    @classmethod
    def of(cls, model: TorqueModel, log: Recording) -> "FadedRows":
        """Return the rows of a log.

        Raises
        ------
        ProblemError
            If the torque was filtered with samples to come.
        """
        require_unfiltered(log)
        motion = motion_of(model, log, None)
        Y = model.regressor(motion.q, motion.dq, motion.ddq)
        known = None if motion.weights is None else motion.weights != 0.0
        torque = motion.torque if known is None else motion.torque * known
        return cls(
            log.time,
            np.ascontiguousarray(np.moveaxis(Y, 2, 0)),
            torque,
            motion.dq[:, list(model.rows)],
            known,
        )

    def blocks(self, length: float) -> Iterator["FadedRows"]:
        """Yield consecutive blocks of a length [s]."""
        for part in parts_of(self.time, length):
            known = None if self.known is None else self.known[part]
            yield FadedRows(
                self.time[part],
                self.regressor[part],
                self.torque[part],
                self.velocity[part],
                known,
            )

    def less(self, x: Vector) -> Matrix:
        """Return the torque that parameters do not explain, [N m or N]."""
        rest = self.torque - self.regressor @ x
        return rest if self.known is None else rest * self.known

    def watched(self, link: int, residual: Matrix) -> WatchedRows:
        """Return the rows as the watch of a link needs them."""
        columns = self.regressor[:, :, 10 * link : 10 * link + PARTS]
        return WatchedRows(self.time, columns, residual, self.velocity)

    def faded(self, memory: float, sigma: Vector, held: Vector) -> Matrix:
        """Return the rows, divided by their noise, those before the last one faded.

        Near rest, dry friction is part of the noise: it has any value up to its level.
        """
        ages = self.time[-1] - self.time
        near = 1.0 - np.tanh(self.velocity / SLOW) ** 2
        noise = np.sqrt(sigma**2 + near * held**2)
        weight = np.exp(-0.5 * ages / memory)[:, None] / noise
        if self.known is not None:
            weight = weight * self.known
        both = np.concatenate([self.regressor, self.torque[:, :, None]], axis=2)
        weighted = both * weight[:, :, None]
        return np.asarray(weighted.reshape(-1, both.shape[2]))


def extended_by(factor: Matrix, rows: Matrix) -> Matrix:
    """Return the triangular factor of a triangular factor and more rows."""
    return extended(np.array(factor, order="F"), np.array(rows, order="F"))


def without_body(factor: Matrix, own: slice) -> Matrix:
    """Return a factor without information on a link's body, and otherwise unchanged.

    The least misfit over the body's parameters: rows that contain them, after they were
    eliminated first, are left out.
    """
    width = factor.shape[1]
    body = np.arange(width)[own]
    others = np.setdiff1d(np.arange(width), body)
    order = np.concatenate([body, others])
    R = triangle(np.array(factor[:, order], order="F"))
    left = np.zeros((width, width))
    left[: len(R) - len(body), others] = R[len(body) :, len(body) :]
    return triangle(np.asfortranarray(left))


def inverse_of(R: Matrix) -> Matrix:
    """Return the inverse of a regular upper triangular matrix."""
    from scipy.linalg.lapack import dtrtri

    return np.asarray(dtrtri(R)[0])
