"""Motion that repeats a path: its period, and the mean of both directions.

A path that is played backwards has velocities of opposite sign and the same
accelerations.  The torque of bodies is the same both times; that of friction has the
opposite sign, if it is the same in both directions.  So the mean is the torque of the
bodies alone, which is gravity torque for slow motion.  The same is true for hysteresis
of a wrench sensor, or for a cable that drags at it.
"""

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.beside import Wrench
from consistent_id.recordings.recording import Recording, positions_at
from consistent_id.recordings.signals.clocks import uniform_rate
from consistent_id.recordings.signals.fourier import fourier_fit, series_columns

_GUESSED_ON = 4000  # samples for the first estimate of a period
_UNLIKE = 0.1  # squared change after a period, over the variance
_FIRST = 10  # harmonics for refining an estimate
_MISSING = 0.02  # share of a period that whole periods may lack
_REPEATS = 1.5  # least periods of a recording for estimating its period

APART = 0.02
"""Largest distance of both directions, relative to the travel, for one path.

A lag of 20 ms on a path of one second causes as much.
"""

_SHORTER_WAY = 0.25  # least length of the shorter direction, as a share of a recording
_TURNS_TRIED = 200  # turning points that are tried at first


def estimated_period(
    recording: Recording,
    *,
    shortest: float | None = None,
    longest: float | None = None,
    harmonics: int | None = None,
) -> float:
    """Return the period [s] of a motion that repeats itself.

    A first estimate, the shift with the largest autocorrelation of the position, is
    refined by least squares of a series of given length.

    Parameters
    ----------
    recording : Recording
        Recording of at least one and a half periods.
    shortest, longest : float, optional, [s]
        Range of the period; by default the range that 20 samples and the recording's
        length allow.
    harmonics : int, optional
        Harmonics of the series that refines it; by default as many as `fourier_fit`
        chooses. With too few harmonics, the result is biased.

    Raises
    ------
    RecordingError
        If the motion does not repeat itself.
    """
    step = recording.duration / (len(recording) - 1)
    low = 20 * step if shortest is None else shortest
    high = recording.duration / _REPEATS if longest is None else longest
    if not 0.0 < low < high <= recording.duration:
        raise RecordingError(
            f"{recording.name}: a period between {low:.4g} s and {high:.4g} s, "
            f"expected less than the recording's {recording.duration:.6g} s"
        )
    guess, coarse = _self_similar(recording, low, high)
    period = _refined(recording, guess, 2 * coarse, harmonics or _FIRST)
    if harmonics is not None:
        return period
    fit = fourier_fit(recording, min(period, recording.duration))
    return _refined(recording, period, 2 * coarse, max(len(fit.trajectory), _FIRST))


def whole_periods(duration: float, period: float, step: float) -> int:
    """Return the number of whole periods of a motion.

    The last sample of ``N`` periods may be the first of the next period, or be left
    out.  An estimated period is rounded, and slow samples at both ends of a motion
    count as rest, so another fiftieth of a period may be missing.

    Parameters
    ----------
    duration : float, [s]
        From the first sample of the motion to the last.
    period : float, [s]
    step : float, [s]
        Between two samples.

    Examples
    --------
    >>> whole_periods(27.0, 9.0000000029, 0.01), whole_periods(26.99, 9.0, 0.01)
    (3, 3)
    >>> whole_periods(26.5, 9.0, 0.01)
    2
    """
    return int((duration + step) / period + _MISSING)


