"""The uncertainty of each parameter of the constrained estimate, and its source.

There are three results: the standard error, from scatter along the active constraints
and the prior's bias; the bootstrap's interval; and the 95 % interval among all
consistent robots.

The bootstrap shows how far the estimate would move with other data. Segments of the
data are drawn with replacement, as many as there are, and the estimate is computed
again each time [Carlstein1986]_: correlation within segments is kept, and so is every
constraint.  The prior keeps the weight that it had for the data themselves.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import chain, islice
from time import perf_counter
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, freeze_arrays
from consistent_id._support.executors import Executor, single_threaded, worker_threads
from consistent_id._support.given_values import require_type, require_types
from consistent_id._support.progress import counted
from consistent_id._support.run import note_stop
from consistent_id._support.tables import brief
from consistent_id.constraints import Constraint
from consistent_id.constraints.priors import Prior
from consistent_id.errors import ProblemError, SolverError
from consistent_id.estimation.best_fit import FitProblem, ScaledFit, base_factor
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
from consistent_id.estimation.penalised import penalised_fits
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
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import NORMAL
from consistent_id.regression.segments import merged
from consistent_id.robot.parameters import ParameterLayout, did_you_mean

_WORKERS = 2  # Clarabel frees the interpreter's lock
_AT_ONCE = 10  # replicates that are solved together
_Replicate = tuple[Vector, bool]  # parameters, and whether they are certified


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Bootstrap:
    """Constrained estimates of resampled data.

    Parameters
    ----------
    layout : ParameterLayout
    estimates : array_like, shape (replicates, parameters)
        In the layout's units, without those that failed.
    certified : int
        Number of certified optima.
    failed : int
        Number of replicates without an estimate.
    seconds : float
        Wall time, [s].
    interrupted : bool
        Whether the user, or a time limit, ended it before all replicates.
    segments : int
        Number of segments that were drawn from; 0 if not known.
    """

    layout: ParameterLayout
    estimates: Matrix
    certified: int
    failed: int
    seconds: float
    interrupted: bool = False
    segments: int = 0

    def __post_init__(self) -> None:
        freeze_arrays(self, {"estimates": (None, len(self.layout))})

    @property
    def standard_deviation(self) -> Vector:
        """Standard deviation of each parameter."""
        return np.asarray(self.estimates.std(axis=0, ddof=1))

    def interval(self, level: float = 0.95) -> Array:
        """Return the central share of each parameter's estimates.

        For few segments, percentiles are too close together.  They are moved outwards
        by the quantile of Student's distribution for this number of segments over that
        of the normal one: the expanded percentile interval [Hesterberg2015]_.

        Returns
        -------
        ndarray, shape (parameters, 2)
        """
        if not 0.0 < level < 1.0:
            raise ProblemError(f"level is {level}, expected between 0 and 1")
        tail = _expanded((1.0 - level) / 2, self.segments)
        return np.quantile(self.estimates, [tail, 1.0 - tail], axis=0).T


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
    fitted, free = constrained_fit(problem, prior), problem.free
    scatter = parameter_scatter(problem, fitted, parts, variants)
    resampled = _resampled(
        fitted,
        parts.long_enough(free.noise).regressions,
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
    x = fitted.parameters
    verdicts = pinned(
        determinations(model, free, scatter.errors, x, elsewhere="prior"),
        intervals.width,
        parameter_sizes(model, whole, x),
    )
    stated = _stated(model, fitted, scatter, resampled, intervals, verdicts)
    widths = [p.quantile for p in stated if np.isfinite(p.standard_error)]
    return Uncertainty(
        parameters=stated,
        bootstrap=resampled,
        intervals=intervals,
        scatter=scatter.sentence,
        recordings=scatter.recordings,
        blocks=scatter.blocks,
        quantile=float(np.median(widths)) if widths else NORMAL,
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
    """Return the entry of each parameter: errors only where they are known."""
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


@single_threaded
def bootstrap(
    model: TorqueModel,
    segments: Sequence[Regression],
    *,
    constraints: Sequence[Constraint] = DEFAULT_CONSTRAINTS,
    prior: Prior | None = None,
    base: BaseParameters | None = None,
    replicates: int = 200,
    seed: int = 0,
    progress: bool = False,
    executor: str | Executor | None = None,
) -> Bootstrap:
    """Estimate repeatedly from segments drawn with replacement.

    Parameters
    ----------
    model : TorqueModel
    segments : sequence of Regression
        See `segment_regressions`; their `sigma` are the weights.
    constraints, prior, base
        See `constrained_least_squares`.
    replicates : int
    seed : int
    progress : bool
        Show a progress bar.
    executor : str or Executor, optional
        Where replicates are solved, see `stream_regression`; by default as stated by
        the shell's ``--executor``, else in two threads.  The result is the same.

    Returns
    -------
    Bootstrap
        The replicates so far, if interrupted from the keyboard after two.

    Raises
    ------
    ProblemError
        If there are fewer than two segments or replicates.
    SolverError
        If fewer than two replicates give an estimate.
    """
    base = base_parameters(model) if base is None else base
    problem = FitProblem.of(model, merged(segments), constraints, base)
    return _resampled(
        constrained_fit(problem, prior),
        segments,
        base,
        replicates=replicates,
        seed=seed,
        progress=progress,
        executor=executor,
    )


def _resampled(
    fitted: ConstrainedFit,
    segments: Sequence[Regression],
    base: BaseParameters,
    *,
    replicates: int,
    seed: int,
    progress: bool,
    executor: str | Executor | None = None,
) -> Bootstrap:
    """Estimate repeatedly like a fit to all segments; see `bootstrap`."""
    started = perf_counter()
    if len(segments) < 2 or replicates < 2:
        raise ProblemError(
            f"{len(segments)} segments and {replicates} replicates, expected 2 or more"
        )
    factors = [base_factor(segment, base) for segment in segments]
    scaled = fitted.best.scaled

    def drawn(times: Array) -> ScaledFit:
        rows = [np.sqrt(n) * F for n, F in zip(times, factors, strict=True) if n]
        return scaled.with_factor(triangle(np.asfortranarray(np.vstack(rows))))

    @single_threaded
    def estimated(draws: Sequence[Array]) -> list[_Replicate | None]:
        fits = penalised_fits([drawn(t) for t in draws], fitted.distance, fitted.final)
        return [
            (f.solution.u * scaled.unit, f.optimality.verdict == "certified")
            if f is not None
            else None
            for f in fits
        ]

    draws = islice(_draws(len(segments), np.random.default_rng(seed)), replicates)
    chosen = Executor.chosen(executor)
    found = _collected(estimated, draws, replicates if progress else None, chosen)
    good = [result for result in found if result is not None]
    if len(good) < 2:
        raise SolverError(f"{len(good)} of {len(found)} replicates gave an estimate")
    return Bootstrap(
        layout=base.layout,
        estimates=np.array([x for x, _ in good]),
        certified=sum(certified for _, certified in good),
        failed=len(found) - len(good),
        seconds=perf_counter() - started,
        interrupted=len(found) < replicates,
        segments=len(segments),
    )


def _draws(segments: int, rng: np.random.Generator) -> Iterator[Array]:
    """Yield the number of times each segment is drawn."""
    while True:
        drawn = rng.integers(segments, size=segments)
        yield np.bincount(drawn, minlength=segments).astype(np.float64)


def _collected(
    estimated: Callable[[Sequence[Array]], list[_Replicate | None]],
    draws: Iterator[Array],
    total: int | None,
    executor: Executor | None,
) -> list[_Replicate | None]:
    """Return the results in order; those so far, if interrupted after two or more."""
    found: list[_Replicate | None] = []
    with (
        worker_threads(_WORKERS) as pool,
        counted(total or 0, "replicates", total is not None) as count,
    ):
        some = iter(lambda: list(islice(draws, _AT_ONCE)), [])
        each = (pool if executor is None else executor).map(estimated, some)
        try:
            for result in chain.from_iterable(each):
                found.append(result)
                count(len(found))
        except KeyboardInterrupt as cause:
            if len(found) < 2:
                raise
            pool.shutdown(wait=False, cancel_futures=True)
            note_stop(cause)
    return found


def _expanded(tail: float, segments: int) -> float:
    """Return the share to cut off at each end, so that intervals are wide enough."""
    if segments < 2:
        return tail
    from scipy.special import ndtr, stdtrit  # scipy.stats takes a second to import

    n = segments
    t = -float(stdtrit(n - 1, tail)) * np.sqrt(n / (n - 1))
    return float(ndtr(-t))
