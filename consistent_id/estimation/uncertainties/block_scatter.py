"""Scatter of parameters between recordings, or blocks of one, beyond noise.

Friction changes with temperature, a load is gripped again, and errors of the model
differ between motions.  For recording ``k`` least squares gives ``x_k`` with variance
``s_k^2`` from its own noise.  If ``Q = sum_k (x_k - mean)^2 / s_k^2`` is larger than
the ``K - 1`` that noise explains, the recordings' parameters scatter with a variance

``tau^2 = (Q - (K - 1)) / (sum w - sum w^2 / sum w)``,  ``w_k = 1 / s_k^2``

[DerSimonian1986]_: a random effect.  With few recordings each parameter's
``Q / (K - 1)`` is inaccurate; so it is shrunk towards that of all parameters, more
strongly if these are similar [Smyth2004]_.

`RecordingScatter` contains this for base parameters and recordings, `BlockScatter` for
standard parameters and blocks of one recording, under equalities.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Vector, freeze_arrays
from consistent_id.constraints import Constraint
from consistent_id.errors import NotExcitedError
from consistent_id.estimation.determination import FreeParameters, least_squares
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.linear import DATA_RANK_TOLERANCE
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import (
    ResidualNoise,
    Scatter,
    unconstrained_fit,
)
from consistent_id.regression.segments import merged

BLOCKS = 6
"""Blocks of a training motion; for chirps of 15 s, each contains several reversals."""

ENOUGH = 6
"""Recordings from which intervals contain the truth nearly as often as they state."""

_LEVEL = 0.975  # quantile of intervals of 95 %
_TINY = float(np.finfo(np.float64).tiny)
_FREE = 1e-9  # free part of a parameter that counts as zero
_LEAST = 1e-12  # ratio of variances below which its logarithm is cut off
_NEWTON = 50  # steps at most of the inverse of trigamma; some five are needed
_ALIKE = 1e3  # degrees of freedom above which all parameters have the same ratio
# Squared correlation between parameters where it cannot be known: many parameters have
# two degrees of freedom, so intervals contain the truth in 85 % of cases if all change
# together, and in 98 % if each changes on its own.
_TOGETHER = 0.5
_SINGLE = 3  # least number of parameters for a common ratio


@dataclass(frozen=True, slots=True, eq=False)
class BlockScatter:
    """Parameters that equalities leave free, and their standard errors.

    Parameters
    ----------
    values : array_like, shape (parameters,)
        Values of weighted least squares under equalities, from all blocks.
    noise : array_like, shape (parameters,)
        Standard errors for noise as correlated as the residuals.
    between : array_like, shape (parameters,)
        Standard deviation between blocks, beyond noise.
    freedom : array_like, shape (parameters,)
        Degrees of freedom of `noise`; those of `between` are the blocks' less one.
    """

    names: tuple[str, ...]
    values: Vector
    noise: Vector
    between: Vector
    blocks: int
    freedom: Vector

    def __post_init__(self) -> None:
        shape = (len(self.names),)
        fields = ("values", "noise", "between")
        freeze_arrays(self, dict.fromkeys(fields, shape))
        freeze_arrays(self, {"freedom": shape}, finite=False)

    @property
    def standard_errors(self) -> Vector:
        """Standard errors of the values; the blocks count as samples of the motion."""
        return np.asarray(np.sqrt(self.noise**2 + self.between**2 / self.blocks))

    @property
    def quantiles(self) -> Vector:
        """Standard errors either way for 95 %, shape (parameters,).

        More than 1.96 where errors are those of few blocks [Satterthwaite1946]_.
        """
        return self._quantiles(self.noise**2, self.between**2 / self.blocks)

    def _quantiles(self, by_noise: Vector, of_blocks: Vector) -> Vector:
        """Return the quantiles for the sum of two variances."""
        from scipy.special import stdtrit

        squares = by_noise**2 / self.freedom
        if self.blocks > 1:
            squares = squares + of_blocks**2 / (self.blocks - 1)
        total = (by_noise + of_blocks) ** 2
        finite = squares > _TINY * total
        freedom = np.where(finite, total / np.where(finite, squares, 1.0), np.inf)
        return np.asarray(stdtrit(np.maximum(freedom, 1.0), _LEVEL))

    def widths_for(self, other: "BlockScatter", *, between: bool = True) -> Vector:
        """Return bounds on the errors of another motion's values, in 95 % of cases.

        Parameters
        ----------
        other : BlockScatter
            Values of one block of other motion, with the same parameters.
        between : bool
            Whether the scatter between blocks counts; else noise alone.
        """
        by_noise = self.noise**2 + other.noise**2
        of_blocks = self.between**2 * (1.0 + 1.0 / self.blocks) * between
        error = np.sqrt(by_noise + of_blocks)
        return np.asarray(self._quantiles(by_noise, of_blocks) * error)

    def holds(self, other: "BlockScatter", *, between: bool = True) -> BoolArray:
        """Return whether another motion's values are within `widths_for` it."""
        away = abs(self.values - other.values)
        return np.asarray(away <= self.widths_for(other, between=between))


