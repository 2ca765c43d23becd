"""Recorded motion as a Fourier series, whose derivatives are exact.

All samples of all periods are fitted by least squares [Swevers1997]_; the result is a
`FourierTrajectory` with its residual.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Matrix, Vector, freeze_arrays, frozen
from consistent_id._support.singular import svd
from consistent_id._support.tables import brief
from consistent_id.errors import RecordingError
from consistent_id.recordings.joint_paths import FourierTrajectory
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import own_rate
from consistent_id.recordings.signals.filtered_rows import altered

_MISSED = 0.1  # share of the root-mean-square motion: a larger residual is refused
_MOST = 50  # harmonics tried
_FASTEST = 0.45  # highest frequency over the sampling rate
_AMPLIFIED = 10.0  # noise in a coefficient, relative to frequencies far apart


@brief
@dataclass(frozen=True, slots=True, eq=False)
class FourierFit:
    """A Fourier series for each joint, and its residual.

    Parameters
    ----------
    trajectory : FourierTrajectory
        From the recording's first sample to its last.
    residual : array_like, shape (joints,), [rad or m]
        Root-mean-square difference from the recorded position.
    criterion : array_like, shape (tried,)
        Bayesian information criterion, over all joints, of each series that was tried:
        with 1, 2, ... harmonics, or with the given frequencies.
    """

    trajectory: FourierTrajectory
    residual: Vector
    criterion: Vector

    def __post_init__(self) -> None:
        freeze_arrays(
            self, {"residual": (len(self.trajectory.joints),), "criterion": (None,)}
        )

    @property
    def period(self) -> float | None:
        """Time after which the series repeats [s], if it does."""
        return self.trajectory.period


def fourier_fit(
    recording: Recording, period: float, harmonics: int | None = None
) -> FourierFit:
    """Fit a Fourier series to the recorded position; the clock need not be uniform.

    Parameters
    ----------
    recording : Recording
        Recording of at least one whole period.
    period : float, [s]
    harmonics : int, optional
        By default the number, up to 50, with the least Bayesian information criterion
        [Schwarz1978]_, ``samples log(variance) + parameters log(samples)``, summed over
        joints: the number is the same for all, since one controller made the motion.

    Raises
    ------
    RecordingError
        If the recording is shorter than a period, or has too few samples for the
        harmonics.

    Examples
    --------
    >>> time = np.arange(200) / 50.0
    >>> log = Recording(("elbow",), time, 0.5 * np.sin(np.pi * time)[:, None])
    >>> fit = fourier_fit(log, 2.0, harmonics=1)
    >>> fit.trajectory.sine.round(12).tolist()
    [[0.5]]
    """
    if not 0.0 < period < np.inf:
        raise RecordingError(f"period is {period} s, expected a positive number")
    if _span(recording) < period * (1.0 - 1e-9):
        raise RecordingError(
            f"{recording.name} lasts {recording.duration:.6g} s, expected at least one "
            f"period of {period:g} s"
        )
    n = len(recording)
    # Beyond Nyquist, and with as many terms as samples, columns are dependent.
    most = min((n - 2) // 4, int(_FASTEST * period * own_rate(recording)))
    if harmonics is not None and not 1 <= harmonics <= most:
        raise RecordingError(
            f"{recording.name}: {harmonics} harmonics of {period:g} s, expected "
            f"between 1 and {most} with {n} samples"
        )
    tried = min(most, _MOST) if harmonics is None else harmonics
    if tried < 1:
        raise RecordingError(f"{recording.name}: {n} samples are too few for a period")
    series = _Series.of(recording, np.arange(1, tried + 1) / period)
    criterion = series.criteria()
    chosen = int(np.argmin(criterion)) + 1 if harmonics is None else harmonics
    return series.fit(chosen, criterion)


def fit_trajectory(recording: Recording, frequencies: ArrayLike) -> FourierFit:
    """Fit sines and cosines of given frequencies to the recorded position.

    Parameters
    ----------
    recording : Recording
        Its clock need not be uniform.
    frequencies : array_like, shape (terms,), [Hz]
        Any, such as `harmonics_of` several base frequencies.

    Raises
    ------
    RecordingError
        If samples are too few or too far apart, or if frequencies are nearer to each
        other, or to zero, than the recording's length can resolve: noise in a
        coefficient would be more than ten times that for frequencies far apart.

    Examples
    --------
    >>> time = np.arange(400) / 50.0
    >>> two = np.sin(np.pi * time) + 0.2 * np.cos(1.5 * np.pi * time)
    >>> log = Recording(("elbow",), time, two[:, None])
    >>> fit_trajectory(log, [0.5, 0.75]).trajectory.cosine.round(12).tolist()
    [[0.0], [0.2]]
    """
    wanted = frozen(frequencies, (None,), f"{recording.name}: frequencies")
    if not len(wanted) or not (np.diff(wanted, prepend=0.0) > 0.0).all():
        raise RecordingError(
            f"{recording.name}: frequencies are {wanted.tolist()} Hz, expected "
            "positive and increasing ones"
        )
    fastest = _FASTEST * own_rate(recording)
    if wanted[-1] > fastest:
        raise RecordingError(
            f"{recording.name}: a frequency of {wanted[-1]:g} Hz, expected at most "
            f"{fastest:.4g} Hz, 0.45 of the sampling rate"
        )
    if len(recording) < 4 * len(wanted) + 2:
        raise RecordingError(
            f"{recording.name}: {len(recording)} samples for {len(wanted)} "
            f"frequencies, expected at least {4 * len(wanted) + 2}"
        )
    series = _Series.of(recording, wanted)
    _refuse_near_ones(recording, wanted, series.R)
    return series.fit(len(wanted), series.criteria()[-1:])


@dataclass(frozen=True, slots=True, eq=False)
class _Series:
    """A recording's position in the orthonormalised columns of a series.

    Parameters
    ----------
    frequencies : ndarray, shape (terms,), [Hz]
    Q, R : ndarray
        Factors of `series_columns`.
    z : ndarray, shape (2 terms + 1, joints)
        Q^T position.
    """

    recording: Recording
    frequencies: Vector
    Q: Matrix
    R: Matrix
    z: Matrix

    @classmethod
    def of(cls, recording: Recording, frequencies: Vector) -> "_Series":
        time = recording.time - recording.time[0]
        Q, R = np.linalg.qr(series_columns(time, frequencies))
        return cls(recording, frequencies, Q, R, Q.T @ recording.position)

    def criteria(self) -> Vector:
        """Return Bayes' criterion of the first, the first two, ... frequencies."""
        position, n = self.recording.position, len(self.recording)
        explained = np.cumsum(self.z**2, axis=0)[2::2]
        # Digits that cancel in the difference are below the rounding of the position.
        floor = n * (1e-15 * abs(position).max()) ** 2 + 1e-300
        left = np.maximum((position**2).sum(axis=0) - explained, floor)
        terms = 2 * np.arange(1, len(self.frequencies) + 1) + 1
        values = n * np.log(left / n) + terms[:, None] * np.log(n)
        return np.asarray(values.sum(axis=1))

    def fit(self, terms: int, criterion: Vector) -> FourierFit:
        """Return the series of the first few frequencies."""
        size = 2 * terms + 1
        x = np.asarray(np.linalg.solve(self.R[:size, :size], self.z[:size]), float)
        residual = self.recording.position - self.Q[:, :size] @ self.z[:size]
        trajectory = FourierTrajectory(
            joints=self.recording.joints,
            frequencies=self.frequencies[:terms],
            offset=x[0],
            sine=x[1::2],
            cosine=x[2::2],
            duration=self.recording.duration,
            start=float(self.recording.time[0]),
        )
        return FourierFit(trajectory, np.sqrt((residual**2).mean(axis=0)), criterion)


