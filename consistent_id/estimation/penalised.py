"""The best compromise between misfit and distance to nominal, certified.

``minimise ||M u - z||^2 + weight distance(u)^2`` over the constraints.

A quadratic distance makes this one least-norm problem.  The entropic one is minimised
by damped Newton steps, each of them a least-norm problem with the distance's second
order: the divergence is self-concordant, so of a step of local length ``d`` at least
the part ``1 / (1 + d)`` is safe; a line search may take more, and a small step is taken
in full.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.singular import lstsq
from consistent_id.constraints.cones.certificate import (
    FEASIBILITY_TOLERANCE,
    GAP_TOLERANCE,
    Optimality,
    Parabola,
    ball_about,
    certify,
    unexplained,
)
from consistent_id.constraints.cones.certified_squares import certified_squares
from consistent_id.constraints.cones.least_norm import (
    ConeSolution,
    LeastNorm,
    solve_least_norm,
)
from consistent_id.constraints.priors import (
    Along,
    EntropicDistance,
    LocalRows,
    NominalDistance,
    QuadraticDistance,
)
from consistent_id.errors import ConsistentIdError, SolverError
from consistent_id.estimation.best_fit import REFERENCE, ScaledFit, solved

_STEPS = 60
_KEPT = 0.25  # least share of each eigenvalue of a body that a Newton step leaves
_HALVINGS = 30  # resolution of the share of a Newton step
_FULL = 0.25  # local length up to which a Newton step is taken in full
_STILL = 1e-7  # local length at which Newton's method has arrived
_CLOSE = 1e-4  # local length from which no more than two further steps are tried
_FINE = (1e-11, 1e-12)  # tolerances at which multipliers are computed again


@dataclass(frozen=True, slots=True, eq=False)
class PenalisedFit:
    """The compromise.

    Parameters
    ----------
    optimality : Optimality
        Proof for half the penalised square.
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
        """Bound on the excess of the squared distance over the least for its misfit."""
        total = self.optimality.gap * max(self.optimality.objective, REFERENCE)
        return 2.0 * total / self.weight


def penalised_fit(
    fit: ScaledFit,
    distance: NominalDistance,
    weight: float,
    *,
    start: Vector | None = None,
    gap: float = GAP_TOLERANCE,
) -> PenalisedFit:
    """Minimise squared misfit plus `weight` times squared distance.

    Parameters
    ----------
    start, gap
        See `Compromise.optimum`.

    Raises
    ------
    InfeasibleError, SolverError
        See `constrained_least_squares`.
    """
    return Compromise(fit, distance, weight).optimum(start, gap=gap)


def penalised_fits(
    cases: Sequence[tuple[ScaledFit, float]],
    distance: NominalDistance,
    *,
    start: Vector,
    gap: float = GAP_TOLERANCE,
) -> list[PenalisedFit | None]:
    """Return the compromise of each fit with a weight; None where there is none.

    With a quadratic distance all are solved together.  Those without a certificate are
    solved again alone.

    Parameters
    ----------
    cases : sequence of (ScaledFit, float)
        Fits with the same domain, each with its weight.
    start : ndarray, shape (parameters,)
        A point near the optima.
    gap : float
        See `Compromise.optimum`.
    """
    problems = [Compromise(fit, distance, weight) for fit, weight in cases]
    proven: Sequence[tuple[ConeSolution, Optimality] | None] = [None] * len(problems)
    if isinstance(distance, QuadraticDistance):
        centre = distance.nominal
        near = [problem.near(centre).problem for problem in problems]
        proven = certified_squares(near, centre, start, reference=REFERENCE, gap=gap)
    found: list[PenalisedFit | None] = []
    for problem, pair in zip(problems, proven, strict=True):
        try:
            optimum = problem.optimum(start, gap=gap) if pair is None else None
        except ConsistentIdError:
            found.append(None)
        else:
            found.append(optimum if pair is None else problem.with_proof(*pair))
    return found


class _NearProblem(NamedTuple):
    """The compromise near a point: the distance's rows there, and the problem."""

    rows: LocalRows
    problem: LeastNorm


