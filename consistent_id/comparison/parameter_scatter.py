"""What standard errors of parameters rest on: scatter of segments, recordings, blocks.

Segments that are long show the noise, whatever it is like; shorter ones count as noise
of so many effective samples.  What recordings, blocks of a floating base's motion, and
changes of what is taken for granted add comes beside.
"""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.comparison.floating_blocks import FloatingBlocks, floating_blocks
from consistent_id.comparison.parameter_shifts import ParameterShifts, parameter_shifts
from consistent_id.comparison.recording_scatter import (
    RecordingScatter,
    recording_scatter,
)
from consistent_id.comparison.sensitivity import (
    covariance,
    segment_scores,
    shift_scores,
    white_scores,
)
from consistent_id.constraints import Constraint
from consistent_id.estimation.constrained_fit import ConstrainedFit
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import ResidualNoise
from consistent_id.regression.segments import lengthened, merged

NORMAL = 1.96
"""Standard errors either way that hold 95 % if their number of data is large."""
LONG = 10.0
"""Length of a segment, in correlation lengths, from which on segments are independent:
their scatter then shows the noise, whatever it is like."""
FEW = 10
"""Degrees of freedom below which segments are called few: the quantile for 95 % is
then above 2.2, and standard errors are off by a fifth or more."""


class ParameterScatter(NamedTuple):
    """Variances of parameters, and what they are of.

    Parameters
    ----------
    variance : ndarray, shape (parameters,)
    between : ndarray, shape (parameters,)
        Standard deviation between recordings; NaN of one.
    noise : ResidualNoise
        With what recordings differ by.
    sentence : str
        What standard errors rest on.
    quantile : float
        So many of them either way hold 95 %.
    """

    variance: Vector
    between: Vector
    noise: ResidualNoise
    sentence: str
    quantile: float
    recordings: RecordingScatter | None
    blocks: FloatingBlocks | None = None
    shifts: ParameterShifts | None = None

    def with_blocks(self, blocks: FloatingBlocks | None) -> "ParameterScatter":
        """Add what blocks of one recording differ by."""
        if blocks is None:
            return self
        quantile = max(self.quantile, blocks.scatter.quantile)
        return self._beside(blocks)._replace(blocks=blocks, quantile=quantile)

    def with_shifts(self, shifts: ParameterShifts | None) -> "ParameterScatter":
        """Add what things taken for granted move."""
        return self if shifts is None else self._beside(shifts)._replace(shifts=shifts)

    def _beside(self, more: FloatingBlocks | ParameterShifts) -> "ParameterScatter":
        return self._replace(
            variance=self.variance + more.variance,
            sentence=f"{self.sentence}. {more.sentence}",
        )


def parameter_scatter(
    model: TorqueModel,
    fitted: ConstrainedFit,
    segments: Sequence[Regression],
    sources: Sequence[int],
    constraints: Sequence[Constraint],
    base: BaseParameters,
    noise: ResidualNoise,
    variants: Sequence[Regression],
) -> ParameterScatter:
    """Say how parameters scatter; arguments as of `uncertainty`, the fit is of all.

    Segments are joined where they are short; see `long_enough`.
    """
    whole, parts = merged(segments), _by_source(segments, sources)
    long, of_long = long_enough(segments, sources, noise)
    scores = _scores(fitted, long, of_long, whole, base, noise)
    variance = np.diag(covariance(fitted, scores.rows))
    between = np.full(len(variance), np.nan)
    recordings = recording_scatter(parts, base)
    if recordings is not None:
        noise = recordings.added_to(noise, parts, base)
        variance = variance + _moved(fitted, parts, base, recordings)
        between = root(_moved(fitted, [whole], base, recordings))
    found = ParameterScatter(
        variance, between, noise, scores.sentence, scores.quantile, recordings
    )
    if recordings is None and model.robot.floating:
        found = found.with_blocks(floating_blocks(model, long, constraints, base))
    return found.with_shifts(parameter_shifts(model, whole, variants, constraints))


def _moved(
    fitted: ConstrainedFit,
    parts: Sequence[Regression],
    base: BaseParameters,
    recordings: RecordingScatter,
) -> Vector:
    """Return each parameter's variance as the scatter of recordings moves it."""
    scores = shift_scores(fitted, parts, base, recordings.deviations)
    return np.diag(covariance(fitted, scores))


def root(variance: Vector) -> Vector:
    """Return standard deviations; rounding may leave a variance below zero."""
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _by_source(
    segments: Sequence[Regression], sources: Sequence[int]
) -> list[Regression]:
    """Return the regression of each recording."""
    return [
        merged([s for s, k in zip(segments, sources, strict=True) if k == source])
        for source in dict.fromkeys(sources)
    ]


def long_enough(
    segments: Sequence[Regression], sources: Sequence[int], noise: ResidualNoise
) -> tuple[Sequence[Regression], Sequence[int]]:
    """Join segments until they are long, if two or more are left."""
    joined = lengthened(segments, sources, LONG * noise.length)
    return joined if len(joined[0]) > 1 else (segments, sources)


class _Scores(NamedTuple):
    """Factor of the scores' covariance, and where it comes from."""

    rows: Matrix
    sentence: str
    quantile: float = NORMAL


def _scores(
    fitted: ConstrainedFit,
    segments: Sequence[Regression],
    sources: Sequence[int],
    whole: Regression,
    base: BaseParameters,
    noise: ResidualNoise,
) -> _Scores:
    """Take the scatter between segments where they are long, else effective samples."""
    shortest = np.min([segment.counts for segment in segments], axis=0)
    count = len(segments)
    alone = min(Counter(sources).values()) < 2
    if (shortest >= LONG * noise.length).all() and not alone:
        from scipy.special import stdtrit  # scipy.stats takes a second to import

        freedom = count - len(set(sources))
        t = float(stdtrit(freedom, 0.975))
        few = "; they are few, so that errors are rough" if freedom < FEW else ""
        return _Scores(
            segment_scores(fitted, segments, base, sources),
            f"scatter is that between {count} segments, each {LONG:.0f} correlation "
            f"lengths long or longer: 95 % are {t:.2f} standard errors either way{few}",
            t,
        )
    longest = float(noise.length.max())
    return _Scores(
        white_scores(fitted, whole, base, noise.level),
        f"recordings are shorter than two segments of {LONG:.0f} correlation lengths, "
        f"{longest:.0f} samples each; scatter is that of noise with as much "
        f"correlation: {noise.sentence}. The bootstrap's intervals are too narrow",
    )