def _span(recording: Recording) -> float:
    """Return the time that samples represent: one mean step more than their span."""
    return recording.duration * len(recording) / (len(recording) - 1)


def _refuse_near_ones(recording: Recording, frequencies: Vector, R: Matrix) -> None:
    """Refuse frequencies whose columns are so similar that noise dominates.

    The covariance of the coefficients is ``sigma^2 (R^T R)^-1``; with frequencies far
    apart its diagonal is ``2 sigma^2 / samples``.
    """
    _, s, Vt = svd(R)
    s = np.maximum(s, s[0] * np.finfo(np.float64).eps)
    covariance = ((Vt.T / s) ** 2).sum(axis=1)
    noise = np.sqrt(covariance[1:].reshape(-1, 2).max(axis=1) * len(recording) / 2.0)
    worst = int(np.argmax(noise))
    if noise[worst] <= _AMPLIFIED:
        return
    others = np.append(np.delete(frequencies, worst), 0.0)
    nearest = others[np.argmin(abs(others - frequencies[worst]))]
    apart = abs(nearest - frequencies[worst])
    raise RecordingError(
        f"{recording.name}: {frequencies[worst]:g} Hz and {nearest:g} Hz are "
        f"{apart:.3g} Hz apart, too near to resolve in {_span(recording):.4g} s: noise "
        f"in their coefficients would be {noise[worst]:.2g} times what it should be. "
        f"Record about {1.0 / apart:.3g} s, or leave one out"
    )


def fourier_differentiated(
    recording: Recording, period: float, harmonics: int | None = None
) -> Recording:
    """Return the recording with the motion of its `fourier_fit`.

    Position, velocity and acceleration all come of the recorded position.  Check the
    fit's residual first: parts that do not repeat, such as the move to the start, are
    not in the series and must be cut off.

    Parameters
    ----------
    recording : Recording
        With position.
    period : float, [s]
    harmonics : int, optional
        See `fourier_fit`.

    Raises
    ------
    RecordingError
        As `fourier_fit`, or as `require_repeating`.
    """
    fit = fourier_fit(recording, period, harmonics)
    require_repeating(recording, fit)
    return altered(recording, partial(on_series, fit=fit))


def on_series(recording: Recording, fit: FourierFit) -> Recording:
    """Return a recording with the motion of a series at its times."""
    q, dq, ddq = fit.trajectory.evaluate(recording.time)
    return replace(recording, position=q, velocity=dq, acceleration=ddq)


def require_repeating(recording: Recording, fit: FourierFit) -> None:
    """Refuse a series with a large residual: its derivatives are even worse.

    Raises
    ------
    RecordingError
        If it leaves more than a tenth of the root-mean-square motion of all joints.
    """
    motion = float(np.linalg.norm(recording.position.std(axis=0)))
    left = float(np.linalg.norm(fit.residual))
    if left > _MISSED * motion:
        raise RecordingError(
            f"{recording.name}: a series with {len(fit.trajectory)} harmonics of "
            f"{fit.period:g} s leaves {left / motion:.0%} of the motion. Is the "
            f"period different (estimated_period finds it), or does a part not "
            f"repeat (trim it)? For motion without a period, use a filter or the "
            f"smoother"
        )


def series_columns(time: Vector, frequencies: Vector) -> Matrix:
    """Return 1, then sine and cosine of each frequency, a column each."""
    angles = np.outer(2.0 * np.pi * time, frequencies)
    columns = np.ones((len(time), 2 * len(frequencies) + 1))
    columns[:, 1::2], columns[:, 2::2] = np.sin(angles), np.cos(angles)
    return columns