def block_scatter(
    model: TorqueModel,
    blocks: Sequence[Regression],
    *,
    constraints: Sequence[Constraint] = (),
) -> BlockScatter:
    """Return the scatter of parameters between blocks; for one block, noise alone.

    Parameters
    ----------
    blocks : sequence of Regression
        Blocks of consecutive motion, with one weight for each joint; see
        `segment_regressions`.
    constraints : sequence of Constraint
        Only equalities are used, such as known bodies and equal motors.

    Raises
    ------
    NotExcitedError
        If a block does not determine a parameter that all together determine.
    """
    free = FreeParameters.of(constraints, model)
    together = merged(blocks)
    whole = _fit(together, free)
    parts = [_fit(block, free) for block in blocks]
    shown = np.linalg.norm(free.directions, axis=1) > _FREE
    values, errors = whole.values[shown], whole.errors[shown]
    between = np.zeros(len(values))
    if len(blocks) > 1:
        spread = excess(
            np.array([part.values[shown] for part in parts]),
            np.array([part.errors[shown] ** -2.0 for part in parts]),
        )
        between = np.sqrt(np.maximum(spread.ratio - 1.0, 0.0) * spread.unit)
    names = [n for n, use in zip(model.layout.names, shown, strict=True) if use]
    freedom = _freedom(together, free)[shown]
    return BlockScatter(tuple(names), values, errors, between, len(blocks), freedom)


class _BlockFit(NamedTuple):
    values: Vector
    errors: Vector


def _fit(regression: Regression, free: FreeParameters) -> _BlockFit:
    """Return least squares with equalities, and its errors by correlated noise.

    The noise of a joint is taken to be as correlated for all parameters.
    """
    level = regression.sigma * np.sqrt(regression.correlation)
    white = regression.weighted(level).stacked()
    A, rest = free.reduced(white[:, :-1], white[:, -1])
    scale = np.linalg.norm(A, axis=0)
    # Friction that fades at a low speed leaves 1e-100 of itself in fast motion.
    seen = scale > DATA_RANK_TOLERANCE * scale.max(initial=0.0)
    if not seen.all() or np.linalg.matrix_rank(A / scale) < A.shape[1]:
        raise NotExcitedError(
            "a block of the motion does not determine all free parameters; use fewer "
            "blocks, or fix these parameters"
        )
    values = free.start + free.directions @ least_squares(A, rest)
    return _BlockFit(values, free.moves(A))


def _freedom(regression: Regression, free: FreeParameters) -> Vector:
    """Return the degrees of freedom of each parameter's error.

    Those of its joints' noise levels, by their shares in its variance
    [Satterthwaite1946]_.
    """
    if regression.noise is None:
        return np.full(len(free.directions), np.inf)
    level = regression.sigma * np.sqrt(regression.correlation)
    A = regression.weighted(level).stacked()[:, :-1] @ free.directions
    scale = np.linalg.norm(A, axis=0)
    steps = np.linalg.inv(np.linalg.qr(A / scale, mode="r")) / scale[:, None]
    moves = free.directions @ steps @ steps.T @ free.directions.T
    parts = [
        np.sum(np.square(F[:, :-1] @ moves / s), axis=0)
        for F, s in zip(regression.factors, level, strict=True)
    ]
    shares = np.array(parts) / np.maximum(np.sum(parts, axis=0), _TINY)
    squares = np.sum(shares**2 / regression.noise.freedom[:, None], axis=0)
    return np.asarray(1.0 / np.maximum(squares, _TINY))


