"""First and last velocities that are zero because a difference is missing.

Differences of positions are one fewer than rows.  The row that is left over often gets
a velocity of zero, though the joints move.  A filter, which continues a log beyond its
ends from these rows, would make a jump of twice that error of it.
"""

import logging
from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.recordings.recording import Recording

_log = logging.getLogger(__name__)

_NEAR = 50  # rows from an end, which show how velocities change from row to row
_JUMP = 2.0  # times the largest of these changes


def with_end_velocities(recording: Recording) -> Recording:
    """Return a recording whose first and last velocities are of the motion.

    Where all joints have a velocity of exactly zero in one of these rows, but one of
    them moves and the next velocity is a jump, each joint gets the step of its position
    to that row over the time between them.  Where this is not near the next velocity,
    as at a jump by a whole turn, it gets the next velocity.  A warning says so.
    Accelerations stay as they are.

    Examples
    --------
    >>> time = np.arange(100) / 100
    >>> q = np.sin(time)[:, None]
    >>> dq = np.diff(q, axis=0, prepend=q[:1]) * 100  # of the first row: 0
    >>> log = Recording(("elbow",), time, q, dq)
    >>> with_end_velocities(log).velocity[:2].round(3).tolist()
    [[1.0], [1.0]]
    """
    dq = recording.velocity
    if dq is None or len(recording) < 4:
        return recording
    time, q = recording.time, recording.position
    changed = dq.copy()
    for name, end, step in (("first", 0, 1), ("last", -1, -1)):
        if _lacks_a_difference(*(x[::step][: _NEAR + 2] for x in (time, q, dq))):
            other = end + step
            moved = (q[other] - q[end]) / (time[other] - time[end])
            near = abs(moved - dq[other]) <= abs(dq[other])
            changed[end] = np.where(near, moved, dq[other])
            _log.warning(
                "%s: the %s velocity is zero, but the joints move: the step of their "
                "positions is read in its place",
                recording.name,
                name,
            )
    same = np.array_equal(changed, dq)
    return recording if same else replace(recording, velocity=changed)


def _lacks_a_difference(time: Vector, q: Matrix, dq: Matrix) -> bool:
    """Return whether the first velocities are zero, but not those of the motion."""
    if dq[0].any():
        return False
    usual = abs(np.diff(dq[1:], axis=0)).max(axis=0)
    jumps = abs(dq[1]) > _JUMP * usual
    moved = abs((q[1] - q[0]) / (time[1] - time[0]))
    near = (moved > 0.5 * abs(dq[1])) & (moved < 2.0 * abs(dq[1]))
    return bool((jumps & near).any())
