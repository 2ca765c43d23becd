"""The bootstrap: how far the estimate would move with other data.

Segments of the data are drawn with replacement, as many as there are, and the estimate
is computed again each time [Carlstein1986]_: correlation within segments is kept, and
so is every constraint.  The prior keeps the weight that it had for the data themselves.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from time import perf_counter

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, freeze_arrays
from consistent_id._support.executors import Executor, single_threaded
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
from consistent_id.estimation.penalised import penalised_fits
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.segments import merged
from consistent_id.robot.parameters import ParameterLayout

_ROUNDING = 1e-10  # of a typical parameter
_AT_ONCE = 50  # replicates that are solved together
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
        the shell's ``--executor``, else here.  The result is the same.

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
    return bootstrapped(
        constrained_fit(problem, prior),
        segments,
        base,
        replicates=replicates,
        seed=seed,
        progress=progress,
        executor=executor,
    )


def bootstrapped(
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
        fits = penalised_fits(
            [(drawn(times), fitted.final.weight) for times in draws],
            fitted.distance,
            start=fitted.final.solution.u,
        )
        return [
            (_rounded(f.solution.u) * scaled.unit, f.optimality.verdict == "certified")
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


def _rounded(u: Vector) -> Vector:
    """Return dimensionless parameters, with zero for what is rounding."""
    return np.where(abs(u) < _ROUNDING, 0.0, u)


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
    with counted(total or 0, "replicates", total is not None) as count:
        some = iter(lambda: list(islice(draws, _AT_ONCE)), [])
        each = (
            map(estimated, some) if executor is None else executor.map(estimated, some)
        )
        try:
            for result in chain.from_iterable(each):
                found.append(result)
                count(len(found))
        except KeyboardInterrupt as cause:
            if len(found) < 2:
                raise
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
