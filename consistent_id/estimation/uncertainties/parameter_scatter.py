"""Sources of standard errors: scatter of segments, recordings and blocks.

The scatter between long segments is a valid estimate for any noise; short segments are
treated as noise with a number of effective samples. The scatter between recordings and
between blocks of a floating base's motion, and shifts from assumed values, are added.

A constrained estimate follows the data along its active constraints (`covariance`).  At
the optimum ``u`` of ``1/2 ||M u - z||^2 + weight/2 distance(u)^2`` these leave a
tangent space ``T``: steps that keep equalities, inequalities that are active, and the
rank of each pseudo-inertia, to first order.  This is exact unless an active constraint
has a multiplier of zero.  Along it, with the Hessian ``H`` of the Lagrangian,

``du = T (T^T H T)^-1 T^T ds``  for a change ``ds`` of the scores ``M^T z``

so a covariance ``S`` of the scores becomes one of the parameters [Shapiro1997]_.  ``H``
contains the curvature of a semidefinite block's boundary, ``2 tr(Z dF F^+ dF)``.

If the truth is on the boundary of an inequality, noise makes it active in half of all
data sets, and in the other half the estimate moves freely.  So the mean square error is
the mean of two variances, along the active constraints and under equalities alone
(`variances`); where no inequality is active, they are equal.

All of these are Gram matrices, ``H = A^T A`` and ``S = g^T g``, of which only the
factors are formed: with a weak prior, ``H`` itself would be lost in rounding.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.constraints.cones.sets import SemidefiniteBlock, row_spaces, svec
from consistent_id.errors import ProblemError
from consistent_id.estimation.best_fit import FitProblem, base_factor
from consistent_id.estimation.constrained_fit import (
    ConstrainedFit,
)
from consistent_id.estimation.determination import LinearErrors, linear_errors
from consistent_id.estimation.uncertainties.beyond_noise import (
    FloatingBlocks,
    ParameterShifts,
    ScatterCauses,
    floating_blocks,
    parameter_shifts,
)
from consistent_id.estimation.uncertainties.block_scatter import (
    RecordingScatter,
    recording_scatter,
)
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.residual_noise import ResidualNoise, half_widths
from consistent_id.regression.segments import lengthened, merged

LONG = 10.0
"""Length of a segment, in correlation lengths, from which segments are independent:
their scatter is then a valid estimate for any noise.
"""

FEW = 10
"""Degrees of freedom below which segments are called few: the quantile for 95 % is then
above 2.2, and the error of standard errors is a fifth or more.
"""

_ACTIVE = 1e-6  # slack or eigenvalue, of typical parameters, that counts as zero


class ParameterScatter(NamedTuple):
    """Variances of parameters, and their sources.

    Parameters
    ----------
    variance : ndarray, shape (parameters,)
    between : ndarray, shape (parameters,)
        Standard deviation between recordings; NaN for one.
    noise : ResidualNoise
        Noise, scatter between recordings included.
    sentence : str
        The sources of standard errors, in words.
    freedoms : ndarray, shape (parameters,)
        Degrees of freedom of each variance.
    errors : LinearErrors
        Errors in least squares, under the equalities.
    """

    variance: Vector
    between: Vector
    noise: ResidualNoise
    sentence: str
    freedoms: Vector
    errors: LinearErrors
    recordings: RecordingScatter | None
    blocks: FloatingBlocks | None = None
    shifts: ParameterShifts | None = None

    @property
    def quantiles(self) -> Vector:
        """Standard errors either way of 95 % intervals: Student's quantiles."""
        return half_widths(self.freedoms)

    @property
    def causes(self) -> ScatterCauses:
        """Noise and what is beyond it, for intervals."""
        return ScatterCauses(self.noise, self.blocks, self.shifts)

    def with_blocks(self, blocks: FloatingBlocks | None) -> "ParameterScatter":
        """Add the scatter between blocks of one recording."""
        if blocks is None:
            return self
        # As if the scatter between blocks were all of it.
        freedoms = np.full(len(self.variance), max(blocks.freedom, 1.0))
        return self._beside(blocks)._replace(blocks=blocks, freedoms=freedoms)

    def with_shifts(self, shifts: ParameterShifts | None) -> "ParameterScatter":
        """Add shifts from errors of assumed values."""
        if shifts is None:
            return self
        return self._beside(shifts)._replace(shifts=shifts)

    def _beside(self, more: FloatingBlocks | ParameterShifts) -> "ParameterScatter":
        return self._replace(
            variance=self.variance + more.variance,
            sentence=f"{self.sentence}. {more.sentence}",
        )


