"""How sure each parameter of the constrained estimate is, and what determines it.

Three answers side by side: the standard error, of scatter on the active constraints and
of the prior's bias together; the bootstrap's interval; and the 95 % interval among all
consistent robots.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from consistent_id._support.threads import single_threaded
from consistent_id.comparison.floating_blocks import FloatingBlocks
from consistent_id.comparison.intervals import ConsistentIntervals, consistent_intervals
from consistent_id.comparison.parameter_scatter import (
    NORMAL,
    ParameterScatter,
    long_enough,
    parameter_scatter,
    root,
)
from consistent_id.comparison.parameter_shifts import ParameterShifts
from consistent_id.comparison.recording_scatter import RecordingScatter
from consistent_id.comparison.segment_bootstrap import Bootstrap, bootstrap
from consistent_id.constraints import Constraint
from consistent_id.constraints.priors import Prior
from consistent_id.errors import ProblemError
from consistent_id.estimation.constrained import DEFAULT_CONSTRAINTS
from consistent_id.estimation.constrained_fit import ConstrainedFit, constrained_fit
from consistent_id.estimation.determination import determinations
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import residual_noise
from consistent_id.regression.segments import merged
from consistent_id.robot.parameters import did_you_mean


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
    scatter = parameter_scatter(
        model, fitted, segments, sources, constraints, base, noise, variants
    )
    resampled = bootstrap(
        model,
        long_enough(segments, sources, noise)[0],
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
        noise=scatter.noise,
        blocks=scatter.blocks,
        shifts=scatter.shifts,
    )
    verdicts = determinations(
        model,
        whole,
        base,
        scatter.noise,
        fitted.parameters,
        known=fitted.best.scaled.constraints.A_eq,
        elsewhere="prior",
        width=intervals.width,
    )
    return Uncertainty(
        parameters=_stated(model, fitted, scatter, resampled, intervals, verdicts),
        bootstrap=resampled,
        intervals=intervals,
        scatter=scatter.sentence,
        recordings=scatter.recordings,
        blocks=scatter.blocks,
        quantile=scatter.quantile,
        shifts=scatter.shifts,
    )


def _stated(
    model: TorqueModel,
    fitted: ConstrainedFit,
    scatter: ParameterScatter,
    resampled: Bootstrap,
    intervals: ConsistentIntervals,
    verdicts: Sequence[str],
) -> tuple[ParameterUncertainty, ...]:
    """Return what is said of each parameter: errors only where they are known."""
    shift = abs(fitted.parameters - fitted.best.parameters)
    errors = np.hypot(root(scatter.variance), shift)
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
            np.where(seen, scatter.between, np.nan).tolist(),
            strict=True,
        )
    )


def _plain(record: dict[str, Any]) -> dict[str, Any]:
    def finite(value: Any) -> Any:
        if isinstance(value, tuple):
            return [finite(v) for v in value]
        return None if isinstance(value, float) and not np.isfinite(value) else value

    return {key: finite(value) for key, value in record.items()}