@dataclass(frozen=True, slots=True, eq=False)
class Compromise:
    """The problem of a fit that is near the nominal robot, too.

    Parameters
    ----------
    weight : float
        Weight of the squared distance.
    reach : float
        Least radius of the ball in which proofs are valid; see `ball_about`.
    """

    fit: ScaledFit
    distance: NominalDistance
    weight: float
    reach: float = 0.0

    def optimum(
        self, start: Vector | None = None, *, gap: float = GAP_TOLERANCE
    ) -> PenalisedFit:
        """Return the optimum, with its proof.

        Parameters
        ----------
        start : ndarray, optional
            Where Newton's method starts, a robot of bodies; by default the nominal one.
        gap : float
            Relative gap of the objective that is small enough.  For the entropic
            distance, whose optimum is found to the last digits, that of a certificate
            is used.

        Raises
        ------
        InfeasibleError, SolverError
            See `constrained_least_squares`.
        """
        distance, centre = self.distance, self.distance.nominal
        if isinstance(distance, QuadraticDistance):
            problem = self.near(centre).problem
            solution, optimality = solved(problem, centre, reach=self.reach, gap=gap)
        else:
            solution = self._newton(distance, centre if start is None else start)
            solution, optimality = self.proven(solution)
            if optimality.violation > FEASIBILITY_TOLERANCE:
                raise SolverError(
                    "the entropic distance needs links with mass and thickness, but "
                    "none that satisfy the constraints were found (violation "
                    f"{optimality.violation:.1e}); take another distance, or check for "
                    "masses and moments of zero"
                )
        return self.with_proof(solution, optimality)

    def with_proof(self, solution: ConeSolution, proof: Optimality) -> PenalisedFit:
        """Return a solution as a fit."""
        excess = self.fit.excess(solution.u)
        squared = self.distance.squared(solution.u)
        return PenalisedFit(solution, proof, excess, squared, self.weight)

    def near(self, u: Vector) -> _NearProblem:
        """Return the least-norm problem that is the compromise to second order."""
        fit, rows, root = self.fit, self.distance.local(u), np.sqrt(self.weight)
        G = np.vstack([fit.M, root * rows.G])
        g = np.append(fit.z, root * rows.g)
        return _NearProblem(rows, LeastNorm(G, g, fit.domain))

    def _newton(self, distance: EntropicDistance, start: Vector) -> ConeSolution:
        """Return the last iterate with consistent bodies, and its multipliers."""
        u = start if np.isfinite(distance.squared(start)) else distance.nominal
        shortest, idle = np.inf, 0
        for _ in range(_STEPS):
            rows, problem = self.near(u)
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
            share = 1.0
            if length > _FULL:
                share = self.step_share(distance.along(u, step), u, step, length)
            ahead = u + share * step
            if not np.isfinite(distance.squared(ahead)):
                break  # no point of the constraints has consistent bodies
            u = ahead
        whole = np.isfinite(distance.squared(solution.u))
        return solution if whole else replace(solution, u=u)

    def step_share(self, along: Along, u: Vector, step: Vector, length: float) -> float:
        """Return the share of a step that lowers the objective most, at most one.

        At least ``1 / (1 + length)``, which self-concordance guarantees to lower it,
        and small enough to leave every body a quarter of its thickness: a body that
        becomes thin too early needs many steps to grow again.

        Parameters
        ----------
        along : Along
            The distance along the step from `u`.
        length : float
            Local length of the step.
        """
        fit = self.fit
        residual, change = fit.M @ u - fit.z, fit.M @ step

        def slope(t: float) -> float:
            misfit = 2.0 * float(change @ (residual + t * change))
            return misfit + self.weight * along.slope(t)

        low = 1.0 / (1.0 + length)
        high = max(along.furthest(_KEPT), low)
        if slope(high) <= 0.0:
            return high
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (low, middle) if slope(middle) > 0.0 else (middle, high)
        return low

    def proven(self, solution: ConeSolution) -> tuple[ConeSolution, Optimality]:
        """Certify; if the multipliers are too inaccurate, compute better ones."""
        best = solution, self.certified(solution)
        for tolerance in _FINE:
            u, optimality = best[0].u, best[1]
            hopeless = not np.isfinite(self.distance.squared(u))
            if optimality.verdict == "certified" or hopeless:
                break
            problem = self.near(u).problem
            try:
                finer = solve_least_norm(problem, tolerance=tolerance, origin=u)
            except SolverError:
                continue
            again = finer, self.certified(finer)
            best = min(best, again, key=lambda pair: pair[1].gap)
        return best

    def certified(self, solution: ConeSolution) -> Optimality:
        """Recompute feasibility and the gap of a solution.

        For the entropic distance, the gradient is that at the solution, and the bound
        of the curvature is valid everywhere.  Self-concordance:
        ``D(u + d) >= D(u) + grad D.d + w(t)``, ``w(t) = t - log(1 + t)``, ``t`` the
        local length of ``d``.  As ``w(t) >= t^2 / 4`` up to 1 and has a slope of 1/2 or
        more beyond, half the local Hessian is a lower bound in the relevant region, as
        long as the unexplained gradient is shorter than half the weight.
        """
        fit, distance, weight = self.fit, self.distance, self.weight
        u, within = solution.u, ball_about(distance.nominal, self.reach)
        proof = partial(certify, solution=solution, within=within, reference=REFERENCE)
        if isinstance(distance, QuadraticDistance):
            return proof(self.near(u).problem)
        squared = distance.squared(u)
        if not np.isfinite(squared):
            return Optimality(np.inf, np.inf, fit.domain.violation(u), np.inf)
        rows, problem = self.near(u)
        objective = (fit.excess(u) + weight * squared) / 2
        rest, _ = unexplained(problem, u, solution.multipliers)
        E = fit.domain.equalities.steps
        steep = lstsq((rows.G @ E).T, E.T @ rest, 0.0)
        curvature = fit.M
        if np.linalg.norm(steep) <= weight / 2:
            curvature = np.vstack([fit.M, np.sqrt(weight / 2) * rows.G])
        return proof(problem, below=Parabola(objective, curvature))