class Segments(NamedTuple):
    """The data in segments, and the recording that each is from.

    Parameters
    ----------
    regressions : sequence of Regression
        In the order of time.
    sources : sequence of int
        The recording of each.
    """

    regressions: Sequence[Regression]
    sources: Sequence[int]

    @property
    def by_source(self) -> list[Regression]:
        """The regression of each recording."""
        pairs = list(zip(self.regressions, self.sources, strict=True))
        return [
            merged([s for s, k in pairs if k == source])
            for source in dict.fromkeys(self.sources)
        ]

    def long_enough(self, noise: ResidualNoise) -> "Segments":
        """Join segments until they are long, if at least two remain."""
        joined = lengthened(self.regressions, self.sources, LONG * noise.length)
        return Segments(*joined) if len(joined[0]) > 1 else self


def parameter_scatter(
    problem: FitProblem,
    fitted: ConstrainedFit,
    segments: Segments,
    variants: Sequence[Regression],
) -> ParameterScatter:
    """Say how parameters scatter.

    Parameters
    ----------
    problem : FitProblem
        Problem of all segments together.
    fitted : ConstrainedFit
        Its solution.
    segments : Segments
        Joined where they are short.
    variants : sequence of Regression
        See `uncertainty`.
    """
    model, free = problem.model, problem.free
    whole, base, noise = free.regression, free.base, free.noise
    parts, long = segments.by_source, segments.long_enough(noise)
    # Blocks of a floating base's motion show what lasts as long as they do: of noise,
    # its level counts besides.
    rows = (
        white_scores(fitted, whole, base, noise.level)
        if model.robot.floating
        else noise_scores(fitted, noise)
    )
    scores = _scores(fitted, long, base, noise, rows)
    variance = variances(fitted, scores.rows)
    between = np.full(len(variance), np.nan)
    recordings = recording_scatter(model, parts, base)
    if recordings is not None:
        noise = recordings.added_to(noise, parts, base)
        variance = variance + _moved(fitted, parts, base, recordings)
        between = root(_moved(fitted, [whole], base, recordings))
    blocks = None
    if recordings is None and model.robot.floating:
        blocks = floating_blocks(model, long.regressions, problem.constraints, base)
    if blocks is not None:  # they contain what `noise.beyond` would add
        noise = replace(noise, between=(), beyond=1.0)
    elif recordings is None and noise.beyond > 1.0:
        variance = np.maximum(variance, noise.beyond * variances(fitted, rows))
    if noise.shapes is not None:  # shared by all segments and recordings: none shows it
        variance = variance + variances(fitted, shape_scores(fitted, noise))
    known = fitted.best.scaled.constraints.A_eq
    errors = linear_errors(base, noise, known)
    freedoms = errors.freedoms
    if scores.freedom is not None:
        of_segments = noise.with_freedom(scores.freedom)
        freedoms = linear_errors(base, of_segments, known).freedoms
    if blocks is not None:  # `variance` has white noise, too: see `rows`
        noise = noise.white(whole, base)
    found = ParameterScatter(
        variance, between, noise, scores.sentence, freedoms, errors, recordings
    ).with_blocks(blocks)
    shifts = parameter_shifts(model, whole, variants, problem.constraints)
    return found.with_shifts(shifts)


def _moved(
    fitted: ConstrainedFit,
    parts: Sequence[Regression],
    base: BaseParameters,
    recordings: RecordingScatter,
) -> Vector:
    """Return each parameter's variance from the scatter of recordings."""
    scores = shift_scores(fitted, parts, base, recordings.deviations)
    return variances(fitted, scores)


def root(variance: Vector) -> Vector:
    """Return standard deviations; rounding may leave a variance below zero."""
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


class _Scores(NamedTuple):
    """Factor of the scores' covariance, and where it comes from.

    `freedom` is that of the covariance, if segments show it.
    """

    rows: Matrix
    sentence: str
    freedom: float | None = None


