"""Periodic motion as a Fourier series, whose derivatives are exact.

    q(t) = offset + sum_k  sine_k sin(k w t) + cosine_k cos(k w t),    w = 2 pi / period

is fitted to all samples of all periods by least squares [Swevers1997]_.
"""

from dataclasses import dataclass, replace

import numpy as np

from consistent_id._arrays import Array, Matrix, Vector, frozen
from consistent_id.errors import RecordingError
from consistent_id.recording import Recording
from consistent_id.signals.clocks import own_rate

_MISSED = 0.1  # of the root-mean-square motion: no such series
_MOST = 50  # harmonics tried


@dataclass(frozen=True, slots=True, eq=False)
class FourierFit:
    """A Fourier series for each joint.

    Parameters
    ----------
    joints : tuple of str
    period : float, [s]
    origin : float, [s]
        Time at which all angles are zero.
    offset : array_like, shape (joints,), [rad or m]
    sine, cosine : array_like, shape (harmonics, joints), [rad or m]
    residual : array_like, shape (joints,), [rad or m]
        Root-mean-square difference from the recorded position.
    criterion : array_like, shape (tried,)
        Bayesian information criterion of 1, 2, ... harmonics, over all joints.
    """

    joints: tuple[str, ...]
    period: float
    origin: float
    offset: Vector
    sine: Matrix
    cosine: Matrix
    residual: Vector
    criterion: Vector

    def __post_init__(self) -> None:
        n = len(self.joints)
        for name, shape in (
            ("offset", (n,)),
            ("sine", (None, n)),
            ("cosine", (None, n)),
            ("residual", (n,)),
            ("criterion", (None,)),
        ):
            object.__setattr__(self, name, frozen(getattr(self, name), shape, name))

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return len(self.sine)

    def evaluate(self, time: Vector) -> Array:
        """Return position, velocity and acceleration, shape (3, samples, joints)."""
        rates = 2.0 * np.pi / self.period * np.arange(1, self.harmonics + 1)
        angles = np.outer(np.asarray(time) - self.origin, rates)
        s, c = np.sin(angles), np.cos(angles)
        return np.array(
            [
                self.offset + s @ self.sine + c @ self.cosine,
                (c * rates) @ self.sine - (s * rates) @ self.cosine,
                -(s * rates**2) @ self.sine - (c * rates**2) @ self.cosine,
            ]
        )


def fourier_fit(
    recording: Recording, period: float, harmonics: int | None = None
) -> FourierFit:
    """Fit a Fourier series to the recorded position; the clock need not be uniform.

    Parameters
    ----------
    recording : Recording
        Of at least one whole period.
    period : float, [s]
    harmonics : int, optional
        By default the number, up to 50, with the least Bayesian information criterion
        [Schwarz1978]_, ``samples log(variance) + parameters log(samples)``, summed over
        joints: the same for all, since one controller made the motion.

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
    >>> fit.sine.round(12).tolist()
    [[0.5]]
    """
    if not 0.0 < period < np.inf:
        raise RecordingError(f"period is {period} s, expected a positive number")
    step = recording.duration / (len(recording) - 1)
    if recording.duration + step < period * (1.0 - 1e-9):
        raise RecordingError(
            f"{recording.name} lasts {recording.duration:.6g} s, expected at least one "
            f"period of {period:g} s"
        )
    n = len(recording)
    # Beyond Nyquist, and with as many terms as samples, columns are dependent.
    most = min((n - 2) // 4, int(0.45 * period * own_rate(recording)))
    if harmonics is not None and not 1 <= harmonics <= most:
        raise RecordingError(
            f"{recording.name}: {harmonics} harmonics of {period:g} s, expected "
            f"between 1 and {most} with {n} samples"
        )
    tried = min(most, _MOST) if harmonics is None else harmonics
    if tried < 1:
        raise RecordingError(f"{recording.name}: {n} samples are too few for a period")
    origin = float(recording.time[0])
    Q, R = np.linalg.qr(series_columns(recording.time - origin, period, tried))
    z = Q.T @ recording.position
    total = (recording.position**2).sum(axis=0)
    explained = np.cumsum(z**2, axis=0)[2::2]  # with 1, 2, ... harmonics
    # Digits that cancel in the difference are below rounding of the position.
    floor = n * (1e-15 * abs(recording.position).max()) ** 2 + 1e-300
    left = np.maximum(total - explained, floor)
    terms = 2 * np.arange(1, tried + 1) + 1
    criterion = (n * np.log(left / n) + terms[:, None] * np.log(n)).sum(axis=1)
    chosen = int(np.argmin(criterion)) + 1 if harmonics is None else harmonics
    size = 2 * chosen + 1
    x = np.linalg.solve(R[:size, :size], z[:size])
    residual = recording.position - Q[:, :size] @ z[:size]
    return FourierFit(
        joints=recording.joints,
        period=float(period),
        origin=origin,
        offset=x[0],
        sine=x[1::2],
        cosine=x[2::2],
        residual=np.sqrt((residual**2).mean(axis=0)),
        criterion=criterion,
    )


def fourier_differentiated(
    recording: Recording, period: float, harmonics: int | None = None
) -> Recording:
    """Return the recording with the motion of its `fourier_fit`.

    Position, velocity and acceleration all come of the recorded position.  Look at the
    fit's residual first: what does not repeat, as the way to the start of the motion,
    is not in the series, and belongs cut off.

    Raises
    ------
    RecordingError
        As `fourier_fit`, or as `require_repeating`.
    """
    fit = fourier_fit(recording, period, harmonics)
    require_repeating(recording, fit)
    q, dq, ddq = fit.evaluate(recording.time)
    return replace(recording, position=q, velocity=dq, acceleration=ddq)


def require_repeating(recording: Recording, fit: FourierFit) -> None:
    """Refuse a series that misses much of the motion: its derivatives are worse still.

    Raises
    ------
    RecordingError
        If it leaves more than a tenth of the root-mean-square motion of all joints.
    """
    motion = float(np.linalg.norm(recording.position.std(axis=0)))
    left = float(np.linalg.norm(fit.residual))
    if left > _MISSED * motion:
        raise RecordingError(
            f"{recording.name}: a series with {fit.harmonics} harmonics of "
            f"{fit.period:g} s leaves {left / motion:.0%} of the motion. Is the period "
            "another (estimated_period finds it), or does a part not repeat (trim it)? "
            "Motion without a period is for a filter or the smoother"
        )


def series_columns(time: Vector, period: float, harmonics: int) -> Matrix:
    """Return 1, then sine and cosine of each harmonic, a column each."""
    angles = np.outer(2.0 * np.pi / period * time, np.arange(1, harmonics + 1))
    columns = np.ones((len(time), 2 * harmonics + 1))
    columns[:, 1::2], columns[:, 2::2] = np.sin(angles), np.cos(angles)
    return columns
