"""The best compromise between misfit and distance to nominal, certified.

``minimise ||M u - z||^2 + weight distance(u)^2`` over the constraints.

A quadratic distance makes this one least-norm problem.  The entropic one is minimised
by damped Newton steps, each of them a least-norm problem with the distance's second
order: the divergence is self-concordant, so a step of local length ``d`` may be taken
by ``1 / (1 + d)`` or more, as a search along it tells, and in full once ``d`` is small.
"""

from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.constraints.cones.certificate import (
    GAP_TOLERANCE,
    Optimality,
    certify,
    unexplained,
)
from consistent_id.constraints.cones.least_norm import (
    ConeSolution,
    LeastNorm,
    solve_least_norm,
)
from consistent_id.constraints.cones.row_spaces import equalities
from consistent_id.constraints.distances import (
    EntropicDistance,
    NominalDistance,
    QuadraticDistance,
    Rows,
)
from consistent_id.errors import SolverError
from consistent_id.estimation.best_fit import solved
from consistent_id.estimation.scaled_fit import REFERENCE, ScaledFit

_STEPS = 60
_KEPT = 0.25  # of each eigenvalue of a body that a Newton step leaves, at the least
_HALVINGS = 30  # of the share of a Newton step that is taken
_USABLE = 1e-6  # violation, ten times what is certified: beyond, it is no answer
_FULL = 0.25  # local length up to which a Newton step is taken in full
_STILL = 1e-7  # local length at which Newton's method has arrived
_CLOSE = 1e-4  # local length from which no more than two further steps are tried
_FINE = (1e-11, 1e-12)  # tolerances at which multipliers are asked for once more


@dataclass(frozen=True, slots=True, eq=False)
class PenalisedFit:
    """The compromise.

    Parameters
    ----------
    optimality : Optimality
        Of half the penalised square.
    excess : float
        Squared misfit beyond the residual's.
    """

    solution: ConeSolution
    optimality: Optimality
    excess: float
    squared_distance: float
    weight: float

    @property
    def distance_gap(self) -> float:
        """Bound on what the squared distance exceeds the least by, for its misfit."""
        total = self.optimality.gap * max(self.optimality.objective, REFERENCE)
        return 2.0 * total / self.weight


def penalised_fit(
    fit: ScaledFit,
    distance: NominalDistance,
    weight: float,
    *,
    start: Vector | None = None,
    reach: float = 0.0,
    gap: float = GAP_TOLERANCE,
) -> PenalisedFit:
    """Minimise squared misfit plus `weight` times squared distance.

    Parameters
    ----------
    start : ndarray, optional
        Where Newton's method starts, a robot of bodies; by default the nominal one.
    reach : float
        See `ball_about`.
    gap : float
        Relative gap of the objective that is small enough; of the entropic distance,
        whose optimum is only found to the last digits, that of a certificate.

    Raises
    ------
    InfeasibleError, SolverError
        See `constrained_least_squares`.
    """
    centre = distance.nominal
    if isinstance(distance, QuadraticDistance):
        problem = _stacked(fit, distance.local(centre), weight)
        solution, optimality = solved(problem, centre, reach=reach, gap=gap)
    else:
        solution = _newton(fit, distance, weight, centre if start is None else start)
        solution, optimality = _proven(fit, distance, weight, solution, reach)
        if optimality.violation > _USABLE:
            raise SolverError(
                "the entropic distance needs links with mass and thickness, but none "
                f"that satisfy the constraints were found (violation "
                f"{optimality.violation:.1e}); take another distance, or check for "
                "masses and moments of zero"
            )
    u = solution.u
    return PenalisedFit(
        solution, optimality, fit.excess(u), distance.squared(u), weight
    )


def _stacked(fit: ScaledFit, rows: Rows, weight: float) -> LeastNorm:
    root = np.sqrt(weight)
    G = np.vstack([fit.M, root * rows.G])
    return LeastNorm(G, np.append(fit.z, root * rows.g), fit.domain)


