"""Velocity and acceleration by differences or sliding polynomials, and their noise.

`fourier_differentiated` and `kalman_differentiated` are in other files.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.given_values import require_type
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import uniform_rate
from consistent_id.recordings.signals.filtered_rows import altered

_BUMP = 1e-4  # rad or m: small enough for methods that are not linear
_BANDS = 12  # of frequency, with alike shares of velocity and acceleration
_CENTRAL = 0.2  # of the sampling rate: above it central differences are mostly noise


def differentiated(recording: Recording) -> Recording:
    """Compute missing velocity and acceleration by central differences.

    A measured velocity is kept and differentiated once; without it, position is
    differentiated twice, the second time by the three-point second difference.  Filter
    first: differences amplify noise.

    Raises
    ------
    RecordingError
        If the clock is not uniform or there are fewer than four samples.

    Examples
    --------
    >>> import consistent_id as ci
    >>> time = np.arange(200) / 100
    >>> log = ci.Recording(("elbow",), time, np.sin(time)[:, None])
    >>> differentiated = ci.signals.differentiated(log)
    >>> bool(abs(differentiated.velocity[:, 0] - np.cos(time)).max() < 1e-3)
    True
    """
    require_type(recording, Recording, "recording")
    return altered(recording, _differentiated)


def _differentiated(recording: Recording) -> Recording:
    step = 1.0 / uniform_rate(recording)
    if len(recording) < 4:
        raise RecordingError(
            f"{recording.name}: {len(recording)} samples, expected 4 or more to "
            "differentiate"
        )
    velocity, acceleration = recording.velocity, recording.acceleration
    if acceleration is None:
        acceleration = (
            _second_difference(recording.position, step)
            if velocity is None
            else np.gradient(velocity, step, axis=0, edge_order=2)
        )
    if velocity is None:
        velocity = np.gradient(recording.position, step, axis=0, edge_order=2)
    return replace(recording, velocity=velocity, acceleration=acceleration)


def savitzky_golay_differentiated(
    recording: Recording, window: float, *, degree: int = 4
) -> Recording:
    """Fit a polynomial around each sample; take its value and derivatives there.

    Position, velocity and acceleration are all computed from the recorded position
    [SavitzkyGolay1964]_.  At both ends the polynomial of the last whole window is
    extrapolated.

    Parameters
    ----------
    recording : Recording
        Uniformly sampled.
    window : float, [s]
        Length of each polynomial's window, rounded to an odd number of samples.
    degree : int
        Degree of the polynomials, 2 or more.

    Raises
    ------
    RecordingError
        If the window has too few samples for the degree, or too many for the recording.
    """
    return altered(recording, partial(_polynomials, window=window, degree=degree))


def _polynomials(recording: Recording, window: float, degree: int) -> Recording:
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
        rate**order
        * sliding_polynomials(recording.position, samples, degree, derivative=order)
        for order in range(3)
    )
    return replace(recording, position=q, velocity=dq, acceleration=ddq)


def sliding_polynomials(
    values: Matrix, window: int, degree: int, *, derivative: int = 0
) -> Matrix:
    """Return the polynomial around each sample there, or its derivative by the sample.

    As ``scipy.signal.savgol_filter``, whose import takes a second.  At both ends the
    polynomial is that of the first and of the last window.

    Parameters
    ----------
    values : ndarray, shape (samples, columns)
    window : int
        Odd number of samples, not more than there are.
    degree : int
        Less than the window, which has three samples or more.
    derivative : int
        Its order.
    """
    half = window // 2
    places = np.arange(-half, half + 1) / half
    # Coefficients of the polynomial, and of its derivative, per sample in the window.
    fit = np.linalg.pinv(np.vander(places, degree + 1, increasing=True))
    slopes = np.polynomial.polynomial.polyder(fit, derivative, scl=1.0 / half)
    # At each of the places.
    weights = np.polynomial.polynomial.polyval(places, slopes).T
    inner = len(values) - window + 1
    middle = sum(w * values[k : k + inner] for k, w in enumerate(weights[half]))
    ends = weights[:half] @ values[:window], weights[half + 1 :] @ values[-window:]
    return np.concatenate([ends[0], np.asarray(middle), ends[1]])


def noise_gain(
    recording: Recording,
    prepare: Callable[[Recording], Recording],
    *,
    prepared: Recording | None = None,
) -> Array:
    """Return the covariance of prepared motion for readings of unit variance.

    A measured velocity is not included: its noise is different.

    With the preparation's impulse response ``h`` to an error of one reading,
    ``cov(x, y) = sum_k h_x[k] h_y[k]``, for any preparation: a filter and differences,
    sliding polynomials, a smoother.  By Parseval's theorem that is the integral over
    its frequency responses.

    Parameters
    ----------
    recording : Recording
        As recorded.
    prepare : callable
        Function that returns it with velocity and acceleration, from the positions.
    prepared : Recording, optional
        Result of `prepare` for `recording`, if it is known.

    Returns
    -------
    ndarray, shape (joints, 3, 3)
        Covariances of position [1], velocity [1/s] and acceleration [1/s^2], for white
        noise of the readings.

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
    without = _every_sample(prepare(recording) if prepared is None else prepared)
    off = prepare(replace(recording, position=position)).of(without.joints)
    moved = _every_sample(off)
    # Trimming may keep other samples at the ends after a reading has changed.
    _, first, second = np.intersect1d(moved.time, without.time, return_indices=True)
    answer = (
        _stacked_motion(moved)[:, first] - _stacked_motion(without)[:, second]
    ) / _BUMP
    # If every d-th sample is kept, so is a d-th of the response.
    kept = recording.rate / without.rate
    return np.asarray(kept * np.einsum("anj,bnj->jab", answer, answer))


