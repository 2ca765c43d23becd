"""Position, velocity and acceleration from polynomials over a sliding window."""

from dataclasses import replace

import numpy as np

from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import uniform_rate


def savitzky_golay_differentiated(
    recording: Recording, window: float, *, degree: int = 4
) -> Recording:
    """Fit a polynomial around each sample; take its value and derivatives there.

    Position, velocity and acceleration all come of the recorded position
    [SavitzkyGolay1964]_.  At both ends the polynomial of the last whole window is
    continued.

    Parameters
    ----------
    recording : Recording
        Uniformly sampled.
    window : float, [s]
        Over which each polynomial is fitted; rounded to an odd number of samples.
    degree : int
        Of the polynomials, 2 or more.

    Raises
    ------
    RecordingError
        If the window holds too few samples for the degree, or too many for the
        recording.
    """
    from scipy.signal import savgol_filter

    rate = uniform_rate(recording)
    if not isinstance(degree, int) or degree < 2:
        raise RecordingError(f"degree is {degree!r}, expected 2, 3, 4, ...")
    if not 0.0 < window <= len(recording) / rate:
        raise RecordingError(
            f"{recording.name}: a window of {window} s, expected more than zero and at "
            f"most the recording's {len(recording) / rate:.6g} s"
        )
    samples = 2 * int(window * rate / 2.0) + 1
    if samples > len(recording):
        samples -= 2
    if samples <= degree:
        raise RecordingError(
            f"{recording.name}: a window of {window:g} s holds {samples} samples, "
            f"expected more than the degree {degree}. Widen the window"
        )
    q, dq, ddq = (
        np.asarray(
            savgol_filter(
                recording.position,
                samples,
                degree,
                deriv=order,
                delta=1.0 / rate,
                axis=0,
            )
        )
        for order in range(3)
    )
    return replace(recording, position=q, velocity=dq, acceleration=ddq)
