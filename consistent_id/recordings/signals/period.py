"""The period of a motion that repeats itself."""

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording, positions_at
from consistent_id.recordings.signals.fourier import fourier_fit, series_columns

_COARSE = 4000  # samples on which a period is first guessed
_UNLIKE = 0.1  # squared change after a period, over the variance
_FIRST = 10  # harmonics with which a guess is refined
_REPEATS = 1.5  # periods a recording must hold for its period to be estimated


def estimated_period(
    recording: Recording,
    *,
    shortest: float | None = None,
    longest: float | None = None,
    harmonics: int | None = None,
) -> float:
    """Return the period [s] of a motion that repeats itself.

    A first guess, the shift by which the position is most like itself, is refined by
    the least squares of a series of given length.

    Parameters
    ----------
    recording : Recording
        Of at least one and a half periods.
    shortest, longest : float, optional, [s]
        Between which the period is looked for; by default all that 20 samples and the
        recording's length allow.
    harmonics : int, optional
        Of the series that refines it; by default as many as `fourier_fit` chooses.  A
        series that lacks what the motion has is biased.

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


def _refined(recording: Recording, guess: float, reach: float, harmonics: int) -> float:
    """Return the period near a guess with which a series leaves least."""
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
    count = min(len(recording), _COARSE)
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
    # Two periods are as good as one: the first shift that is nearly the best.
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