@dataclass(frozen=True, slots=True, eq=False)
class RecordingScatter:
    """The scatter between recordings of one robot.

    Parameters
    ----------
    recordings : int
        Number of recordings that determine all base parameters by themselves.
    deviations : ndarray, shape (base,)
        Standard deviation of each base parameter between recordings; zero where noise
        explains the differences.
    kinds : tuple of str, length base
        Kind of each base parameter, see `kinds_of`.
    freedom : dict of str to float
        Degrees of freedom of the deviations, by kind.
    """

    recordings: int
    deviations: Vector
    kinds: tuple[str, ...]
    freedom: Mapping[str, float]

    @property
    def sentence(self) -> str:
        """The number of degrees of freedom by kind, and what is missing if few."""
        each = ", ".join(f"{n:.0f} for {kind}" for kind, n in self.freedom.items())
        few = (
            f"; {self.recordings} recordings hardly show whether these change "
            "together, so intervals may contain the truth in 85 % of cases only: "
            f"record at least {ENOUGH}"
            if self.recordings < ENOUGH
            else ""
        )
        return f"it has degrees of freedom: {each}{few}"

    def added_to(
        self, noise: ResidualNoise, parts: Sequence[Regression], base: BaseParameters
    ) -> ResidualNoise:
        """Return the noise of all recordings, scatter between them included.

        A recording whose parameters are shifted by ``b`` moves the estimate of all by
        ``(A^T A)^-1 A_k^T A_k b``.
        """
        between = []
        for kind, freedom in self.freedom.items():
            own = np.array([each == kind for each in self.kinds])
            rows = []
            for part in parts:
                A = part.stacked()[:, list(base.independent)]
                moves = A[:, own].T @ (A @ noise.steps)
                rows.append(self.deviations[own, None] * moves)
            moves = np.vstack(rows)
            between.append(Scatter(moves.T @ moves, freedom))
        return replace(noise, between=tuple(between), beyond=1.0)


def kinds_of(model: TorqueModel, base: BaseParameters) -> tuple[str, ...]:
    """Return the kind of each base parameter: inertial, friction or other drive.

    It is that of the leading parameter.
    """
    start, terms = model.layout.inertial_size, model.column_terms
    return tuple(
        "inertial"
        if i < start
        else "friction"
        if terms[i - start].friction
        else "other drive terms"
        for i in base.independent
    )


