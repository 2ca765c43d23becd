"""How sure each parameter of the constrained estimate is, and what determines it.

Three answers side by side: the standard error, of scatter on the active constraints and
of the prior's bias together; the bootstrap's interval; and the 95 % interval among all
consistent robots.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.threads import single_threaded
from consistent_id.comparison.floating_blocks import FloatingBlocks, floating_blocks
from consistent_id.comparison.intervals import ConsistentIntervals, consistent_intervals
from consistent_id.comparison.parameter_shifts import (
    ParameterShifts,
    parameter_shifts,
)
from consistent_id.comparison.recording_scatter import (
    RecordingScatter,
    recording_scatter,
)
from consistent_id.comparison.segment_bootstrap import Bootstrap, bootstrap
from consistent_id.comparison.sensitivity import (
    covariance,
    segment_scores,
    shift_scores,
    white_scores,
)
from consistent_id.constraints import Constraint
from consistent_id.constraints.priors import Prior
from consistent_id.errors import ProblemError
from consistent_id.estimation.constrained import DEFAULT_CONSTRAINTS
from consistent_id.estimation.constrained_fit import ConstrainedFit, constrained_fit
from consistent_id.estimation.determination import determinations
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import ResidualNoise, residual_noise
from consistent_id.regression.segments import lengthened, merged
from consistent_id.robot.parameters import did_you_mean

NORMAL = 1.96
"""Standard errors either way that hold 95 % if their number of data is large."""
LONG = 10.0
"""Length of a segment, in correlation lengths, from which on segments are independent:
their scatter then shows the noise, whatever it is like."""
FEW = 10
"""Degrees of freedom below which segments are called few: the quantile for 95 % is
then above 2.2, and standard errors are off by a fifth or more."""


@dataclass(frozen=True, slots=True)
class ParameterUncertainty:
    """What is known of one parameter.

    Parameters
    ----------
    value : float
        Of the constrained estimate.
    standard_error : float
        Root of the sum of squared scatter (see `sensitivity`, and `RecordingScatter`)
        and squared `prior_shift`; NaN where the verdict says that the value is not
        known by it.
    prior_shift : float
        How far the prior moved the parameter from the best fit: its bias.
    resampled : tuple of float
        Central 95 % of the bootstrap's estimates.
    consistent : tuple of float
        Least and largest value of any consistent robot that fits nearly best.
    verdict : str
        What determines it; see `determinations`.
    between_recordings : float
        Standard deviation of the parameter between recordings, beyond noise; NaN where
        the data do not see it, or there is only one recording.
    """

    name: str
    unit: str
    value: float
    standard_error: float
    prior_shift: float
    resampled: tuple[float, float]
    consistent: tuple[float, float]
    verdict: str
    between_recordings: float = np.nan


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """What is known of all parameters, and how it was found.

    `scatter` says what standard errors rest on, and `recordings` what recordings differ
    by; None of one recording, or of several that do not tell by themselves.  `blocks`
    is what parameters of a floating base's one recording differ by between its blocks,
    and `quantile` of the standard errors either way hold 95 %.  `shifts` is what things
    taken for granted move.
    """

    parameters: tuple[ParameterUncertainty, ...]
    bootstrap: Bootstrap
    intervals: ConsistentIntervals
    scatter: str = ""
    recordings: RecordingScatter | None = None
    blocks: FloatingBlocks | None = None
    quantile: float = NORMAL
    shifts: ParameterShifts | None = None

    def __getitem__(self, name: str) -> ParameterUncertainty:
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        near = did_you_mean(name, [p.name for p in self.parameters])
        raise ProblemError(f"no parameter {name!r}; {near}")

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers and text; None for what is not finite."""
        resampled = self.bootstrap
        return {
            "parameters": [_plain(asdict(p)) for p in self.parameters],
            "bootstrap": {
                "estimates": len(resampled.estimates),
                "certified": resampled.certified,
                "failed": resampled.failed,
                "interrupted": resampled.interrupted,
            },
            "slack": self.intervals.slack,
            "level": self.intervals.level,
            "scatter": self.scatter,
            "quantile": self.quantile,
            "recordings": 1 if self.recordings is None else self.recordings.recordings,
        }


