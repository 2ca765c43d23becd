"""What torque residuals say of the model: whiteness, drift, what they depend on."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.regression.correlation import correlation_length

BINS = 12
"""Intervals of position or velocity in which residuals are averaged."""

LAGS = 100
"""Least number of lags of an autocorrelation."""


@dataclass(frozen=True, slots=True, eq=False)
class Binned:
    """Residuals averaged over intervals of another quantity with like many samples.

    Parameters
    ----------
    centres, means : ndarray, shape (bins,)
    explained : float
        Share of the residual's variance that the means explain, less what chance
        would; NaN where there are too few independent samples.
    """

    centres: Vector
    means: Vector
    explained: float


@dataclass(frozen=True, slots=True, eq=False)
class ResidualStatistics:
    """Figures of one joint's residual.

    Parameters
    ----------
    rms, mean : float, [N m or N]
    correlation : float
        How many samples carry as much information as one independent one.
    autocorrelation : ndarray, shape (lags + 1,)
        One at lag zero.
    bound : float
        Within which 95 % of a white residual's autocorrelations lie.
    drift, drift_error : float, [N m/min or N/min]
        Slope of a straight line over time and its standard error, which counts
        independent samples only.
    """

    rms: float
    mean: float
    correlation: float
    autocorrelation: Vector
    bound: float
    drift: float
    drift_error: float
    by_position: Binned
    by_velocity: Binned

    @property
    def white_share(self) -> float:
        """Share of the autocorrelations that a white residual's bound holds."""
        return float(np.mean(abs(self.autocorrelation[1:]) <= self.bound))


def residual_statistics(
    residual: Vector, time: Vector, position: Vector, velocity: Vector
) -> ResidualStatistics:
    """Examine one joint's residual.

    Parameters
    ----------
    residual : ndarray, shape (samples,), [N m or N]
    time : ndarray, shape (samples,), [s]
    position, velocity : ndarray, shape (samples,)
        Of the same joint.
    """
    n, rms = len(residual), float(np.sqrt(np.mean(residual**2)))
    centred = residual - residual.mean()
    length = correlation_length([centred], np.array([max(rms, 1e-300)]))
    independent = n / length
    lags = min(max(LAGS, int(2 * length)), n - 1)
    slope, error = _slope(time / 60.0, centred, independent)
    return ResidualStatistics(
        rms=rms,
        mean=float(residual.mean()),
        correlation=length,
        autocorrelation=autocorrelation(centred, lags),
        bound=1.96 / np.sqrt(n),
        drift=slope,
        drift_error=error,
        by_position=binned(residual, position, independent),
        by_velocity=binned(residual, velocity, independent),
    )


def autocorrelation(centred: Vector, lags: int) -> Vector:
    """Return ``sum_t r_t r_(t+k) / sum_t r_t^2`` for lags up to `lags`."""
    size = 2 ** int(np.ceil(np.log2(2 * len(centred))))
    power = abs(np.fft.rfft(centred, size)) ** 2
    sums = np.fft.irfft(power, size)[: lags + 1]
    return np.asarray(sums / max(float(sums[0]), 1e-300))


def binned(residual: Vector, against: Vector, independent: float) -> Binned:
    """Average a residual over intervals of another quantity.

    With ``R^2`` the share of the variance between intervals, the share explained is
    ``1 - (1 - R^2) (n - 1) / (n - bins)``, ``n`` the number of independent samples.
    """
    order = np.argsort(against, kind="stable")
    parts = np.array_split(order, min(BINS, len(order)))
    means = np.array([residual[part].mean() for part in parts])
    centres = np.array([against[part].mean() for part in parts])
    weights = np.array([len(part) for part in parts])
    total = float(np.sum((residual - residual.mean()) ** 2))
    between = float(np.sum(weights * (means - residual.mean()) ** 2))
    free = independent - len(parts)
    if total == 0.0 or free < 1.0:
        return Binned(centres, means, np.nan)
    explained = 1.0 - (1.0 - between / total) * (independent - 1.0) / free
    return Binned(centres, means, max(explained, 0.0))


def _slope(time: Vector, centred: Vector, independent: float) -> tuple[float, float]:
    """Return the slope of a straight line, and its standard error."""
    t = time - time.mean()
    power = float(t @ t)
    slope = float(t @ centred) / power
    rest = centred - slope * t
    # Independent samples spread over the same times: power shrinks as their number.
    variance = float(rest @ rest) / max(independent - 2.0, 1.0)
    return slope, float(np.sqrt(variance / power))
