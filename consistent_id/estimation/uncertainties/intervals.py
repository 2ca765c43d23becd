"""Intervals of each parameter over all consistent robots that fit nearly best.

``minimise, and maximise, x_i  subject to  the constraints and
||R x - z||^2 <= least^2 + added_i``

are two small cone programmes for each parameter.  By default these are 95 % intervals
by profile likelihood: ``added_i`` is the increase if ``x_i`` moves by ``t`` standard
errors, with ``t`` the quantile of Student's distribution and noise correlated as the
residuals are; with the scatter between blocks of a floating base's motion, noise and
``t`` are those of standard errors.  For all parameters at once (`joint`) it is ``p F``,
in the limit ``chi^2_p``.

The ends are bounds from the solver's multipliers, not its final points: no robot that
satisfies the constraints and fits within the slack has a value outside, unless it is a
thousand times as large as the nominal one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Vector, freeze_arrays
from consistent_id._support.executors import single_threaded, worker_threads
from consistent_id._support.tables import brief
from consistent_id.constraints import Constraint
from consistent_id.constraints.cones.least_norm import free_set
from consistent_id.constraints.cones.programmes import (
    Ball,
    ConePoint,
    ConeRows,
    lower_bound,
)
from consistent_id.constraints.cones.repeated import solve_costs
from consistent_id.constraints.priors import misfit_increase
from consistent_id.errors import ProblemError
from consistent_id.estimation.best_fit import BestFit, best_fit
from consistent_id.estimation.constrained_fit import (
    DEFAULT_CONSTRAINTS,
)
from consistent_id.estimation.uncertainties.beyond_noise import ScatterCauses
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import unconstrained_fit
from consistent_id.robot.parameters import ParameterLayout

_WORKERS = 2  # Clarabel frees the interpreter's lock
_TOLERANCE, _FINER, _COARSER = 1e-8, 1e-10, 1e-6  # of the programmes
_LOOSE = 1e-3  # share of an end by which its proven bound may be beyond it
_RADIUS = 1000.0  # of the ball in which bounds hold, in units of the nominal robot
_SMALL = 1e-3  # share of typical parameters that counts as no change
_FELT = 0.05  # relative change with the ball's radius above which the ball is active


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ConsistentIntervals:
    """Proven bounds on each standard parameter.

    Parameters
    ----------
    layout : ParameterLayout
    bounds : array_like, shape (parameters, 2)
        Least and largest values, in the layout's units; infinite if only this size
        bounds them, or if no bound was proven.
    slack : float
        Relative misfit above the best constrained fit that is allowed; the largest over
        all parameters.
    level : float, optional
        Probability that an interval contains the truth; None if the slack was given.
    joint : bool
        Whether the level is that of all intervals together.
    """

    layout: ParameterLayout
    bounds: Array
    slack: float
    level: float | None = None
    joint: bool = False

    def __post_init__(self) -> None:
        freeze_arrays(self, {"bounds": (len(self.layout), 2)}, finite=False)

    @property
    def width(self) -> Vector:
        """Largest less least value of each parameter."""
        return np.asarray(self.bounds[:, 1] - self.bounds[:, 0])

    @property
    def meaning(self) -> str:
        """The definition of the intervals, in words."""
        within = "among robots up to a thousand times the nominal"
        if self.level is None:
            return (
                "proven bounds over robots that satisfy the constraints and fit within "
                f"{self.slack:.2%} of the best, {within}"
            )
        each = "for all parameters at once" if self.joint else "for each parameter"
        return (
            f"{self.level:.0%} interval by profile likelihood over all robots that "
            f"satisfy the constraints, {each}; its ends are proven bounds {within}"
        )


@single_threaded
def consistent_intervals(
    model: TorqueModel,
    regression: Regression,
    *,
    constraints: Sequence[Constraint] = DEFAULT_CONSTRAINTS,
    slack: float | None = None,
    level: float = 0.95,
    joint: bool = False,
    base: BaseParameters | None = None,
    causes: ScatterCauses | None = None,
) -> ConsistentIntervals:
    """Bound every standard parameter over all robots that fit and satisfy constraints.

    Parameters
    ----------
    model : TorqueModel
    regression : Regression
        Its `sigma` are the weights.
    constraints : sequence of Constraint
    slack : float, optional
        Allowed relative increase of the misfit, instead of a level.
    level : float
        Probability with which intervals shall contain the truth.
    joint : bool
        Whether this is for all intervals together, not for each.
    base : BaseParameters, optional
    causes : ScatterCauses, optional
        Causes of scatter; by default the noise of the regression alone.

    Raises
    ------
    ProblemError
        If the slack is not positive, or the level is not between 0 and 1.
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    base = base_parameters(model) if base is None else base
    if slack is not None and not 0.0 < slack < np.inf:
        raise ProblemError(f"slack is {slack}, expected a positive number")
    if not 0.0 < level < 1.0:
        raise ProblemError(f"level is {level}, expected between 0 and 1")
    best = best_fit(model, regression, constraints, base=base)
    # A misfit below a millionth of the torque counts as that: see `ScaledFit`.
    least = max(best.misfit, best.scaled.size) ** 2
    if slack is None:
        if causes is None:
            causes = ScatterCauses(unconstrained_fit(regression, base).noise)
        added = _added(causes, base, level, joint)
    else:
        added = np.full(len(model.layout), ((1.0 + slack) ** 2 - 1.0) * least)
    unit = best.scaled.unit
    centre = best.scaled.centre
    ball = Ball(centre, _RADIUS * (1.0 + float(np.linalg.norm(centre))))
    programme = _programme(best, ball)
    low, high = _box(model, best)

    def bounds(i: int) -> tuple[float, float]:
        if low[i] == high[i]:
            return low[i], high[i]
        lower, upper = programme.ends(i, (least + added[i]) / best.scaled.size**2)
        return max(lower, low[i]), min(upper, high[i])

    with worker_threads(_WORKERS) as pool:
        found = list(pool.map(bounds, range(len(unit))))
    return ConsistentIntervals(
        layout=model.layout,
        bounds=np.array(found) * unit[:, None],
        slack=misfit_increase(float(added.max()), least) if slack is None else slack,
        level=level if slack is None else None,
        joint=joint and slack is None,
    )


