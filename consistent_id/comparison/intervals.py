"""Which values a parameter can take among all consistent robots that fit nearly best.

``minimise, and maximise, x_i  subject to  the constraints and
||R x - z|| <= (1 + slack) least``

are two small cone programmes for each parameter.  The ends are not the points that the
solver stopped at but bounds from its multipliers: no robot that satisfies the
constraints and fits within the slack has a value outside, unless it is a thousand times
as large as the nominal one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Vector, freeze_arrays
from consistent_id._support.threads import single_threaded, worker_threads
from consistent_id.constraints import Constraint
from consistent_id.constraints.cones.programmes import (
    Ball,
    ConeRows,
    lower_bound,
    set_rows,
    solve_cones,
)
from consistent_id.constraints.priors import noise_slack
from consistent_id.errors import ProblemError, SolverError
from consistent_id.estimation.best_fit import BestFit, best_fit
from consistent_id.estimation.constrained import DEFAULT_CONSTRAINTS
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.parameters import ParameterLayout

_WORKERS = 2  # Clarabel frees the interpreter's lock
_TOLERANCES = (1e-8, 1e-6)
_RADIUS = 1000.0  # of the ball in which bounds hold, in units of the nominal robot
_SMALL = 1e-3  # of typical parameters: changes that are none
_FELT = 0.05  # change of a value with the ball's radius, relative, that is the ball's


@dataclass(frozen=True, slots=True, eq=False)
class ConsistentIntervals:
    """Proven bounds on each standard parameter.

    Parameters
    ----------
    layout : ParameterLayout
    bounds : array_like, shape (parameters, 2)
        Least and largest values, in the layout's units; infinite where only that size
        stops them, or no bound was proven.
    slack : float
        Relative misfit above the best constrained fit that counts as fitting.
    """

    layout: ParameterLayout
    bounds: Array
    slack: float

    def __post_init__(self) -> None:
        freeze_arrays(self, {"bounds": (len(self.layout), 2)}, finite=False)

    @property
    def width(self) -> Vector:
        """Largest less least value of each parameter."""
        return np.asarray(self.bounds[:, 1] - self.bounds[:, 0])


@single_threaded
def consistent_intervals(
    model: TorqueModel,
    regression: Regression,
    *,
    constraints: Sequence[Constraint] = DEFAULT_CONSTRAINTS,
    slack: float | None = None,
    base: BaseParameters | None = None,
) -> ConsistentIntervals:
    """Bound every standard parameter over all robots that fit and satisfy constraints.

    Parameters
    ----------
    model : TorqueModel
    regression : Regression
        Its `sigma` are the weights.
    constraints : sequence of Constraint
    slack : float, optional
        By default what noise itself brings, `noise_slack`.
    base : BaseParameters, optional

    Raises
    ------
    ProblemError
        If the slack is not positive.
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    base = base_parameters(model) if base is None else base
    if slack is None:
        slack = noise_slack(len(base), sum(regression.counts))
    if not 0.0 < slack < np.inf:
        raise ProblemError(f"slack is {slack}, expected a positive number")
    best = best_fit(model, regression, constraints, base=base)
    unit = best.scaled.unit
    centre = best.scaled.centre
    ball = Ball(centre, _RADIUS * (1.0 + float(np.linalg.norm(centre))))
    programme = _programme(best, slack, ball)
    low, high = _box(model, best)

    def bounds(i: int) -> tuple[float, float]:
        if low[i] == high[i]:
            return low[i], high[i]
        up = np.eye(len(unit))[i]
        least, most = programme.least(up), -programme.least(-up)
        return max(least, low[i]), min(most, high[i])

    with worker_threads(_WORKERS) as pool:
        found = list(pool.map(bounds, range(len(unit))))
    return ConsistentIntervals(model.layout, np.array(found) * unit[:, None], slack)


def _box(model: TorqueModel, best: BestFit) -> tuple[Vector, Vector]:
    """Return the bounds by rows on single parameters, and those of consistent links.

    Mass and moments of inertia of a consistent link are not negative: where they can
    vanish, the programmes alone would not find their least value.
    """
    low, high = best.scaled.domain.box
    bodies = {block.label for block in best.scaled.domain.blocks}
    for k, link in enumerate(model.layout.links):
        if link in bodies:
            places = [10 * k + entry for entry in (0, 4, 6, 9)]
            low[places] = np.maximum(low[places], 0.0)
    return low, high


@dataclass(frozen=True, slots=True, eq=False)
class _Programme:
    """All that fits and is possible, about the best fit as the origin."""

    rows: tuple[ConeRows, ...]
    ball: Ball
    origin: Vector

    def least(self, cost: Vector) -> float:
        """Return a proven lower bound on ``cost.u``; minus infinity without one."""
        for tolerance in _TOLERANCES:
            try:
                point = solve_cones(cost, self.rows, tolerance=tolerance)
            except SolverError:
                continue
            # The ball's multiplier is what a radius twice as large would add.
            if point.duals[-1][0] > _FELT * max(abs(float(cost @ point.x)), _SMALL):
                return -np.inf
            bound = lower_bound(cost, self.rows, point.duals, self.ball)
            return bound + float(cost @ self.origin)
        return -np.inf


def _programme(best: BestFit, slack: float, ball: Ball) -> _Programme:
    scaled, origin = best.scaled, best.solution.u
    total = scaled.excess(origin) + scaled.residual**2
    # In units of the residual, or of a millionth of the torque where that is larger.
    allowed = (1.0 + slack) ** 2 * max(total, 1.0) - scaled.residual**2
    radius = float(np.sqrt(allowed))
    misfit = np.vstack([np.zeros(len(origin)), -scaled.M / radius])
    b = np.append(1.0, (scaled.M @ origin - scaled.z) / radius)
    moved = ball.moved(origin)
    rows = (
        *set_rows(scaled.domain.moved(origin)),
        ConeRows("second order", misfit, b),
        moved.rows(),
    )
    return _Programme(rows, moved, origin)