def _scores(
    fitted: ConstrainedFit,
    segments: Segments,
    base: BaseParameters,
    noise: ResidualNoise,
    rows: Matrix,
) -> _Scores:
    """Use the scatter between segments if they are long, else `rows` of the noise."""
    parts, sources = segments
    shortest = np.min([part.counts for part in parts], axis=0)
    count = len(parts)
    alone = min(Counter(sources).values()) < 2
    if (shortest >= LONG * noise.length).all() and not alone:
        freedom = count - len(set(sources))
        t = float(half_widths(np.array([freedom]))[0])
        few = (
            "; they are few, so standard errors are inaccurate" if freedom < FEW else ""
        )
        return _Scores(
            segment_scores(fitted, parts, base, sources),
            f"scatter is that between {count} segments, each at least {LONG:.0f} "
            f"correlation lengths long: 95 % intervals are {t:.2f} standard errors "
            f"either way{few}",
            float(freedom),
        )
    longest = float(noise.length.max())
    return _Scores(
        rows,
        f"recordings are shorter than two segments of {LONG:.0f} correlation "
        f"lengths, {longest:.0f} samples each; scatter is computed from correlated "
        f"noise: {noise.sentence}. The bootstrap's intervals are too narrow",
    )


def variances(fitted: ConstrainedFit, scores: Matrix) -> Vector:
    """Return the parameters' variances, by chance along active inequalities or not.

    The means of those along the active constraints and under equalities alone.

    Parameters
    ----------
    scores : ndarray, shape (rows, parameters)
        See `covariance`.
    """
    both = [np.diag(covariance(fitted, scores, active=a)) for a in (True, False)]
    return np.asarray(np.mean(both, axis=0))


def active_ratios(fitted: ConstrainedFit, noise: ResidualNoise) -> Vector:
    """Return standard errors along active inequalities over those without them.

    Shape (parameters,), at most one, and exactly one where no inequality is active:
    the prior is in both.
    """
    scores = noise_scores(fitted, noise)
    along, free = (np.diag(covariance(fitted, scores, active=a)) for a in (True, False))
    moves = free > 0.0
    ratio = np.where(moves, along, 1.0) / np.where(moves, free, 1.0)
    return np.asarray(np.sqrt(np.clip(ratio, 0.0, 1.0)))


def covariance(
    fitted: ConstrainedFit, scores: Matrix, *, active: bool = True
) -> Matrix:
    """Return the covariance of a constrained estimate's parameters.

    Parameters
    ----------
    scores : ndarray, shape (rows, parameters)
        Factor ``g`` of the scores' covariance ``g^T g``; see `noise_scores` and
        `segment_scores`.
    active : bool
        Whether active inequalities stay so; else only equalities are kept.

    Returns
    -------
    ndarray, shape (parameters, parameters)
        In original units.  For parameters that the prior determines, it is the
        estimate's scatter, not its error: a strong prior hardly moves.
    """
    root = _response_root(fitted, active=active)
    moves = (root @ (root.T @ scores.T)) * fitted.best.scaled.unit[:, None]
    return np.asarray(moves @ moves.T)


def noise_scores(fitted: ConstrainedFit, noise: ResidualNoise) -> Matrix:
    """Return a factor of the scores' covariance for noise as it is correlated.

    Errors of the model, `ResidualNoise.between`, are not in it.

    Returns
    -------
    ndarray, shape (rows, parameters)
    """
    return _in_parameters(fitted, noise, np.vstack(noise.of_joints))


def shape_scores(fitted: ConstrainedFit, noise: ResidualNoise) -> Matrix:
    """Return a factor of the scores' covariance for errors of shapes of friction.

    Returns
    -------
    ndarray, shape (shapes, parameters)
    """
    rows = np.zeros((0, noise.rank)) if noise.shapes is None else noise.shapes
    return _in_parameters(fitted, noise, rows)


def _in_parameters(
    fitted: ConstrainedFit, noise: ResidualNoise, scores: Matrix
) -> Matrix:
    scaled = fitted.best.scaled
    rows = scores @ noise.coordinates
    return np.asarray(rows / scaled.size**2 @ scaled.projection)


def white_scores(
    fitted: ConstrainedFit, regression: Regression, base: BaseParameters, sigma: Vector
) -> Matrix:
    """Return a factor of the scores' covariance for white noise of each joint.

    Parameters
    ----------
    sigma : ndarray, shape (joints,), [N m or N]
        Standard deviation of each joint's noise.

    Returns
    -------
    ndarray, shape (rows, parameters)
    """
    scaled, columns = fitted.best.scaled, list(base.independent)
    rows = [
        factor[:, columns] * (noise / weight**2 / scaled.size**2)
        for factor, weight, noise in zip(
            regression.factors, regression.sigma, sigma, strict=True
        )
    ]
    return np.asarray(np.vstack(rows) @ scaled.projection)


