"""A running log: its motion and torque, smoothed, and the rows that extend a factor.

Motion and torque are smoothed by local polynomials.  A sample's values come from the
samples up to `HALF` before and after it, so a running log is that many samples late.
Stamps may be uneven.  Motion and torque pass the same window: what one of them loses,
the other loses nearly alike.

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
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regressor import TorqueModel
from consistent_id.service.load_watch import PARTS, WatchedRows
from consistent_id.service.residual_spread import SLOW

HALF = 5
"""Samples on either side of a window, if nothing else is stated."""

_GAP = 5.0  # steps without a sample, after which a window does not reach back


def joined(tail: Recording | None, block: Recording) -> Recording:
    """Return the samples that wait for their successors, and those that follow.

    Samples before a gap are left out.

    Raises
    ------
    ProblemError
        If the block does not begin after them, or its torque was filtered.
    """
    require_unfiltered(block)
    if tail is None:
        return block
    step = float(np.median(np.diff(block.time)))
    if block.time[0] <= tail.time[-1]:
        raise ProblemError(
            f"{block.name} begins at {block.time[0]:.9g} s, expected after "
            f"{tail.time[-1]:.9g} s, the last sample before it"
        )
    if block.time[0] - tail.time[-1] > _GAP * step:
        return block
    return Recording(
        block.joints,
        np.concatenate([tail.time, block.time]),
        np.concatenate([tail.position, block.position]),
        velocity=_both(tail.velocity, block.velocity),
        torque=_both(tail.torque, block.torque),
        torque_known=_known_of_both(tail, block),
        name=block.name,
    )


def require_unfiltered(log: Recording) -> None:
    """Raise ProblemError if a log's torque was filtered with samples to come."""
    if log.torque_filter is not None:
        raise ProblemError(
            f"{log.name} has a torque that was filtered with samples to come; give "
            "the torque as it was measured"
        )


def _known_of_both(before: Recording, after: Recording) -> BoolArray | None:
    if before.torque_known is None and after.torque_known is None:
        return None
    known = [
        np.ones(log.position.shape, dtype=bool)
        if log.torque_known is None
        else log.torque_known
        for log in (before, after)
    ]
    return np.concatenate(known)


def _both(before: Matrix | None, values: Matrix | None) -> Matrix | None:
    if before is None or values is None:
        return None
    return np.concatenate([before, values])


def local_motion(
    log: Recording, half: int = HALF, torque_delay: float = 0.0
) -> Recording | None:
    """Return position, velocity, acceleration and torque of the samples in the middle.

    Each value is that of a polynomial of least squares over ``2 half + 1`` samples: of
    degree 2 for position, velocity and torque, of degree 3 for a position without a
    measured velocity.

    Parameters
    ----------
    log : Recording
        With torque; velocity is optional.
    half : int
    torque_delay : float, [s]
        By which the log's torque is late.

    Returns
    -------
    Recording or None
        Less `half` samples at both ends, and beside gaps; None if fewer than two are
        left.  A torque is known if it is in all samples of its window.

    Raises
    ------
    ProblemError
        If the torque is missing, or its delay is longer than half a window.
    """
    if log.torque is None:
        raise ProblemError(f"{log.name} has no torque")
    if len(log) < 2 * half + 2:
        return None
    middle = np.arange(half, len(log) - half)
    steps = np.diff(log.time)
    gaps = np.append(0, np.cumsum(steps > _GAP * np.median(steps)))
    middle = middle[gaps[middle - half] == gaps[middle + half]]
    if len(middle) < 2:
        return None
    places = middle[:, None] + np.arange(-half, half + 1)
    ages = log.time[places] - log.time[middle, None]
    # A polynomial beyond its samples would say nothing of the torque.
    if not abs(torque_delay) <= abs(ages).max():
        raise ProblemError(
            f"the torque's delay is {torque_delay} s, expected at most half a window, "
            f"{abs(ages).max():.3g} s; shift the torque, or state a larger `half`"
        )
    square = _polynomials(ages, 2)
    torque = _values(square, log.torque[places], torque_delay)
    if log.velocity is None:
        q, dq, ddq = _derivatives(_polynomials(ages, 3), log.position[places])
    else:
        q = _derivatives(square, log.position[places])[0]
        dq, ddq, _ = _derivatives(square, log.velocity[places])
    return Recording(
        log.joints,
        log.time[middle],
        q,
        velocity=dq,
        acceleration=ddq,
        torque=torque,
        torque_known=(
            None if log.torque_known is None else log.torque_known[places].all(axis=1)
        ),
        name=log.name,
    )


def _polynomials(ages: Matrix, degree: int) -> Array:
    """Return matrices from samples to coefficients: (windows, degree + 1, samples)."""
    scale = abs(ages).max()
    powers = (ages / scale)[..., None] ** np.arange(degree + 1)
    return np.asarray(np.linalg.pinv(powers) / scale ** np.arange(degree + 1)[:, None])


def _derivatives(fit: Array, values: Array) -> tuple[Matrix, Matrix, Matrix]:
    """Return value and two derivatives in the middle, each (windows, joints)."""
    found = fit[:, :3] @ values
    return found[:, 0], found[:, 1], 2.0 * found[:, 2]


def _values(fit: Array, values: Array, late: float) -> Matrix:
    """Return the polynomials' values `late` seconds after the middle."""
    powers = late ** np.arange(fit.shape[1])
    return np.asarray(np.einsum("p,kpj->kj", powers, fit @ values))


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
