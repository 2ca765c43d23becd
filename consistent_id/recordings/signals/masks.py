"""Samples with little or wrong information: at rest, at touch-down, held readings.

Around touch-down, lift-off and stops, a filter mixes samples before and after; those
are left out by `without_impacts` and `without_rests`.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, BoolArray, Matrix, Vector
from consistent_id._support.caches import kept_for_equal
from consistent_id.errors import RecordingError
from consistent_id.recordings.beside import away_from_changes
from consistent_id.recordings.recording import Recording, velocities
from consistent_id.recordings.signals.filtered_rows import altered

STILL = 0.01  # share of the fastest joint's largest speed

SPEED_WINDOW = 0.25  # s, for which a joint that turns back is not at rest

# Half a period after a jump of friction, the error of its filtered value is 7 % of the
# jump, after one period 2 %, after one and a half 0.6 %.  In simulation
# (benchmarks/quadruped.py --first 100 --logs 4 --reaches 0.5 1 1.5 2) the trunk's
# errors fall until then.
_REST_PERIODS = 1.5

# The response of `low_passed` to an impact has fallen to 0.4 % of its peak, after half
# a period to 13 %.  In simulation misfits have decreased after half a period, and the
# trunk's errors are the same up to four periods (benchmarks/quadruped.py --first 10
# --logs 2 --guards 0 0.5 1 2 3 4); foot switches may be late, too.
_IMPACT_PERIODS = 2.0

# Of `quantum` and `held_samples`:
_LEVELS = 12  # fewest steps between levels that show a quantum
_REACHES = (3, 30, 300, 3000)  # multiples over which the quantum is refined in turn
_DIVISORS = 12  # of the smallest step that are tried
_OFF = 0.1  # share of the quantum by which a step may differ from a multiple,
_EXACT = 1e-3  # and where there are few different multiples
_KINDS = 6  # fewest different ones
_MOST = 0.98  # share of the steps that must be multiples
_ROUNDING = 1e-12  # share of the largest value: smaller steps are rounding

_ALIKE = 0.8  # share of runs of about one length, which rounding does not cause
_NEARLY = 0.1  # of that length, and a sample at least: clocks drift and jitter


def standstill(recording: Recording, velocity: float | None = None) -> BoolArray:
    """Return where each joint stands still, shape (samples, joints).

    Friction of a joint at rest has any value that balances it, so its torque contains
    little information on the model.

    Parameters
    ----------
    recording : Recording
        Without a velocity, differences of position are used: filter first.
    velocity : float, optional, [rad/s or m/s]
        Below which a joint stands still; by default a hundredth of the largest speed of
        all joints.
    """
    speed = velocities(recording)
    limit = STILL * abs(speed).max() if velocity is None else velocity
    if not limit >= 0.0:
        raise RecordingError(f"velocity is {velocity}, expected zero or more")
    return np.asarray((abs(speed) < limit) | (speed == 0.0))


def speed_share(
    recording: Recording, window: float = SPEED_WINDOW, *, top: Vector | None = None
) -> Vector:
    """Return the robot's speed as a share of top speed, shape (samples,).

    It is that of the joint with the largest share of its own top speed, the largest
    within half a window on either side: a joint that turns back is not at rest.

    Parameters
    ----------
    recording : Recording
        With velocity.
    window : float, [s]
    top : ndarray, shape (joints,), optional, [rad/s or m/s]
        Top speed of each joint; by default the largest of the recording.
    """
    speed = recording.velocity
    if speed is None:
        raise RecordingError(f"{recording.name} has no velocity")
    top = abs(speed).max(axis=0) if top is None else top
    share = np.max(abs(speed) / np.where(top > 0.0, top, np.inf), axis=1)
    step = float(np.median(np.diff(recording.time)))
    return _largest_around(share, speed_reach(step, window))


def _largest_around(values: Vector, reach: int) -> Vector:
    """Return the largest value within so many samples on either side.

    Windows are doubled; the import of scipy.ndimage takes longer.
    """
    ends = np.full(reach, -np.inf)
    largest: Vector = np.concatenate([ends, values, ends])
    span, width = 1, 2 * reach + 1
    while 2 * span <= width:
        largest = np.maximum(largest[:-span], largest[span:])
        span *= 2
    last = width - span
    found = np.maximum(largest[: len(values)], largest[last : last + len(values)])
    return np.asarray(found)


def speed_reach(step: float, window: float = SPEED_WINDOW) -> int:
    """Return the samples of a step [s] in half a window, rounding of stamps forgiven.

    Examples
    --------
    >>> speed_reach(0.001), speed_reach(0.0010000000000009)
    (125, 125)
    """
    return int(0.5 * window / step + 1e-6)


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
        Rows among them that do not belong to joints and are kept: `BASE_ROWS`.

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
    """Return a recording's mask on the samples of its processed form.

    Masks are found in the raw log; after resampling, filtering or decimation, its
    samples are different, and a filter has spread the masked values.

    Parameters
    ----------
    recording : Recording
        To which the mask belongs.
    mask : array_like of bool, shape (samples,) or (samples, joints)
    target : Recording
        The processed recording, or a part of it.
    reach : float, [s]
        Samples within this time of a masked one are masked, for example half a period
        of the cut-off; the nearest samples are always masked.

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


