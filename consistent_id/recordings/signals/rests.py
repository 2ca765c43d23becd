"""Torque of joints at rest, where friction is whatever balances the joint."""

from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import BoolArray
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.impacts import spread
from consistent_id.recordings.signals.masks import mask_onto, standstill

# Half a period after friction has jumped, its filtered value is still 7 % of the jump
# off, after one period 2 %, after one and a half 0.6 %.  In simulation
# (benchmarks/quadruped.py --first 100 --logs 4 --reaches 0.5 1 1.5 2) the trunk's
# errors fall until then.
_PERIODS = 1.5


def rest_guard(cutoff: float) -> float:
    """Return for how long a filter spreads the jump of friction to either side, [s].

    Dry friction jumps when a joint stops, starts or turns back.  The jump counts as
    over where the filtered torque is within 1 % of it of what it was, or will be.

    Parameters
    ----------
    cutoff : float, [Hz]
        Of `low_passed`; of motion and torque the lower one.  The higher it is, the
        fewer samples are lost.

    Raises
    ------
    RecordingError
        If it is not a positive number.

    Examples
    --------
    >>> rest_guard(60.0)
    0.025
    """
    return spread(_PERIODS, cutoff)


def without_rests(
    recording: Recording, velocity: float, *, reach: float = 0.0
) -> Recording:
    """Return a recording in which the torque of joints at rest is not known.

    Parameters
    ----------
    recording : Recording
    velocity : float, [rad/s or m/s]
        Below which a joint rests; see `standstill`.
    reach : float, [s]
        Before and after, for which its torque is not known either; see `rest_guard`.
        With it a joint that turns back rests, too, however fast it does.
    """
    rests = standstill(recording, velocity)
    if reach > 0.0:
        rests = rests | _turning(recording)
    known = ~mask_onto(recording, rests, recording, reach=reach)
    if recording.torque_known is not None:
        known &= recording.torque_known
    return replace(recording, torque_known=known)


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