def _newton(
    fit: ScaledFit, distance: EntropicDistance, weight: float, start: Vector
) -> ConeSolution:
    """Return the last point reached that is a robot of bodies, with multipliers."""
    u = start if np.isfinite(distance.squared(start)) else distance.nominal
    shortest, idle = np.inf, 0
    for _ in range(_STEPS):
        rows = distance.local(u)
        problem = _stacked(fit, rows, weight)
        try:
            solution = solve_least_norm(problem, origin=u)
        except SolverError:
            solution, _ = solved(problem, distance.nominal)
        step = solution.u - u
        length = float(np.linalg.norm(rows.G @ step))
        idle = idle + 1 if length > 0.5 * shortest and shortest < _CLOSE else 0
        shortest = min(shortest, length)
        if length <= _STILL or idle == 2:
            break
        ahead = u + _step_length(fit, distance, weight, u, step, length) * step
        if not np.isfinite(distance.squared(ahead)):
            break  # the constraints lead out of all bodies
        u = ahead
    whole = np.isfinite(distance.squared(solution.u))
    return solution if whole else replace(solution, u=u)


def _step_length(
    fit: ScaledFit,
    distance: EntropicDistance,
    weight: float,
    u: Vector,
    step: Vector,
    length: float,
) -> float:
    """Return how much of a step to take: all, or what lowers the objective most.

    At least ``1 / (1 + length)``, which self-concordance guarantees to lower it, and
    no more than leaves every body a quarter of its thickness: what has become thin too
    early takes many steps to grow again.
    """
    if length <= _FULL:
        return 1.0
    along = distance.along(u, step)
    residual, change = fit.M @ u - fit.z, fit.M @ step

    def slope(t: float) -> float:
        misfit = 2.0 * float(change @ (residual + t * change))
        return misfit + weight * along.slope(t)

    low = 1.0 / (1.0 + length)
    high = max(along.furthest(_KEPT), low)
    if slope(high) <= 0.0:
        return high
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if slope(middle) > 0.0 else (middle, high)
    return low


def _proven(
    fit: ScaledFit,
    distance: EntropicDistance,
    weight: float,
    solution: ConeSolution,
    reach: float = 0.0,
) -> tuple[ConeSolution, Optimality]:
    """Certify; where the multipliers are too coarse for that, ask for finer ones."""
    best = solution, certify_penalised(fit, distance, weight, solution, reach)
    for tolerance in _FINE:
        u, optimality = best[0].u, best[1]
        if optimality.verdict == "certified" or not np.isfinite(distance.squared(u)):
            break
        problem = _stacked(fit, distance.local(u), weight)
        try:
            finer = solve_least_norm(problem, tolerance=tolerance, origin=u)
        except SolverError:
            continue
        again = finer, certify_penalised(fit, distance, weight, finer, reach)
        best = min(best, again, key=lambda pair: pair[1].gap)
    return best


def certify_penalised(
    fit: ScaledFit,
    distance: NominalDistance,
    weight: float,
    solution: ConeSolution,
    reach: float = 0.0,
) -> Optimality:
    """Recompute feasibility and the gap of a solution.

    Of the entropic distance, the gradient is that at the solution, and the curvature
    holds everywhere.  Self-concordance: ``D(u + d) >= D(u) + grad D.d + w(t)``,
    ``w(t) = t - log(1 + t)``, ``t`` the local length of ``d``.  As ``w(t) >= t^2 / 4``
    up to 1 and has a slope of 1/2 or more beyond, half the local Hessian is a lower
    bound wherever it matters: as
    long as the unexplained gradient is shorter than half the weight.
    """
    u, centre = solution.u, distance.nominal
    if isinstance(distance, QuadraticDistance):
        problem = _stacked(fit, distance.local(u), weight)
        return certify(problem, solution, centre, reference=REFERENCE, reach=reach)
    squared = distance.squared(u)
    if not np.isfinite(squared):
        return Optimality(np.inf, np.inf, fit.domain.violation(u), np.inf)
    rows = distance.local(u)
    problem = _stacked(fit, rows, weight)
    objective = (fit.excess(u) + weight * squared) / 2

    def certified_with(curvature: Matrix) -> Optimality:
        return certify(
            problem,
            solution,
            centre,
            reference=REFERENCE,
            reach=reach,
            objective=objective,
            curvature=curvature,
        )

    rest, _ = unexplained(problem, u, solution.multipliers)
    E = equalities(fit.domain).steps
    steep = np.linalg.lstsq((rows.G @ E).T, E.T @ rest, rcond=0.0)[0]
    if np.linalg.norm(steep) > weight / 2:
        return certified_with(fit.M)
    return certified_with(np.vstack([fit.M, np.sqrt(weight / 2) * rows.G]))