def rest_guard(cutoff: float) -> float:
    """Return the time for which a filter spreads friction's jump to either side, [s].

    Dry friction jumps when a joint stops, starts or turns back.  The guard ends where
    the error of the filtered torque is below 1 % of the jump.

    Parameters
    ----------
    cutoff : float, [Hz]
        Cut-off of `low_passed`; the lower one of motion and torque.  The higher it is,
        the fewer samples are lost.

    Raises
    ------
    RecordingError
        If it is not a positive number.

    Examples
    --------
    >>> rest_guard(60.0)
    0.025
    """
    return spread(_REST_PERIODS, cutoff)


def without_rests(
    recording: Recording, velocity: float, *, reach: float = 0.0
) -> Recording:
    """Return a recording in which the torque of joints at rest counts as unknown.

    Parameters
    ----------
    recording : Recording
    velocity : float, [rad/s or m/s]
        Speed below which a joint rests; see `standstill`.
    reach : float, [s]
        Time before and after a rest for which torque is not known, either; see
        `rest_guard`. If it is positive, reversals count as rests, too, at any speed.
    """

    def rests(whole: Recording) -> BoolArray:
        slow = standstill(whole, velocity)
        return slow | _turning(whole) if reach > 0.0 else slow

    return unknown_where(recording, rests, reach=reach)


def without_standstill(recording: Recording, *, reach: float = 0.0) -> Recording:
    """Return a recording whose torque is unknown where all joints stand still.

    Parameters
    ----------
    recording : Recording
    reach : float, [s]
        As for `without_rests`.
    """

    def still(whole: Recording) -> BoolArray:
        rests = standstill(whole)
        return np.broadcast_to(np.all(rests, axis=1, keepdims=True), rests.shape)

    return unknown_where(recording, still, reach=reach)


def unknown_where(
    recording: Recording,
    mask: Callable[[Recording], BoolArray],
    *,
    reach: float = 0.0,
) -> Recording:
    """Return a recording in which the torque of masked samples counts as unknown.

    Parameters
    ----------
    recording : Recording
    mask : callable
        Function that returns the samples of a recording, shape (samples, joints).
    reach : float, [s]
        Time before and after these samples for which torque is not known, either.
    """

    def change(whole: Recording) -> Recording:
        known = ~mask_onto(whole, mask(whole), whole, reach=reach)
        if whole.torque_known is not None:
            known &= whole.torque_known
        return replace(whole, torque_known=known)

    return altered(recording, change)


def impact_guard(cutoff: float) -> float:
    """Return the time for which a filter spreads an impact to either side, [s].

    Parameters
    ----------
    cutoff : float, [Hz]
        Cut-off of `low_passed`; the lower one of motion and torque.

    Raises
    ------
    RecordingError
        If it is not a positive number.

    Examples
    --------
    >>> impact_guard(20.0)
    0.1
    """
    return spread(_IMPACT_PERIODS, cutoff)


def without_impacts(recording: Recording, guard: float) -> Recording:
    """Return a recording whose contacts are not certain around their changes.

    Touch-down is an impact, shorter than a sample; a filter spreads it, and mixes
    forces of different contacts.

    Parameters
    ----------
    recording : Recording
        With contacts.
    guard : float, [s]
        Time before and after touch-down and lift-off; see `impact_guard`.

    Returns
    -------
    Recording
        The same except `ContactFlags.certain`: those samples have no rows.

    Raises
    ------
    RecordingError
        If there are no contacts, or the guard is negative or not a number.

    Examples
    --------
    >>> from consistent_id.recordings import ContactFlags
    >>> closed = [False, False, True, True, True]
    >>> time, q = np.linspace(0.0, 0.4, 5), np.zeros((5, 1))
    >>> log = Recording(("knee",), time, q, contacts=[ContactFlags("foot", closed)])
    >>> without_impacts(log, 0.1).contacts[0].certain
    array([ True, False, False,  True,  True])
    """
    if not recording.contacts:
        raise RecordingError(
            f"{recording.name}: there are no contacts that can change; give "
            "Recording(..., contacts=...)"
        )
    if not 0.0 <= guard < np.inf:
        raise RecordingError(f"guard is {guard} s, expected zero or more")

    def change(whole: Recording) -> Recording:
        contacts = tuple(
            replace(
                flags,
                certain=flags.certain
                & away_from_changes(flags.closed, whole.time, guard),
            )
            for flags in whole.contacts
        )
        return replace(whole, contacts=contacts)

    return altered(recording, change)


