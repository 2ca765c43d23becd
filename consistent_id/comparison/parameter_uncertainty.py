"""How sure each parameter of the constrained estimate is, and what determines it.

Three answers side by side: the standard error, of scatter on the active constraints and
of the prior's bias together; the bootstrap's interval; and the 95 % interval among all
consistent robots.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id._support.threads import single_threaded
from consistent_id.comparison.intervals import ConsistentIntervals, consistent_intervals
from consistent_id.comparison.segment_bootstrap import Bootstrap, bootstrap
from consistent_id.comparison.sensitivity import (
    covariance,
    segment_scores,
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
from consistent_id.regression.segments import merged
from consistent_id.robot.parameters import did_you_mean

LONG = 10.0
"""Length of a segment, in correlation lengths, from which on segments are independent:
their scatter then shows the noise, whatever it is like."""


@dataclass(frozen=True, slots=True)
class ParameterUncertainty:
    """What is known of one parameter.

    Parameters
    ----------
    name, unit : str
    value : float
        Of the constrained estimate.
    standard_error : float
        Root of the sum of squared scatter (see `sensitivity`) and squared
        `prior_shift`; NaN where the verdict says that the value is not known by it.
    prior_shift : float
        How far the prior moved the parameter from the best fit: its bias.
    resampled : tuple of float
        Central 95 % of the bootstrap's estimates.
    consistent : tuple of float
        Least and largest value of any consistent robot that fits nearly best.
    verdict : str
        What determines it; see `determinations`.
    """

    name: str
    unit: str
    value: float
    standard_error: float
    prior_shift: float
    resampled: tuple[float, float]
    consistent: tuple[float, float]
    verdict: str


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """What is known of all parameters, and how it was found.

    `scatter` says what standard errors rest on.
    """

    parameters: tuple[ParameterUncertainty, ...]
    bootstrap: Bootstrap
    intervals: ConsistentIntervals
    scatter: str = ""

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
    whole = merged(segments)
    fitted = constrained_fit(model, whole, constraints, prior, base)
    noise = residual_noise(whole, base)
    scores = _scores(fitted, segments, whole, base, noise)
    scatter = np.diag(covariance(fitted, scores.rows))
    shift = abs(fitted.parameters - fitted.best.parameters)
    errors = np.sqrt(np.maximum(scatter, 0.0) + shift**2)
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
        model, whole, constraints=constraints, slack=slack, base=base
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
    known = np.array([v in ("data", "constraint") for v in verdicts])
    errors, shift = (np.where(known, a, np.nan) for a in (errors, shift))
    layout = model.layout
    return Uncertainty(
        parameters=tuple(
            ParameterUncertainty(name, unit, x, e, d, tuple(b), tuple(c), v)
            for name, unit, x, e, d, b, c, v in zip(
                layout.names,
                layout.units,
                fitted.parameters.tolist(),
                errors.tolist(),
                shift.tolist(),
                resampled.interval().tolist(),
                intervals.bounds.tolist(),
                verdicts,
                strict=True,
            )
        ),
        bootstrap=resampled,
        intervals=intervals,
        scatter=scores.sentence,
    )


class _Scores(NamedTuple):
    """Factor of the scores' covariance, and where it comes from."""

    rows: Matrix
    sentence: str


def _scores(
    fitted: ConstrainedFit,
    segments: Sequence[Regression],
    whole: Regression,
    base: BaseParameters,
    noise: ResidualNoise,
) -> _Scores:
    """Take the scatter between segments where they are long, else effective samples."""
    rows = segment_scores(fitted, segments, base)
    shortest = np.min([segment.counts for segment in segments], axis=0)
    count = len(segments)
    if (shortest >= LONG * noise.length).all():
        from scipy import stats

        t = float(stats.t.ppf(0.975, count - 1))
        return _Scores(
            rows,
            f"scatter is that between {count} segments, each {LONG:.0f} correlation "
            f"lengths long or longer: 95 % are {t:.2f} standard errors either way",
        )
    longest = float(noise.length.max())
    return _Scores(
        white_scores(fitted, whole, base, noise.level),
        f"segments are shorter than {LONG:.0f} correlation lengths, {longest:.0f} "
        f"samples each; scatter is that of noise with as much correlation: "
        f"{noise.sentence}. The bootstrap's intervals are too narrow",
    )


def _plain(record: dict[str, Any]) -> dict[str, Any]:
    def finite(value: Any) -> Any:
        if isinstance(value, tuple):
            return [finite(v) for v in value]
        return None if isinstance(value, float) and not np.isfinite(value) else value

    return {key: finite(value) for key, value in record.items()}
