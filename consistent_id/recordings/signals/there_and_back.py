"""A motion there and back on the same path, without what changes sign with its speed.

A path that is played backwards has velocities of opposite sign and the same
accelerations.  The torque of bodies is the same both times, that of friction the
opposite, if it is the same in both directions: so the mean of both is of the bodies
alone.  On slow motion that is gravity.  The same holds of hysteresis in a wrench
sensor, or of a cable that drags at it.
"""

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.contacts import Wrench
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import uniform_rate

APART = 0.02
"""Distance of two ways, relative to the travel, from which on they are no one path.

Drives that lag by 20 ms of a way of one second have as much.
"""

_SHORTEST = 0.25  # of a recording: the least that the shorter way may be
_COARSE = 200  # turning points that are tried at first


def there_and_back(recording: Recording, turn: float | None = None) -> Recording:
    """Return the mean of both directions of a motion there and back.

    Parameters
    ----------
    recording : Recording
        At a uniform rate, that goes along a path and the same way back, as fast.
    turn : float, optional, [s]
        When it turns back, on the recording's clock; by default the sample about which
        its positions are most symmetric.

    Returns
    -------
    Recording
        Of the way there, with mean positions, torques and wrenches, and half the
        difference of velocities.  Torque is known where it is both times.  Velocity and
        acceleration that the recording does not have are zero: poses at rest.

    Raises
    ------
    RecordingError
        If the two ways are more than `APART` apart, the base moves, or the clock is not
        uniform.

    Examples
    --------
    Gravity of 5 N m, and friction of 2 N m:

    >>> time = 0.01 * np.arange(401)
    >>> q = np.sin(np.pi / 4 * time)[:, None]
    >>> friction = np.where(time < 2, 2.0, -2.0)[:, None]
    >>> log = Recording(("elbow",), time, q, torque=5.0 * np.cos(q) + friction)
    >>> gravity = there_and_back(log)
    >>> bool(np.allclose(gravity.torque, 5.0 * np.cos(gravity.position)))
    True
    """
    if recording.base is not None or recording.contacts:
        raise RecordingError(
            f"{recording.name}: the base moves, or has contacts, which are not alike "
            "on the way back; give a recording of a robot on a fixed base"
        )
    uniform_rate(recording)  # else samples before and after the turn are no pairs
    q = recording.position
    at = _turn(q) if turn is None else int(np.argmin(abs(recording.time - turn)))
    count = min(at, len(q) - 1 - at)
    if count < 2:
        raise RecordingError(
            f"{recording.name}: it turns at {recording.time[at]:g} s, where there is "
            "no way there or none back"
        )
    there = np.arange(at - count, at)
    back = 2 * at - there
    _require_one_path(recording, there, back)

    def mean(values: Matrix | None, sign: float = 1.0) -> Array | None:
        return None if values is None else 0.5 * (values[there] + sign * values[back])

    still = np.zeros((count, q.shape[1]))
    velocity = mean(recording.velocity, -1.0)
    acceleration = mean(recording.acceleration)
    known = recording.torque_known
    wrenches = [
        Wrench(w.frame, 0.5 * (w.values[there] + w.values[back]), w.point, w.axes)
        for w in recording.wrenches
    ]
    return Recording(
        recording.joints,
        recording.time[there],
        0.5 * (q[there] + q[back]),
        still if velocity is None else velocity,
        still if acceleration is None else acceleration,
        mean(recording.torque),
        name=f"{recording.name}, there and back",
        wrenches=tuple(wrenches),
        torque_known=None if known is None else known[there] & known[back],
    )


def _turn(q: Matrix) -> int:
    """Return the sample about which positions are most symmetric."""
    n = len(q)
    first, last = int(_SHORTEST * n), int((1.0 - _SHORTEST) * n)
    step = max((last - first) // _COARSE, 1)
    rough = _best(q, np.arange(first, last + 1, step))
    around = np.arange(max(rough - step, first), min(rough + step, last) + 1)
    return _best(q, around)


def _best(q: Matrix, candidates: IntArray) -> int:
    scores = [_apart(q, int(at)) for at in candidates]
    return int(candidates[int(np.argmin(scores))])


def _apart(q: Matrix, at: int) -> float:
    """Return the mean squared distance of positions before and after a sample.

    Over what lies on both sides of it, relative to how far these positions scatter: a
    robot that waits is symmetric about any sample.
    """
    count = min(at, len(q) - 1 - at)
    before, after = q[at - count : at], q[at + count : at : -1]
    spread = float(np.sum(before.var(axis=0)))
    distance = float(np.mean(np.sum((before - after) ** 2, axis=1)))
    moved = np.ptp(before, axis=0).any()  # a mean of equal values may be rounded
    return distance / spread if moved else np.inf


def _require_one_path(recording: Recording, there: IntArray, back: IntArray) -> None:
    q = recording.position
    travel: Vector = np.ptp(q, axis=0)
    apart = abs(q[there] - q[back]).max(axis=0)
    j = int(np.argmax(apart / np.where(travel > 0.0, travel, np.inf)))
    if apart[j] > APART * travel[j]:
        raise RecordingError(
            f"{recording.name}: {recording.joints[j]} is up to {apart[j]:.3g} apart on "
            f"the way there and back, of a travel of {travel[j]:.3g}; expected one "
            f"path both ways, to {APART:.0%}; say when it turns back (turn), or cut "
            "the recording to one way there and one back"
        )
