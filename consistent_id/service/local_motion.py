"""Motion and torque of a running log, smoothed by local polynomials.

A sample's values come from the samples up to `HALF` before and after it, so a running
log is that many samples late.  Stamps may be uneven.  Motion and torque pass the same
window: what one of them loses, the other loses nearly alike.
"""

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Matrix
from consistent_id.errors import ProblemError
from consistent_id.recordings.recording import Recording

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
