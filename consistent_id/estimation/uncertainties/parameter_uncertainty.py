"""The uncertainty of each parameter of the constrained estimate, and its source.

There are three results: the standard error, from scatter along the active constraints
and the prior's bias; the bootstrap's interval; and the 95 % interval among all
consistent robots.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from consistent_id._support.executors import single_threaded
from consistent_id._support.given_values import require_type, require_types
from consistent_id._support.tables import brief
from consistent_id.constraints import Constraint
from consistent_id.constraints.priors import Prior
from consistent_id.errors import ProblemError
from consistent_id.estimation.best_fit import FitProblem
from consistent_id.estimation.constrained_fit import (
    DEFAULT_CONSTRAINTS,
    ConstrainedFit,
    constrained_fit,
)
from consistent_id.estimation.determination import (
    determinations,
    origin_text,
    parameter_sizes,
    pinned,
)
from consistent_id.estimation.uncertainties.beyond_noise import (
    FloatingBlocks,
    ParameterShifts,
)
from consistent_id.estimation.uncertainties.block_scatter import RecordingScatter
from consistent_id.estimation.uncertainties.intervals import (
    ConsistentIntervals,
    consistent_intervals,
)
from consistent_id.estimation.uncertainties.parameter_scatter import (
    ParameterScatter,
    Segments,
    parameter_scatter,
    root,
)
from consistent_id.estimation.uncertainties.resampling import Bootstrap, bootstrapped
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import NORMAL
from consistent_id.regression.segments import merged
from consistent_id.robot.parameters import did_you_mean


@dataclass(frozen=True, slots=True)
class ParameterUncertainty:
    """The uncertainty of one parameter.

    Parameters
    ----------
    value : float
        Value of the constrained estimate.
    standard_error : float
        Root of the sum of squared scatter (see `variances`, and `RecordingScatter`)
        and squared `prior_shift`; NaN where it would not describe the value's error,
        according to the verdict.
    prior_shift : float
        How far the prior moved the parameter from the best fit: its bias.
    resampled : tuple of float
        Central 95 % of the bootstrap's estimates.
    consistent : tuple of float
        Least and largest value of any consistent robot that fits nearly best.
    verdict : str
        Source of its value; see `determinations`.
    between_recordings : float
        Standard deviation of the parameter between recordings, beyond noise; NaN if the
        data do not depend on it, or for one recording.
    quantile : float
        Standard errors either way of the 95 % interval: Student's, for the degrees of
        freedom of the noise's spectrum, or of segments, recordings and blocks.
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
    quantile: float = NORMAL

    @property
    def half_interval(self) -> float:
        """Half of the 95 % interval; NaN where there is no standard error."""
        return self.quantile * self.standard_error

    @property
    def source(self) -> str:
        """`verdict` for people: small where the data do not determine the value."""
        error = self.standard_error
        return origin_text(self.verdict, self.value, error, self.quantile)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """The uncertainty of all parameters, and its sources.

    `scatter` names the sources of standard errors.  `recordings` is the scatter between
    recordings; None for one recording, or if they do not determine it.  `blocks` is the
    scatter between blocks of a floating base's only recording.  `quantile` standard
    errors either way contain 95 %, the median over parameters; each has its own.
    `shifts` are those from errors of assumed values.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True))
    >>> q, dq, ddq = np.random.default_rng(0).normal(size=(3, 200, 1))
    >>> motion = ci.Recording(("joint1",), np.arange(200) / 100, q, dq, ddq)
    >>> body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]  # kg, kg m, kg m^2
    >>> log = ci.simulate_torque(model, [*body, 0.4], motion)
    >>> noisy = ci.simulate_torque(
    ...     model, [*body, 0.4], motion, noise=0.1, rng=np.random.default_rng(1)
    ... )
    >>> parts = ci.regression.segment_regressions(model, [noisy])
    >>> known = [ci.PhysicalConsistency()]
    >>> sure = ci.uncertainty(model, parts, constraints=known, replicates=5)
    >>> low, high = sure["joint1.viscous"].resampled
    >>> low < 0.42 and high > 0.38
    True
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
        """Return everything as plain numbers and text; None for values not finite."""
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
    """Return the uncertainty of the constrained estimate's parameters.

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
        The same recordings, each with one assumed value changed by its standard error,
        such as the radius of feet: the shifts are added to standard errors and to
        intervals of consistent robots.

    Returns
    -------
    Uncertainty
        One entry for each parameter, in the layout's order.

    Raises
    ------
    ProblemError, InfeasibleError, NotExcitedError, SolverError
        See the functions named.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True))
    >>> q, dq, ddq = np.random.default_rng(0).normal(size=(3, 200, 1))
    >>> motion = ci.Recording(("joint1",), np.arange(200) / 100, q, dq, ddq)
    >>> body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]  # kg, kg m, kg m^2
    >>> log = ci.simulate_torque(model, [*body, 0.4], motion)
    >>> noisy = ci.simulate_torque(
    ...     model, [*body, 0.4], motion, noise=0.1, rng=np.random.default_rng(1)
    ... )
    >>> parts = ci.regression.segment_regressions(model, [noisy])
    >>> known = [ci.PhysicalConsistency()]
    >>> sure = ci.uncertainty(model, parts, constraints=known, replicates=5)
    >>> sure["joint1.viscous"].standard_error < 0.05
    True
    """
    require_type(model, TorqueModel, "model")
    require_types(segments, Regression, "segments")
    base = base_parameters(model) if base is None else base
    sources = [0] * len(segments) if sources is None else list(sources)
    parts, whole = Segments(segments, sources), merged(segments)
    problem = FitProblem.of(model, whole, constraints, base)
    fitted = constrained_fit(problem, prior)
    scatter = parameter_scatter(problem, fitted, parts, variants)
    resampled = bootstrapped(
        fitted,
        parts.long_enough(problem.free.noise).regressions,
        base,
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
        causes=scatter.causes,
    )
    stated = _stated(problem, fitted, scatter, resampled, intervals)
    widths = [p.quantile for p in stated if np.isfinite(p.standard_error)] or [NORMAL]
    return Uncertainty(
        parameters=stated,
        bootstrap=resampled,
        intervals=intervals,
        scatter=scatter.sentence,
        recordings=scatter.recordings,
        blocks=scatter.blocks,
        quantile=float(np.median(widths)),
        shifts=scatter.shifts,
    )


def _stated(
    problem: FitProblem,
    fitted: ConstrainedFit,
    scatter: ParameterScatter,
    resampled: Bootstrap,
    intervals: ConsistentIntervals,
) -> tuple[ParameterUncertainty, ...]:
    """Return the entry of each parameter: errors only where they are known."""
    model, x = problem.model, fitted.parameters
    verdicts = pinned(
        determinations(model, problem.free, scatter.errors, x, elsewhere="prior"),
        intervals.width,
        parameter_sizes(model, problem.free.regression, x),
    )
    shift = abs(fitted.parameters - fitted.best.parameters)
    errors = np.hypot(root(scatter.variance), shift)
    known = np.array([v in ("data", "constraint") for v in verdicts])
    seen = known | np.array([v == "loose" for v in verdicts])
    layout = model.layout
    return tuple(
        ParameterUncertainty(name, unit, x, e, d, tuple(b), tuple(c), v, r, q)
        for name, unit, x, e, d, b, c, v, r, q in zip(
            layout.names,
            layout.units,
            fitted.parameters.tolist(),
            np.where(known, errors, np.nan).tolist(),
            np.where(known, shift, np.nan).tolist(),
            resampled.interval().tolist(),
            intervals.bounds.tolist(),
            verdicts,
            np.where(seen, scatter.between, np.nan).tolist(),
            scatter.quantiles.tolist(),
            strict=True,
        )
    )


def _plain(record: dict[str, Any]) -> dict[str, Any]:
    def finite(value: Any) -> Any:
        if isinstance(value, tuple):
            return [finite(v) for v in value]
        return None if isinstance(value, float) and not np.isfinite(value) else value

    return {key: finite(value) for key, value in record.items()}