def _added(
    causes: ScatterCauses, base: BaseParameters, level: float, joint: bool
) -> Vector:
    """Return the squared misfit that each parameter's interval allows."""
    from scipy.special import fdtri, stdtrit

    noise, blocks, shifts = causes
    of_parameters = base.lift(np.eye(len(base)))
    freedom = noise.freedoms(of_parameters)
    squared = noise.squared_misfit(of_parameters)
    if blocks is not None and blocks.freedom > 0.0:
        squared = squared + blocks.squared_misfit
        # The scatter may be found too small: as if it were all, as in standard errors.
        freedom = np.full(len(squared), blocks.freedom)
    if shifts is not None:
        squared = squared + shifts.squared_misfit
    if joint:
        ratio = noise.rank * fdtri(noise.rank, freedom, level)
    else:
        ratio = stdtrit(freedom, 0.5 + level / 2.0) ** 2
    return np.asarray(ratio * squared)


def _box(model: TorqueModel, best: BestFit) -> tuple[Vector, Vector]:
    """Return the bounds by rows on single parameters, and those of consistent links.

    Mass and moments of inertia of a consistent link are not negative: if they can
    vanish, the programmes alone do not find their least value.
    """
    low, high = map(np.copy, best.scaled.domain.box)
    bodies = {block.label for block in best.scaled.domain.blocks}
    for k, link in enumerate(model.layout.links):
        if link in bodies:
            places = [10 * k + entry for entry in (0, 4, 6, 9)]
            low[places] = np.maximum(low[places], 0.0)
    return low, high


class _ProvenBound(NamedTuple):
    """A proven bound, and the share of the end by which it may be beyond that."""

    bound: float
    loose: float


@dataclass(frozen=True, slots=True, eq=False)
class _IntervalProgramme:
    """The set of consistent robots that fit, for steps from the best fit.

    Pinned parameters are no variables.
    """

    best: BestFit
    free: BoolArray
    rows: tuple[ConeRows, ...]
    ball: Ball
    misfit: ConeRows

    def ends(self, i: int, allowed: float) -> tuple[float, float]:
        """Return proven bounds of a parameter; infinite where none was proven.

        `allowed` is the squared misfit, in units of the residual, or of a millionth of
        the torque where that is larger.
        """
        value = float(self.best.solution.u[i])
        if not self.free[i]:
            return value, value
        radius = float(np.sqrt(allowed - self.best.scaled.residual**2))
        misfit = ConeRows(
            "second order",
            self.misfit.A / radius,
            np.append(1.0, self.misfit.b[1:] / radius),
        )
        rows = (*self.rows, misfit, self.ball.rows())
        up = np.eye(len(self.free))[i, self.free]
        costs, found = (up, -up), [-np.inf, -np.inf]
        points = solve_costs(costs, rows, tolerance=_TOLERANCE)
        for k, (cost, point) in enumerate(zip(costs, points, strict=True)):
            found[k], loose = self._proven(cost, rows, point)
            if loose > _LOOSE:
                other = _COARSER if point is None else _FINER
                (point,) = solve_costs([cost], rows, tolerance=other)
                found[k] = max(found[k], self._proven(cost, rows, point).bound)
        return value + found[0], value - found[1]

    def _proven(
        self, cost: Vector, rows: Sequence[ConeRows], point: ConePoint | None
    ) -> _ProvenBound:
        """Return the bound that a point's multipliers prove."""
        if point is None:
            return _ProvenBound(-np.inf, np.inf)
        least = float(cost @ point.x)
        size = max(abs(least), _SMALL)
        # The ball's multiplier is the change for a radius twice as large.
        if point.duals[-1][0] > _FELT * size:
            return _ProvenBound(-np.inf, 0.0)
        bound = lower_bound(cost, rows, point.duals, self.ball)
        return _ProvenBound(bound, (least - bound) / size)


def _programme(best: BestFit, ball: Ball) -> _IntervalProgramme:
    scaled, origin = best.scaled, best.solution.u
    reduced = free_set(scaled.domain)
    free = reduced.free
    misfit = np.vstack([np.zeros(int(free.sum())), -scaled.M[:, free]])
    b = np.append(0.0, scaled.M @ origin - scaled.z)
    near = Ball(ball.centre[free] - origin[free], ball.radius)
    return _IntervalProgramme(
        best,
        free,
        tuple(reduced.about(origin[free])),
        near,
        ConeRows("second order", misfit, b),
    )
