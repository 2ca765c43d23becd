"""What a preparation makes of white noise on the position."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording

_BUMP = 1e-4  # rad or m: as linear for a filter as any, small for one that adapts


def noise_gain(
    recording: Recording,
    prepare: Callable[[Recording], Recording],
    *,
    prepared: Recording | None = None,
) -> Array:
    """Return the covariance of prepared motion for readings of unit variance.

    Of a measured velocity nothing is said: its noise is another.

    By the preparation's own answer ``h`` to a reading that is off,
    ``cov(x, y) = sum_k h_x[k] h_y[k]``, whatever the preparation is: a filter and
    differences, sliding polynomials, a smoother.  By Parseval's theorem that is the
    integral over its frequency responses.

    Parameters
    ----------
    recording : Recording
        As recorded.
    prepare : callable
        Returns it with velocity and acceleration, from the positions.
    prepared : Recording, optional
        What `prepare` makes of `recording`, if that is known.

    Returns
    -------
    ndarray, shape (joints, 3, 3)
        Of position [1], velocity [1/s] and acceleration [1/s^2]; noise is white where
        the reading's is.

    Raises
    ------
    RecordingError
        If the preparation returns no derivatives.

    Examples
    --------
    >>> from consistent_id import differentiated
    >>> log = Recording(("a",), np.arange(100) / 100.0, np.zeros((100, 1)))
    >>> gain = noise_gain(log, differentiated)[0]  # of differences at 100 Hz
    >>> np.diag(gain).round(6).tolist()  # 1, 1 / (2 h^2), 6 / h^4
    [1.0, 5000.0, 600000000.0]
    """
    position = recording.position.copy()
    position[len(recording) // 2] += _BUMP
    without = prepare(recording) if prepared is None else prepared
    moved = prepare(replace(recording, position=position)).of(without.joints)
    # Trimming may keep other samples at the ends once a reading is off.
    _, first, second = np.intersect1d(moved.time, without.time, return_indices=True)
    answer = (_states(moved)[:, first] - _states(without)[:, second]) / _BUMP
    # Where every d-th sample is kept, so is a d-th of the answer.
    kept = recording.rate / without.rate
    return np.asarray(kept * np.einsum("anj,bnj->jab", answer, answer))


def _states(motion: Recording) -> Array:
    if motion.velocity is None or motion.acceleration is None:
        raise RecordingError(
            f"{motion.name} has no velocity or no acceleration after its preparation"
        )
    return np.stack([motion.position, motion.velocity, motion.acceleration])