def there_and_back(recording: Recording, turn: float | None = None) -> Recording:
    """Return the mean of both directions of a motion there and back.

    Parameters
    ----------
    recording : Recording
        At a uniform rate, along a path and back along the same path at the same speed.
    turn : float, optional, [s]
        Time of the turn, on the recording's clock; by default the sample about which
        its positions are most symmetric.

    Returns
    -------
    Recording
        The motion there, with mean positions, torques and wrenches, and half the
        difference of velocities.  Torque is known where both torques are known.
        Velocity and acceleration that the recording does not have are zero: poses at
        rest.

    Raises
    ------
    RecordingError
        If both paths are more than `APART` apart, the base moves, or the clock is not
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
            f"{recording.name}: the base moves, or has contacts, which differ on the "
            f"way back; give a recording of a robot on a fixed base"
        )
    uniform_rate(recording)  # else samples before and after the turn are not pairs
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


def _refined(recording: Recording, guess: float, reach: float, harmonics: int) -> float:
    """Return the period near an estimate for which a series has the least residual."""
    from scipy.optimize import minimize_scalar

    step = recording.duration / (len(recording) - 1)
    centred = recording.position - recording.position.mean(axis=0)
    scale = np.maximum((centred**2).sum(axis=0), 1e-300)

    def misfit(period: float) -> float:
        terms = min(harmonics, int(0.45 * period / step))
        frequencies = np.arange(1, terms + 1) / period
        columns = series_columns(recording.time - recording.time[0], frequencies)
        Q, _ = np.linalg.qr(columns)
        left = scale - ((Q.T @ centred) ** 2).sum(axis=0)
        return float((left / scale).mean())

    best = minimize_scalar(
        misfit,
        bounds=(guess - reach, guess + reach),
        method="bounded",
        options={"xatol": 1e-6 * step},
    )
    return float(best.x)


def _self_similar(recording: Recording, low: float, high: float) -> Vector:
    """Return the first shift that makes the motion repeat itself, and its accuracy."""
    count = min(len(recording), _GUESSED_ON)
    clock = np.linspace(recording.time[0], recording.time[-1], count)
    step = float(clock[1] - clock[0])
    q = positions_at(recording, clock)
    spread = np.maximum(q.var(axis=0), 1e-300)
    lags = np.arange(max(int(low / step), 1), min(int(high / step) + 2, count - 2))
    unlike = (_changes(q, lags) / spread).mean(axis=1)
    dips = np.flatnonzero((unlike[1:-1] <= unlike[:-2]) & (unlike[1:-1] <= unlike[2:]))
    if len(dips) == 0 or unlike[dips + 1].min() > _UNLIKE:
        raise RecordingError(
            f"{recording.name}: the motion does not repeat itself after {low:.4g} s to "
            f"{high:.4g} s; give the period"
        )
    # Two periods fit as well as one: use the first shift that is nearly the best.
    near = unlike[dips + 1] <= unlike[dips + 1].min() + 0.2 * _UNLIKE
    return np.array([lags[dips[near][0] + 1] * step, step])


def _changes(q: Matrix, lags: IntArray) -> Matrix:
    """Return mean squares of ``q[lag:] - q[:-lag]``, shape (lags, columns).

    The squares' sums less twice the autocorrelation, which comes of a Fourier
    transform.
    """
    n = len(q)
    q = q - q.mean(axis=0)
    spectrum = np.fft.rfft(q, 2 * n, axis=0)
    alike = np.fft.irfft(abs(spectrum) ** 2, axis=0)[lags]
    sums = np.vstack([np.zeros((1, q.shape[1])), np.cumsum(q**2, axis=0)])
    squares = sums[n] - sums[lags] + sums[n - lags]
    return np.asarray((squares - 2.0 * alike) / (n - lags)[:, None])


def _turn(q: Matrix) -> int:
    """Return the sample about which positions are most symmetric."""
    n = len(q)
    first, last = int(_SHORTER_WAY * n), int((1.0 - _SHORTER_WAY) * n)
    step = max((last - first) // _TURNS_TRIED, 1)
    rough = _most_symmetric(q, np.arange(first, last + 1, step))
    around = np.arange(max(rough - step, first), min(rough + step, last) + 1)
    return _most_symmetric(q, around)


def _most_symmetric(q: Matrix, candidates: IntArray) -> int:
    scores = [_apart(q, int(at)) for at in candidates]
    return int(candidates[int(np.argmin(scores))])


def _apart(q: Matrix, at: int) -> float:
    """Return the mean squared distance of positions before and after a sample.

    It is computed over both sides, relative to the scatter of these positions: a robot
    that waits is symmetric about any sample.
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
            f"{recording.name}: {recording.joints[j]} differs by up to "
            f"{apart[j]:.3g} between the way there and back, for a travel of "
            f"{travel[j]:.3g}; expected one path both ways, within {APART:.0%}; "
            f"state the time of the turn (turn), or cut the recording to one way "
            f"there and one back"
        )
