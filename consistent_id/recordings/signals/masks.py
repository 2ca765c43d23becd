"""Samples whose torque holds little information, or is wrong."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, BoolArray, Matrix, Vector, frozen
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording, velocities
from consistent_id.recordings.signals.resolution import held_samples, quantum

_AT_LIMIT = 1e-3  # of the limit, within which a torque is at it
STILL = 0.01  # of the fastest joint's largest speed
_RUN, _PILE = 3, 10.0  # consecutive readings at the extreme; their number over others'


def standstill(recording: Recording, velocity: float | None = None) -> BoolArray:
    """Return where each joint stands still, shape (samples, joints).

    Friction of a joint at rest is whatever balances it, so its torque there tells
    little of the model.

    Parameters
    ----------
    recording : Recording
        Without a velocity, differences of position stand for it: filter first.
    velocity : float, optional, [rad/s or m/s]
        Below which a joint stands still; by default a hundredth of the largest speed of
        all joints.
    """
    speed = velocities(recording)
    limit = STILL * abs(speed).max() if velocity is None else velocity
    if not limit >= 0.0:
        raise RecordingError(f"velocity is {velocity}, expected zero or more")
    return np.asarray((abs(speed) < limit) | (speed == 0.0))


SPEED_WINDOW = 0.25  # s, in which a joint that turns back is not at rest


def speed_share(
    recording: Recording, window: float = SPEED_WINDOW, *, top: Vector | None = None
) -> Vector:
    """Return how fast the robot moves, as a share of top speed, shape (samples,).

    Of the joint that is fastest compared to its own largest speed, the largest share
    within half a window on either side: a joint that turns back is not at rest.

    Parameters
    ----------
    recording : Recording
        With velocity.
    window : float, [s]
    top : ndarray, shape (joints,), optional, [rad/s or m/s]
        Top speed of each joint; by default the largest of the recording.
    """
    from scipy.ndimage import maximum_filter1d

    speed = recording.velocity
    if speed is None:
        raise RecordingError(f"{recording.name} has no velocity")
    top = abs(speed).max(axis=0) if top is None else top
    share = np.max(abs(speed) / np.where(top > 0.0, top, np.inf), axis=1)
    step = float(np.median(np.diff(recording.time)))
    width = 2 * speed_reach(step, window) + 1
    return np.asarray(maximum_filter1d(share, width, mode="nearest"))


def speed_reach(step: float, window: float = SPEED_WINDOW) -> int:
    """Return the samples of a step [s] in half a window, rounding of stamps forgiven.

    Examples
    --------
    >>> speed_reach(0.001), speed_reach(0.0010000000000009)
    (125, 125)
    """
    return int(0.5 * window / step + 1e-6)


def saturated(recording: Recording, limit: ArrayLike | None = None) -> BoolArray:
    """Return where each joint's torque is at its limit, shape (samples, joints).

    Parameters
    ----------
    recording : Recording
        With torque, as recorded: filters round a plateau off.
    limit : array_like, shape () or (joints,), optional, [N m or N]
        Largest torque either way.  By default the largest and the smallest torque of a
        joint are taken for limits if they are met again and again: in runs of at least
        three readings, and ten times as often as the values next to them, so that the
        top of a smooth curve is not meant.  Noise on top of a limit hides it.  A
        reading that a slower channel holds for several samples is one.

    Raises
    ------
    RecordingError
        If there is no torque, or a limit is not positive.
    """
    torque = recording.torque
    if torque is None:
        raise RecordingError(f"{recording.name} has no torque")
    if limit is not None:
        shape = (len(recording.joints),) if np.ndim(limit) else ()
        bounds = frozen(limit, shape, "limit", RecordingError)
        if not (bounds > 0.0).all():
            raise RecordingError(f"limit is {bounds}, expected positive numbers")
        return np.asarray(abs(torque) >= (1.0 - _AT_LIMIT) * bounds)
    return np.column_stack([_top(tau) | _top(-tau) for tau in torque.T])


def row_weights(
    recording: Recording,
    mask: ArrayLike,
    joints: Sequence[str],
    *,
    others: Sequence[str] = (),
) -> Array:
    """Return weights for `build_regression`: 0 where masked, 1 elsewhere.

    Parameters
    ----------
    recording : Recording
    mask : array_like of bool, shape (samples,) or (samples, joints)
        By the recording's joints.
    joints : sequence of str
        The model's ``torque_joints``.
    others : sequence of str
        Rows among them that are no joint's and are kept: `BASE_ROWS`.

    Returns
    -------
    ndarray, shape (samples, torque joints)
    """
    masked, own = as_mask(recording, mask), [j for j in joints if j not in others]
    columns = [recording.joints.index(name) for name in recording.of(own).joints]
    weights = np.ones((len(recording), len(joints)))
    weights[:, [joints.index(name) for name in own]] -= masked[:, columns]
    return weights


def mask_onto(
    recording: Recording, mask: ArrayLike, target: Recording, *, reach: float = 0.0
) -> BoolArray:
    """Return a mask on the samples of what a recording has become.

    Masks are found in a log as it was recorded; once it has been resampled, filtered or
    decimated, its samples are others, and a filter has spread what is masked.

    Parameters
    ----------
    recording : Recording
        To which the mask belongs.
    mask : array_like of bool, shape (samples,) or (samples, joints)
    target : Recording
        What has become of it, or of a part of it.
    reach : float, [s]
        Samples so near to a masked one are masked, such as half a period of the
        cut-off; in any case those for which none is nearer.

    Returns
    -------
    ndarray of bool, shape (samples, joints) of `target`

    Examples
    --------
    >>> log = Recording(("elbow",), np.arange(6) * 0.01, np.zeros((6, 1)))
    >>> half = log.samples(slice(0, 6, 2))
    >>> mask_onto(log, [False] * 3 + [True] * 3, half)[:, 0].tolist()
    [False, True, True]
    """
    if not reach >= 0.0:
        raise RecordingError(f"reach is {reach} s, expected zero or more")
    columns = as_mask(recording, mask)
    joints = recording.of(target.joints).joints
    order = [recording.joints.index(name) for name in joints]
    reach = max(reach, 0.5 * float(np.median(np.diff(target.time))) * (1.0 + 1e-9))
    found = np.zeros((len(target), len(order)), dtype=np.bool_)
    for k, joint in enumerate(order):
        at = recording.time[columns[:, joint]]
        if len(at):
            near = np.searchsorted(at, target.time - reach)
            found[:, k] = at[np.minimum(near, len(at) - 1)] <= target.time + reach
            found[near == len(at), k] = False
    return found


def as_mask(recording: Recording, mask: ArrayLike) -> BoolArray:
    """Return a mask of shape (samples, joints), checked."""
    array = np.asarray(mask)
    shape = (len(recording), len(recording.joints))
    if array.dtype != np.bool_ or array.shape not in (shape, shape[:1]):
        raise RecordingError(
            f"{recording.name}: a mask of {array.dtype} and shape {array.shape}, "
            f"expected bool and {shape[:1]} or {shape}"
        )
    columns: Matrix = array if array.ndim == 2 else array[:, None]
    return np.broadcast_to(columns, shape)


def _top(tau: Vector) -> BoolArray:
    """Return where a torque is at its largest value, if that looks like a limit."""
    span = float(np.ptp(tau))
    step = quantum(tau) or 1e-9 * span
    at = tau >= tau.max() - 0.5 * step
    edges = tau.max() - step * np.array([5.5, 0.5])
    others = int(((tau >= edges[0]) & (tau < edges[1])).sum())
    ends = np.flatnonzero(np.diff(np.concatenate([[0], at.astype(int), [0]])))
    longest = int((ends[1::2] - ends[::2]).max())
    is_run = longest >= _RUN * held_samples(tau)
    is_limit = span > 0.0 and is_run and at.sum() >= _PILE * others / 5.0
    return at if is_limit else np.zeros(len(tau), dtype=np.bool_)
