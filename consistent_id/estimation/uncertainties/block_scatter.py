"""How much parameters differ between recordings, or blocks of one, beyond noise.

Friction changes with temperature, a load is gripped anew, and what the model lacks is
not alike in two motions.  Of recording ``k`` least squares gives ``x_k`` with variance
``s_k^2`` by its own noise.  If ``Q = sum_k (x_k - mean)^2 / s_k^2`` is larger than the
``K - 1`` that noise explains, the recordings' parameters scatter with a variance

``tau^2 = (Q - (K - 1)) / (sum w - sum w^2 / sum w)``,  ``w_k = 1 / s_k^2``

[DerSimonian1986]_: a random effect.  With few recordings each parameter's
``Q / (K - 1)`` is itself a guess; so it is drawn towards that of all parameters, the
more so the more alike these are [Smyth2004]_.

`RecordingScatter` holds this of base parameters and recordings, `BlockScatter` of the
parameters themselves and blocks of one recording, with what equalities fix held.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Vector, freeze_arrays
from consistent_id._support.tables import Table
from consistent_id.constraints import Constraint
from consistent_id.errors import NotExcitedError
from consistent_id.estimation.equalities import FreeParameters, least_squares
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.linear import solve_linear
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import ResidualNoise, residual_noise
from consistent_id.regression.segments import merged

BLOCKS = 6
"""Blocks of a training motion: of chirps of 15 s each has several turns of a joint."""

_LEVEL = 0.975  # quantile of intervals of 95 %
_NORMAL = 1.96
_FREE = 1e-9  # part of a parameter that is free, below which it is none
_LEAST = 1e-12  # ratio of variances below which its logarithm says no more
_ALIKE = 1e3  # degrees of freedom from which on parameters count as all alike
_SINGLE = 3  # parameters, fewer of which have nothing in common


@dataclass(frozen=True, slots=True, eq=False)
class BlockScatter:
    """Parameters that equalities leave free, and how sure they are.

    Parameters
    ----------
    values : array_like, shape (parameters,)
        Of weighted least squares with equalities, of all blocks.
    noise : array_like, shape (parameters,)
        Standard errors by noise as correlated as the residuals are.
    between : array_like, shape (parameters,)
        Standard deviation between blocks, beyond noise.
    """

    names: tuple[str, ...]
    values: Vector
    noise: Vector
    between: Vector
    blocks: int

    def __post_init__(self) -> None:
        shape = (len(self.names),)
        freeze_arrays(self, dict.fromkeys(("values", "noise", "between"), shape))

    @property
    def standard_errors(self) -> Vector:
        """Standard errors of the values, for motion of which the blocks are samples."""
        return np.asarray(np.sqrt(self.noise**2 + self.between**2 / self.blocks))

    @property
    def quantile(self) -> float:
        """Standard errors either way for 95 %: of few blocks more than 1.96."""
        from scipy.special import stdtrit

        return float(stdtrit(self.blocks - 1, _LEVEL)) if self.blocks > 1 else _NORMAL

    def holds(self, other: "BlockScatter", *, between: bool = True) -> BoolArray:
        """Return whether another motion's values are within 95 % intervals of these.

        Parameters
        ----------
        other : BlockScatter
            Of one block of other motion, with the same parameters.
        between : bool
            Whether intervals contain the scatter between blocks; else noise alone.
        """
        variance = self.noise**2 + other.noise**2
        if between:
            variance = variance + self.between**2 * (1.0 + 1.0 / self.blocks)
        width = self.quantile if between else _NORMAL
        return np.asarray(abs(self.values - other.values) <= width * np.sqrt(variance))

    def to_dict(self) -> dict[str, dict[str, float]]:
        """Return values and errors by name, for JSON."""
        fields = ("values", "noise", "between", "standard_errors")
        return {
            name: {field: float(getattr(self, field)[k]) for field in fields}
            for k, name in enumerate(self.names)
        }

    def table(self) -> Table:
        """Return values and errors for people."""
        return Table(
            f"Parameters and their scatter between {self.blocks} blocks of the motion",
            ("parameter", "value", "by noise", "between blocks", "standard error"),
            tuple(
                (name, f"{x:.4g}", f"{a:.2g}", f"{b:.2g}", f"{s:.2g}")
                for name, x, a, b, s in zip(
                    self.names,
                    self.values,
                    self.noise,
                    self.between,
                    self.standard_errors,
                    strict=True,
                )
            ),
            (
                "values of least squares with the equalities alone",
                "a motion of a block's length of its own may differ by the scatter "
                "between blocks; the standard error is that of their mean, and "
                f"{self.quantile:.2f} of it either way hold 95 %",
            ),
        )


def block_scatter(
    model: TorqueModel,
    blocks: Sequence[Regression],
    *,
    constraints: Sequence[Constraint] = (),
) -> BlockScatter:
    """Find the scatter of parameters between blocks; of one block, noise alone.

    Parameters
    ----------
    blocks : sequence of Regression
        Of consecutive motion, with one weight for each joint; see
        `segment_regressions`.
    constraints : sequence of Constraint
        Of these the equalities count, such as known bodies and equal motors.

    Raises
    ------
    NotExcitedError
        If a block leaves a parameter open that all together determine.
    """
    free = FreeParameters.of(constraints, model)
    whole = _fit(merged(blocks), free)
    parts = [_fit(block, free) for block in blocks]
    shown = np.linalg.norm(free.directions, axis=1) > _FREE
    between = np.zeros(len(shown))
    if len(blocks) > 1:
        spread = excess(
            np.array([part.values[shown] for part in parts]),
            np.array([part.errors[shown] ** -2.0 for part in parts]),
        )
        between[shown] = np.sqrt(np.maximum(spread.ratio - 1.0, 0.0) * spread.unit)
    names = [n for n, use in zip(model.layout.names, shown, strict=True) if use]
    return BlockScatter(
        tuple(names),
        whole.values[shown],
        whole.errors[shown],
        between[shown],
        len(blocks),
    )


class _BlockFit(NamedTuple):
    values: Vector
    errors: Vector


def _fit(regression: Regression, free: FreeParameters) -> _BlockFit:
    """Return least squares with equalities, and its errors by correlated noise."""
    length = np.sqrt(regression.correlation)
    white = regression.weighted(regression.sigma * length).stacked()
    A, rest = free.reduced(white[:, :-1], white[:, -1])
    scale = np.linalg.norm(A, axis=0)
    if not (scale > 0.0).all() or np.linalg.matrix_rank(A / scale) < A.shape[1]:
        raise NotExcitedError(
            "a block of the motion leaves parameters open that are free; take fewer "
            "blocks, or fix these parameters"
        )
    values = free.start + free.directions @ least_squares(A, rest)
    return _BlockFit(values, free.moves(A))


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