@single_threaded
def uncertainty(
    model: TorqueModel,
    segments: Sequence[Regression],
    *,
    constraints: Sequence[Constraint] = DEFAULT_CONSTRAINTS,
    prior: Prior | None = None,
    base: BaseParameters | None = None,
    slack: float | None = None,
    replicates: int = 200,
    seed: int = 0,
    progress: bool = False,
    sources: Sequence[int] | None = None,
    variants: Sequence[Regression] = (),
) -> Uncertainty:
    """Say how sure the constrained estimate's parameters are.

    Parameters
    ----------
    model : TorqueModel
    segments : sequence of Regression
        See `segment_regressions`; their `sigma` are the weights.
    constraints, prior, base
        See `constrained_least_squares`.
    slack : float, optional
        See `consistent_intervals`.
    replicates, seed, progress
        See `bootstrap`.
    sources : sequence of int, optional
        The recording that each segment is from; see `segment_sources`.  By default all
        are from one.
    variants : sequence of Regression
        Of the same recordings, each with one thing that is taken for granted changed
        by its standard error, such as where feet touch: what it moves is added to
        standard errors and to intervals of consistent robots.

    Returns
    -------
    Uncertainty
        One answer for each parameter, in the layout's order.

    Raises
    ------
    ProblemError, InfeasibleError, NotExcitedError, SolverError
        See the functions named.
    """
    base = base_parameters(model) if base is None else base
    sources = [0] * len(segments) if sources is None else list(sources)
    whole = merged(segments)
    fitted = constrained_fit(model, whole, constraints, prior, base)
    noise = residual_noise(whole, base)
    parts = _by_source(segments, sources)
    segments, sources = _long_enough(segments, sources, LONG * noise.length)
    scores = _scores(fitted, segments, sources, whole, base, noise)
    recordings = recording_scatter(parts, base)
    variance = np.diag(covariance(fitted, scores.rows))
    between = np.full(len(variance), np.nan)
    if recordings is not None:
        noise = recordings.added_to(noise, parts, base)
        variance = variance + _moved(fitted, parts, base, recordings)
        between = _root(_moved(fitted, [whole], base, recordings))
    blocks = None
    if recordings is None and model.robot.floating:
        blocks = floating_blocks(model, segments, constraints, base)
    if blocks is not None:
        variance = variance + blocks.variance
        scores = scores.beside(blocks)
    shifts = parameter_shifts(model, whole, variants, constraints)
    if shifts is not None:
        variance = variance + shifts.variance
        scores = scores.beside(shifts)
    resampled = bootstrap(
        model,
        segments,
        constraints=constraints,
        prior=prior,
        base=base,
        replicates=replicates,
        seed=seed,
        progress=progress,
    )
    intervals = consistent_intervals(
        model,
        whole,
        constraints=constraints,
        slack=slack,
        base=base,
        noise=noise,
        blocks=blocks,
        shifts=shifts,
    )
    verdicts = determinations(
        model,
        whole,
        base,
        noise,
        fitted.parameters,
        known=fitted.best.scaled.constraints.A_eq,
        elsewhere="prior",
        width=intervals.width,
    )
    return Uncertainty(
        parameters=_stated(
            model, fitted, variance, between, resampled, intervals, verdicts
        ),
        bootstrap=resampled,
        intervals=intervals,
        scatter=scores.sentence,
        recordings=recordings,
        blocks=blocks,
        quantile=scores.quantile,
        shifts=shifts,
    )


def _moved(
    fitted: ConstrainedFit,
    parts: Sequence[Regression],
    base: BaseParameters,
    recordings: RecordingScatter,
) -> Vector:
    """Return each parameter's variance as the scatter of recordings moves it."""
    scores = shift_scores(fitted, parts, base, recordings.deviations)
    return np.diag(covariance(fitted, scores))


def _root(variance: Vector) -> Vector:
    """Return standard deviations; rounding may leave a variance below zero."""
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _stated(
    model: TorqueModel,
    fitted: ConstrainedFit,
    variance: Vector,
    between: Vector,
    resampled: Bootstrap,
    intervals: ConsistentIntervals,
    verdicts: Sequence[str],
) -> tuple[ParameterUncertainty, ...]:
    """Return what is said of each parameter: errors only where they are known."""
    shift = abs(fitted.parameters - fitted.best.parameters)
    errors = np.hypot(_root(variance), shift)
    known = np.array([v in ("data", "constraint") for v in verdicts])
    seen = known | np.array([v == "loose" for v in verdicts])
    layout = model.layout
    return tuple(
        ParameterUncertainty(name, unit, x, e, d, tuple(b), tuple(c), v, r)
        for name, unit, x, e, d, b, c, v, r in zip(
            layout.names,
            layout.units,
            fitted.parameters.tolist(),
            np.where(known, errors, np.nan).tolist(),
            np.where(known, shift, np.nan).tolist(),
            resampled.interval().tolist(),
            intervals.bounds.tolist(),
            verdicts,
            np.where(seen, between, np.nan).tolist(),
            strict=True,
        )
    )


def _by_source(
    segments: Sequence[Regression], sources: Sequence[int]
) -> list[Regression]:
    """Return the regression of each recording."""
    return [
        merged([s for s, k in zip(segments, sources, strict=True) if k == source])
        for source in dict.fromkeys(sources)
    ]


def _long_enough(
    segments: Sequence[Regression], sources: Sequence[int], least: Vector
) -> tuple[Sequence[Regression], Sequence[int]]:
    """Join segments until they are long, if two or more are left."""
    joined = lengthened(segments, sources, least)
    return joined if len(joined[0]) > 1 else (segments, sources)


class _Scores(NamedTuple):
    """Factor of the scores' covariance, and where it comes from."""

    rows: Matrix
    sentence: str
    quantile: float = NORMAL

    def beside(self, more: FloatingBlocks | ParameterShifts) -> "_Scores":
        """Say what else is added."""
        quantile = self.quantile
        if isinstance(more, FloatingBlocks):
            quantile = max(quantile, more.scatter.quantile)
        return self._replace(
            sentence=f"{self.sentence}. {more.sentence}", quantile=quantile
        )


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


def _plain(record: dict[str, Any]) -> dict[str, Any]:
    def finite(value: Any) -> Any:
        if isinstance(value, tuple):
            return [finite(v) for v in value]
        return None if isinstance(value, float) and not np.isfinite(value) else value

    return {key: finite(value) for key, value in record.items()}