def shift_scores(
    fitted: ConstrainedFit,
    parts: Sequence[Regression],
    base: BaseParameters,
    deviations: Vector,
) -> Matrix:
    """Return a factor of the scores' covariance for shifts of the base parameters.

    Parameters
    ----------
    parts : sequence of Regression
        Data with separate shifts of their parameters.
    deviations : ndarray, shape (base,)
        Standard deviation of the shifts.

    Returns
    -------
    ndarray, shape (rows, parameters)
    """
    scaled = fitted.best.scaled
    rows = []
    for part in parts:
        A = base_factor(part, base)[:, :-1] / scaled.size
        rows.append(deviations[:, None] * (A.T @ A))
    return np.asarray(np.vstack(rows) @ scaled.projection)


def segment_scores(
    fitted: ConstrainedFit,
    segments: Sequence[Regression],
    base: BaseParameters,
    sources: Sequence[int] | None = None,
) -> Matrix:
    """Return a factor of the scores' covariance, from their scatter between segments.

    The covariance is ``k / (k - 1) sum_s g_s g_s^T`` with ``g_s`` the gradient of
    segment ``s`` of ``k``, less their mean: robust to correlation within segments and
    to noise that varies.  If they are from several recordings (`sources`), it is the
    sum over these, each with its own mean.

    Returns
    -------
    ndarray, shape (segments, parameters)

    Raises
    ------
    ProblemError
        If there are fewer than two segments.
    """
    if len(segments) < 2:
        raise ProblemError(f"{len(segments)} segments, expected 2 or more")
    scaled, u = fitted.best.scaled, fitted.final.solution.u
    gradients = []
    for segment in segments:
        part = scaled.with_factor(base_factor(segment, base))
        gradients.append(part.M.T @ (part.M @ u - part.z))
    g = np.array(gradients)
    owners = np.zeros(len(g)) if sources is None else np.asarray(sources)
    for owner in np.unique(owners):
        own, k = owners == owner, int(np.sum(owners == owner))
        g[own] = (g[own] - g[own].mean(axis=0)) * np.sqrt(k / max(k - 1, 1))
    return g


def _response_root(fitted: ConstrainedFit, *, active: bool = True) -> Matrix:
    """Return ``B`` with ``B B^T = T (T^T H T)^-1 T^T``."""
    scaled, fit = fitted.best.scaled, fitted.final
    u, multipliers = fit.solution.u, fit.solution.multipliers
    rows = [scaled.M, np.sqrt(fit.weight) * fitted.distance.local(u).G]
    domain = scaled.domain
    kept = [domain.A_eq]
    if active:
        slack = domain.b_in - domain.A_in @ u
        kept.append(domain.A_in[slack <= _ACTIVE])
        for block, Z in zip(domain.blocks, multipliers.blocks, strict=True):
            level, bent = _surface(block, Z, u)
            kept.append(level)
            rows.append(bent)
    T = row_spaces(np.vstack(kept)).steps
    _, R = np.linalg.qr(np.vstack(rows) @ T)
    return np.asarray(np.linalg.solve(R.T, T.T).T)


def _surface(block: SemidefiniteBlock, Z: Matrix, u: Vector) -> tuple[Matrix, Matrix]:
    """Return rows that keep a block's rank, and rows of its surface's curvature."""
    values, vectors = np.linalg.eigh(block.value(u))
    touching = values <= _ACTIVE
    null, rest = vectors[:, touching], vectors[:, ~touching]
    kept = svec(null.T @ block.coefficients @ null).T
    # 2 tr(Z A_i F^+ A_j) with Z = N N^T and F^+ = V V^T: rows sqrt(2) (V^T A_i N).
    weights, turned = np.linalg.eigh(null.T @ Z @ null)
    N = null @ turned * np.sqrt(np.maximum(weights, 0.0))
    V = rest / np.sqrt(values[~touching])
    bent = np.sqrt(2.0) * (V.T @ block.coefficients @ N)
    return kept, bent.reshape(len(bent), -1).T