def _every_sample(recording: Recording) -> Recording:
    """Return a recording as it was before it was thinned beside its torque."""
    behind = recording.torque_filter
    return recording if behind is None else behind.source


def _second_difference(position: Matrix, step: float) -> Matrix:
    inner = (position[2:] - 2.0 * position[1:-1] + position[:-2]) / step**2
    first = 2.0 * inner[:1] - inner[1:2]
    last = 2.0 * inner[-1:] - inner[-2:-1]
    return np.vstack([first, inner, last])


def _stacked_motion(motion: Recording) -> Array:
    if motion.velocity is None or motion.acceleration is None:
        raise RecordingError(
            f"{motion.name} has no velocity or no acceleration after its preparation"
        )
    return np.stack([motion.position, motion.velocity, motion.acceleration])


def lost_acceleration(
    time: Vector, position: Matrix, velocity: Matrix, *, highest: float
) -> Vector:
    """Return the share of the position's acceleration that a logged velocity lacks.

    Per band of frequency, the velocity's gain over the differentiated position; it is
    divided by that of the slowest band, so a wrong unit or clock counts as nothing.
    Bands are weighed by their acceleration, of which the bodies' torque is made:
    ``sqrt(sum a_b (1 - gain_b)^2 / sum a_b)`` over bands in which the gain is below 1.
    A delay of the velocity does not count either.

    Parameters
    ----------
    time : ndarray, shape (samples,), [s]
        Evenly spaced.
    position, velocity : ndarray, shape (samples, joints), [rad or m], [rad/s or m/s]
        Of joints that move.
    highest : float, [Hz]
        Highest frequency that counts.

    Returns
    -------
    ndarray, shape (joints,)

    Examples
    --------
    >>> t = np.arange(2000) / 100
    >>> q = np.sin(2 * t) + 0.2 * np.sin(9 * t)
    >>> halved = 2 * np.cos(2 * t) + 0.9 * np.cos(9 * t)  # of the faster sine
    >>> lost_acceleration(t, q[:, None], halved[:, None], highest=10.0).round(1)
    array([0.5])
    """
    step = (time[-1] - time[0]) / (len(time) - 1)
    slope, window = (position[2:] - position[:-2]) / (2.0 * step), len(time) - 2
    frequency = np.fft.rfftfreq(window, step)
    used = (frequency > 0.0) & (frequency <= min(highest, _CENTRAL / step))
    angle = 2.0 * np.pi * frequency[used] * step
    spectra = []
    for signal in (slope, velocity[1:-1]):
        centred = np.hanning(window)[:, None] * (signal - signal.mean(axis=0))
        spectra.append(np.fft.rfft(centred, axis=0)[used])
    D = spectra[0] * (angle / np.sin(angle))[:, None]  # undo the central difference
    cross, energy = D.conj() * spectra[1], abs(D) ** 2
    losses = []
    for c, e in zip(cross.T, energy.T, strict=True):
        fast = frequency[used] ** 2 * e
        share = np.cumsum(e / e.sum() + fast / fast.sum()) / 2.0
        band = np.minimum((share * _BANDS).astype(int), _BANDS - 1)
        kept = np.unique(band)
        real, imag, size, weight = (
            np.bincount(band, values)[kept] for values in (c.real, c.imag, e, fast)
        )
        gain = np.hypot(real, imag) / size
        missing = np.maximum(1.0 - gain / max(gain[0], np.finfo(float).tiny), 0.0)
        losses.append(np.sqrt((weight * missing**2).sum() / weight.sum()))
    return np.array(losses)
