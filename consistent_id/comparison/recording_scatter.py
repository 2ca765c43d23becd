"""How much base parameters differ between recordings, beyond noise: a random effect.

Friction changes with temperature, a load is gripped anew, and what the model lacks is
not alike in two motions.  Of recording ``k`` least squares gives ``x_k`` with variance
``s_k^2`` by its own noise.  If ``Q = sum_k (x_k - mean)^2 / s_k^2`` is larger than the
``K - 1`` that noise explains, the recordings' parameters scatter with a variance

``tau^2 = (Q - (K - 1)) / (sum w - sum w^2 / sum w)``,  ``w_k = 1 / s_k^2``

[DerSimonian1986]_.  With few recordings each parameter's ``Q / (K - 1)`` is itself a
guess; so it is drawn towards that of all parameters, the more so the more alike these
are [Smyth2004]_.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.linear import solve_linear
from consistent_id.regression.regression import Regression
from consistent_id.regression.residual_noise import ResidualNoise, residual_noise

_LEAST = 1e-12  # ratio of variances below which its logarithm says no more
_ALIKE = 1e3  # degrees of freedom from which on parameters count as all alike
_SINGLE = 3  # parameters, fewer of which have nothing in common


@dataclass(frozen=True, slots=True, eq=False)
class RecordingScatter:
    """What recordings of one robot differ by.

    Parameters
    ----------
    recordings : int
        How many determine all base parameters by themselves.
    deviations : ndarray, shape (base,)
        Standard deviation of each base parameter between recordings; zero where noise
        explains the differences.
    freedom : float
        Degrees of freedom of these.
    """

    recordings: int
    deviations: Vector
    freedom: float

    def added_to(
        self, noise: ResidualNoise, parts: Sequence[Regression], base: BaseParameters
    ) -> ResidualNoise:
        """Return the noise of all recordings together with what their scatter adds.

        A recording whose parameters are shifted by ``b`` moves the estimate of all by
        ``(A^T A)^-1 A_k^T A_k b``.
        """
        rows = []
        for part in parts:
            A = part.stacked()[:, list(base.independent)]
            rows.append(self.deviations[:, None] * (A.T @ (A @ noise.steps)))
        moves = np.vstack(rows)
        return replace(noise, between=moves.T @ moves, between_freedom=self.freedom)


def recording_scatter(
    parts: Sequence[Regression], base: BaseParameters
) -> RecordingScatter | None:
    """Find the scatter between recordings; None if fewer than two tell.

    Parameters
    ----------
    parts : sequence of Regression
        One of each recording.
    """
    columns = list(base.independent)
    values, variances = [], []
    for part in parts:
        R = part.stacked()
        solution = solve_linear(R[:, columns], R[:, -1])
        noise = residual_noise(part, base)
        if solution.rank < len(base) or noise.freedom <= 0.0:
            continue
        values.append(solution.x)
        variances.append(np.diag(noise.steps @ noise.inflation @ noise.steps.T))
    if len(values) < 2:
        return None
    x, w = np.array(values), 1.0 / np.array(variances)
    spread = excess(x, w)
    tau2 = np.maximum(spread.ratio - 1.0, 0.0) * spread.unit
    return RecordingScatter(len(x), np.sqrt(tau2), spread.freedom)


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Observed variance over that of noise, and what one more of it is worth."""

    ratio: Vector
    unit: Vector
    freedom: float


def excess(x: Array, w: Array) -> Spread:
    """Return how far values scatter beyond their noise.

    Parameters
    ----------
    x : ndarray, shape (groups, parameters)
    w : ndarray, shape (groups, parameters)
        One over the variance of each by noise.
    """
    count = len(x) - 1
    total = w.sum(axis=0)
    mean = (w * x).sum(axis=0) / total
    ratio = (w * (x - mean) ** 2).sum(axis=0) / count
    unit = count / (total - (w**2).sum(axis=0) / total)
    common = _common(ratio, count)
    if np.isinf(common.freedom):
        return Spread(np.full(len(ratio), common.ratio), unit, _ALIKE)
    freedom = common.freedom + count
    drawn = (common.freedom * common.ratio + count * ratio) / freedom
    return Spread(drawn, unit, freedom)


@dataclass(frozen=True, slots=True)
class _Common:
    """What the ratios of all parameters have in common, worth `freedom` recordings."""

    ratio: float
    freedom: float


def _common(ratios: Vector, count: int) -> _Common:
    """Fit a scaled F distribution to ratios by the moments of their logarithms."""
    from scipy.special import digamma, polygamma

    if len(ratios) < _SINGLE:
        return _Common(1.0, 0.0)
    half = count / 2.0
    z = np.log(np.maximum(ratios, _LEAST)) - digamma(half) + np.log(half)
    left = float(z.var(ddof=1) - polygamma(1, half))
    if left <= float(polygamma(1, _ALIKE / 2.0)):
        return _Common(float(np.exp(z.mean())), np.inf)
    prior = _inverse_trigamma(left)
    return _Common(
        float(np.exp(z.mean() + digamma(prior) - np.log(prior))), 2.0 * prior
    )


def _inverse_trigamma(value: float) -> float:
    """Return ``x`` with ``trigamma(x) = value``."""
    from scipy.optimize import brentq
    from scipy.special import polygamma

    # 1/x + 1/(2 x^2) < trigamma(x) < 1/x + 1/x^2
    low, high = 0.5 / value, 0.5 / value
    while polygamma(1, low) < value:
        low /= 2.0
    while polygamma(1, high) > value:
        high *= 2.0
    return float(brentq(lambda x: float(polygamma(1, x)) - value, low, high))