def recording_scatter(
    model: TorqueModel, parts: Sequence[Regression], base: BaseParameters
) -> RecordingScatter | None:
    """Return the scatter between recordings; None if fewer than two determine it.

    Parameters
    ----------
    parts : sequence of Regression
        One of each recording.
    """
    values, variances = [], []
    for part in parts:
        free = unconstrained_fit(part, base)
        noise = free.noise
        if free.solution.rank < len(base) or noise.freedom <= 0.0:
            continue
        values.append(free.solution.x)
        variances.append(np.diag(noise.steps @ noise.inflation @ noise.steps.T))
    if len(values) < 2:
        return None
    x, w = np.array(values), 1.0 / np.array(variances)
    kinds, freedom = kinds_of(model, base), {}
    deviations = np.zeros(len(base))
    for kind in dict.fromkeys(kinds):
        own = np.array([each == kind for each in kinds])
        spread = excess(x[:, own], w[:, own])
        tau2 = np.maximum(spread.ratio - 1.0, 0.0) * spread.unit
        deviations[own], freedom[kind] = np.sqrt(tau2), spread.freedom
    return RecordingScatter(len(x), deviations, kinds, freedom)


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Observed variance over that of noise, and its scale."""

    ratio: Vector
    unit: Vector
    freedom: float


def excess(x: Array, w: Array) -> Spread:
    """Return the scatter of values beyond their noise.

    The parameters' ratios are shrunk towards a common one.  Together they cannot have
    more degrees of freedom than `_independent` of them, each with its own.

    Parameters
    ----------
    x : ndarray, shape (groups, parameters)
    w : ndarray, shape (groups, parameters)
        One over the variance of each by noise.
    """
    count = len(x) - 1
    total = w.sum(axis=0)
    off = np.sqrt(w) * (x - (w * x).sum(axis=0) / total)
    ratio = (off**2).sum(axis=0) / count
    unit = count / (total - (w**2).sum(axis=0) / total)
    drawn = shrunk(ratio, count)
    most = count * _independent(off)
    return Spread(drawn.values, unit, min(drawn.freedom, most))


def _independent(off: Array) -> float:
    """Return the number of independent parameters that scatter as much as all.

    The mean of ``n`` squares with correlations ``r`` has the degrees of freedom of
    ``n / (1 + (n - 1) r^2)`` independent ones, ``r^2`` their mean.  Of two groups every
    ``r^2`` is one, by chance or not; `_TOGETHER` is assumed.

    Parameters
    ----------
    off : ndarray, shape (groups, parameters)
        Differences from the mean, over noise.
    """
    n, count = off.shape[1], len(off) - 1
    norms = np.linalg.norm(off, axis=0)
    if n < 2 or not norms.all():
        return float(n)
    if count == 1:
        squared = _TOGETHER
    else:
        r = (off / norms).T @ (off / norms)
        mean = float((np.sum(r**2) - n) / (n * (n - 1)))
        # Independent parameters have 1 / count by chance.
        squared = max((mean * count - 1.0) / (count - 1.0), 0.0)
    return float(n / (1.0 + (n - 1.0) * squared))


class Shrunk(NamedTuple):
    """Estimates of variances, each shrunk towards all, and their degrees of freedom."""

    values: Vector
    freedom: float


def shrunk(variances: Vector, freedom: float) -> Shrunk:
    """Shrink variances towards a common one, the more the more alike [Smyth2004]_.

    Parameters
    ----------
    variances : ndarray, shape (any,)
    freedom : float
        Degrees of freedom of each.
    """
    common = _common(variances, freedom)
    if np.isinf(common.freedom):
        return Shrunk(np.full(len(variances), common.ratio), np.inf)
    total = common.freedom + freedom
    weighted = common.freedom * common.ratio + freedom * variances
    return Shrunk(np.asarray(weighted / total), total)


@dataclass(frozen=True, slots=True)
class _Common:
    """The common ratio of all parameters, with the weight of `freedom` recordings."""

    ratio: float
    freedom: float


def _common(ratios: Vector, count: float) -> _Common:
    """Fit a scaled F distribution to ratios by the moments of their logarithms."""
    from scipy.special import digamma, polygamma

    if len(ratios) < _SINGLE:
        return _Common(1.0, 0.0)
    half = count / 2.0
    z = np.log(np.maximum(ratios, _LEAST)) - digamma(half) + np.log(half)
    left = float(z.var(ddof=1) - polygamma(1, half))
    if left <= float(polygamma(1, _ALIKE / 2.0)):
        return _Common(float(ratios.mean()), np.inf)
    prior = _inverse_trigamma(left)
    return _Common(
        float(np.exp(z.mean() + digamma(prior) - np.log(prior))), 2.0 * prior
    )


def _inverse_trigamma(value: float) -> float:
    """Return ``x`` with ``trigamma(x) = value``.

    Newton's method for ``1 / trigamma``, which is nearly a line and convex, so that it
    converges from above (Smyth 2004); scipy.optimize takes long to import.
    """
    from scipy.special import polygamma

    x = 0.5 + 1.0 / value
    for _ in range(_NEWTON):
        now = float(polygamma(1, x))
        change = now * (1.0 - now / value) / float(polygamma(2, x))
        x += change
        if abs(change) <= 1e-12 * x:
            break
    return x