def spread(periods: float, cutoff: float) -> float:
    """Return the duration of a number of periods of a cut-off [Hz], [s]."""
    if not (np.isfinite(cutoff) and cutoff > 0.0):
        raise RecordingError(f"cut-off is {cutoff} Hz, expected a positive number")
    return periods / cutoff


def encoder_resolution(recording: Recording) -> Vector:
    """Return the step of each joint's position, shape (joints,), [rad or m].

    It is the largest number of which all steps between positions are multiples; 0 if
    there is none, as in computed positions, and for joints that did not move. A
    rounding error of up to half a step has the variance ``step**2 / 12``.

    Examples
    --------
    >>> time = np.arange(500) / 100.0
    >>> read = np.round(np.sin(time) / 0.0025) * 0.0025
    >>> log = Recording(("elbow",), time, read[:, None])
    >>> encoder_resolution(log).round(12).tolist()
    [0.0025]
    """
    return np.array([quantum(values) for values in recording.position.T])


@kept_for_equal(most=128)  # several checks ask for the same channels
def quantum(values: Vector) -> float:
    """Return the largest number of which all differences are multiples, or 0.

    Steps between neighbouring levels are small multiples, so rounding errors of quantum
    and values do not accumulate.
    """
    levels = np.unique(values)
    gaps = np.diff(levels)
    gaps = gaps[gaps > _ROUNDING * abs(levels).max()]
    if len(gaps) < _LEVELS:
        return 0.0
    # A few values, written by an interpolating logger, may lie between levels.
    for smallest in (gaps.min(), np.quantile(gaps, 0.01, method="lower")):
        for divisor in range(1, _DIVISORS + 1):
            step = _refined_quantum(gaps, float(smallest) / divisor)
            if step > 0.0:
                return step
    return 0.0


def held_samples(values: Vector) -> int:
    """Return the number of samples for which a channel holds each reading; 1 if none.

    Runs of one value have about the same length if a slower channel is held, and any
    length if readings are rounded or clipped.

    Examples
    --------
    >>> held_samples(np.repeat(np.sin(np.arange(50.0)), 4))
    4
    >>> held_samples(np.round(3.0 * np.sin(0.02 * np.arange(1000.0))))
    1
    """
    edges = np.flatnonzero(np.diff(values) != 0.0)
    runs = np.diff(edges)  # whole ones, between two changes
    if len(runs) == 0:
        return 1
    usual = int(np.median(runs))
    alike = abs(runs - usual) <= max(_NEARLY * usual, 1.0)
    return usual if usual > 1 and alike.mean() >= _ALIKE else 1


def _turning(recording: Recording) -> BoolArray:
    """Return the samples before and after each change of a velocity's sign."""
    speed = recording.velocity
    if speed is None:
        speed = np.gradient(recording.position, recording.time, axis=0)
    turns = speed[1:] * speed[:-1] < 0.0
    found = np.zeros(speed.shape, dtype=np.bool_)
    found[1:] |= turns
    found[:-1] |= turns
    return found


def _refined_quantum(gaps: Vector, step: float) -> float:
    """Return a step near the given one of which the gaps are multiples, or 0."""
    for reach in _REACHES:
        near = gaps[gaps < (reach + 0.5) * step]
        multiples = np.round(near / step)
        if not multiples.any():
            return 0.0
        step = float((multiples * near).sum() / (multiples**2).sum())
    near = gaps[gaps < (_REACHES[-1] + 0.5) * step]
    multiples = np.round(near / step)
    off = abs(near / step - multiples)
    known = len(near) >= max(_LEVELS, len(gaps) / 2)
    # Steps of a motion at even speed are all alike, though not exactly.
    nearly = _OFF if len(np.unique(multiples)) >= _KINDS else _EXACT
    return step if known and (off <= nearly).mean() >= _MOST else 0.0
