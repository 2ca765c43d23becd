"""The best compromise between misfit and distance to nominal, certified.

``minimise ||M u - z||^2 + weight distance(u)^2`` over the constraints.

A quadratic distance makes this one least-norm problem.  The entropic one is minimised
by damped Newton steps, each of them a least-norm problem with the distance's second
order: the divergence is self-concordant, so of a step of local length ``d`` at least
the part ``1 / (1 + d)`` is safe; a line search may take more, and a small step is taken
in full.

`nearest_within` searches for the weight for which the compromise is the point nearest
to nominal among all that fit nearly best.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.constraints.cones.certificate import (
    GAP_TOLERANCE,
    Optimality,
    Parabola,
    ball_about,
    certify,
    unexplained,
)
from consistent_id.constraints.cones.least_norm import (
    FREE,
    ConeSolution,
    LeastNorm,
    solve_least_norm,
)
from consistent_id.constraints.cones.repeated import solve_squares
from consistent_id.constraints.priors import (
    Along,
    EntropicDistance,
    LocalRows,
    NominalDistance,
    QuadraticDistance,
)
from consistent_id.errors import ConsistentIdError, SolverError
from consistent_id.estimation.best_fit import REFERENCE, BestFit, ScaledFit, solved

_STEPS = 60
_KEPT = 0.25  # least share of each eigenvalue of a body that a Newton step leaves
_HALVINGS = 30  # resolution of the share of a Newton step
_USABLE = 1e-6  # violation, ten times the certified one; beyond it, there is no answer
_FULL = 0.25  # local length up to which a Newton step is taken in full
_STILL = 1e-7  # local length at which Newton's method has arrived
_CLOSE = 1e-4  # local length from which no more than two further steps are tried
_FINE = (1e-11, 1e-12)  # tolerances at which multipliers are computed again

# Of the search for the weight that uses up the slack:
_WEIGHTS = 30  # weights of the prior tried, at most,
_UNPROVEN = 5  # and without a certified fit in a row: the next proves no more
_FIRST = -12.0  # logarithm of the first weight over the slack; typical of real logs
_SLOPE = 1.2  # of the used share over the weight, in logarithms, near the solution
_STEEPEST = 2.0  # the same far below: the effect of a weak prior grows with its square
_PATIENCE = 3  # steps in one direction, after which they grow twofold each
_WIDE = 0.3  # width of a bracket in which interpolation may go astray
_BEYOND = 0.3  # by how much to step beyond what that slope says, so as to bracket
_STEP = np.log(1e3)  # by which the weight grows or shrinks, at the most
_AIM = 0.98  # share of the slack to use up, unless the proof needs more
_HALF = 0.5  # share of the allowed gap for the slack's unused rest
_LEAST = 1e-6  # share of the slack below which differences are rounding
_APART = 1e-6  # shares closer than that, in logarithms, show no curvature
_ROUNDING = float(np.finfo(float).eps)  # relative, of a squared misfit
_SMALL = 0.01  # squared distance that counts as zero

DISTANCE_GAP = 0.01
"""Relative gap of the squared distance (or of 0.01, if it is less) that is allowed."""


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
    fits: Sequence[ScaledFit], distance: NominalDistance, like: PenalisedFit
) -> list[PenalisedFit | None]:
    """Return compromises for data like another fit's, with its domain and weight.

    With a quadratic distance all are solved together, about that fit. Those without a
    certificate are solved again alone; None stands where there is no fit.
    """
    problems = [Compromise(fit, distance, like.weight) for fit in fits]
    start, found = like.solution.u, list[PenalisedFit | None]()
    rough: Sequence[ConeSolution | None] = [None] * len(problems)
    # Where no cone is active, one after another is faster.
    if isinstance(distance, QuadraticDistance) and like.solution.status != FREE:
        with suppress(SolverError):
            rough = solve_squares([p.near(start).problem for p in problems], start)
    for problem, solution in zip(problems, rough, strict=True):
        try:
            proof = None if solution is None else problem.certified(solution)
            if solution and proof and proof.verdict == "certified":
                found.append(problem.with_proof(solution, proof))
            else:
                found.append(problem.optimum(start))
        except ConsistentIdError:
            found.append(None)
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
            if optimality.violation > _USABLE:
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
        steep = np.linalg.lstsq((rows.G @ E).T, E.T @ rest, rcond=0.0)[0]
        curvature = fit.M
        if np.linalg.norm(steep) <= weight / 2:
            curvature = np.vstack([fit.M, np.sqrt(weight / 2) * rows.G])
        return proof(problem, below=Parabola(objective, curvature))


@dataclass(frozen=True, slots=True, eq=False)
class NearestFit:
    """The nearest point, as the optimum of a penalised fit.

    Parameters
    ----------
    slack : float
        Allowed relative increase of the misfit.
    distance_gap : float
        Bound on the relative excess of its squared distance (or of 0.01, where it is
        less) over the least within the slack; infinite if its misfit exceeds that.
    allowed : float
        Squared misfit beyond the least that the slack allows, in scaled units.
    """

    fit: PenalisedFit
    slack: float
    distance_gap: float
    allowed: float


def nearest_within(
    best: BestFit, distance: NominalDistance, slack: float
) -> NearestFit:
    """Return the point nearest to nominal whose misfit is within `slack` of the best.

    A weight of the distance makes this a well-conditioned problem; its optimum ``u`` is
    the nearest point for its own misfit.  Any ``v`` within the slack has

    ``distance(v)^2 >= distance(u)^2 - (allowed - excess(u)) / weight - gap``

    and the weight is searched for until that is as good as equality: until the slack is
    used up, or the nominal robot itself fits and a larger weight changes nothing.

    If no weight keeps the misfit within the slack, which can happen with data of hardly
    any noise, the point of the least misfit is returned, with a note.

    Parameters
    ----------
    slack : float
        Allowed relative increase of the misfit.
    """
    scaled = best.scaled
    least = scaled.excess(best.solution.u)
    # (1 + slack)^2 - 1 in a form that keeps the digits of a small slack.  What is less
    # than rounding of the misfit cannot be used up.
    increase = max(slack * (2.0 + slack), _ROUNDING)
    allowed = increase * max(least + scaled.residual**2, 1.0)
    # The proof's ball must contain the best fit.
    reach = 2.0 * float(np.linalg.norm(best.solution.u - distance.nominal))
    search = _WeightSearch(float(np.log(allowed) + _FIRST))
    kept: NearestFit | None = None
    closest: PenalisedFit | None = None
    unproven = 0
    for _ in range(_WEIGHTS):
        start = None if kept is None else kept.fit.solution.u
        weight = float(np.exp(search.log_weight))
        found = Compromise(scaled, distance, weight, reach).optimum(start)
        excess = found.excess - least
        certified = found.optimality.verdict == "certified"
        unproven = 0 if certified else unproven + 1
        if closest is None or found.excess < closest.excess:
            closest = found
        if excess <= allowed:
            now = _near(found, excess, slack, allowed)
            if kept is None or (certified and now.distance_gap < kept.distance_gap):
                kept = now
            if kept.distance_gap <= DISTANCE_GAP or unproven >= _UNPROVEN:
                break
        # Of the proof's gap, the unused rest of the slack costs (1 - share) / worth.
        worth = weight * max(found.squared_distance, _SMALL) / allowed
        aim = max(_AIM, 1.0 - _HALF * DISTANCE_GAP * worth)
        search = search.narrowed(excess / allowed, aim)
    if kept is not None:
        return _finer(scaled, distance, kept, least, reach)
    if closest is None:
        raise SolverError("no weight of the prior was tried")
    return NearestFit(closest, slack, np.inf, allowed)


def _finer(
    scaled: ScaledFit,
    distance: NominalDistance,
    kept: NearestFit,
    least: float,
    reach: float,
) -> NearestFit:
    """Return the point solved once more, if a smaller gap would prove its distance.

    A certified optimum is a small part of the misfit away from the least; of the
    distance, which has a small weight, that may be a large part.
    """
    if kept.distance_gap <= DISTANCE_GAP:
        return kept
    fit = kept.fit
    objective = max(fit.optimality.objective, REFERENCE)
    worth = fit.weight * max(fit.squared_distance, _SMALL)
    gap = _HALF * DISTANCE_GAP * worth / (2.0 * objective)
    problem = Compromise(scaled, distance, fit.weight, reach)
    found = problem.optimum(fit.solution.u, gap=gap)
    excess = found.excess - least
    if excess > kept.allowed:
        return kept
    now = _near(found, excess, kept.slack, kept.allowed)
    return min(kept, now, key=lambda near: near.distance_gap)


def _near(
    found: PenalisedFit, excess: float, slack: float, allowed: float
) -> NearestFit:
    """Return a fit with the proof of its distance, given its use of the slack."""
    short = (allowed - excess) / found.weight + found.distance_gap
    gap = short / max(found.squared_distance, _SMALL)
    return NearestFit(found, slack, gap, allowed)


class _WeightedPoint(NamedTuple):
    """Logarithms of a weight and of the share of the slack that it uses."""

    weight: float
    used: float


@dataclass(frozen=True, slots=True)
class _WeightSearch:
    """Search for the weight whose misfit uses up the slack: bracket, interpolate."""

    log_weight: float
    tried: tuple[_WeightedPoint, ...] = ()
    widths: tuple[float, ...] = ()

    def narrowed(self, used: float, aim: float = _AIM) -> "_WeightSearch":
        """Return the next search, given the share of the slack that a weight uses.

        It aims at a weight that uses the share `aim`.
        """
        here = _WeightedPoint(self.log_weight, float(np.log(max(used, _LEAST))))
        tried = (*self.tried, here)
        low = max((p for p in tried if p.used <= 0.0), default=None)
        high = min((p for p in tried if p.used > 0.0), default=None)
        if low is None or high is None:
            step = abs(here.used) / _SLOPE + _BEYOND
            step = min(step * 2.0 ** max(len(tried) - _PATIENCE, 0), _STEP)
            if high is None:
                step = max(step, abs(here.used) / _STEEPEST)
            further = step if high is None else -step
            return _WeightSearch(self.log_weight + further, tried)
        width = high.weight - low.weight
        widths = (*self.widths, width)
        if len(widths) > 2 and width > max(0.5 * widths[-3], _WIDE):
            # Interpolation moves one end only a little: the other end is too far away.
            return _WeightSearch(low.weight + 0.5 * width, tried, widths)
        weight = _interpolated(low, high, tried, float(np.log(aim)))
        weight = min(max(weight, low.weight + 0.05 * width), high.weight - 0.05 * width)
        return _WeightSearch(weight, tried, widths)


def _interpolated(
    low: _WeightedPoint,
    high: _WeightedPoint,
    tried: Sequence[_WeightedPoint],
    aim: float,
) -> float:
    """Return the weight expected to use a share, from the nearest three tried."""
    others = [p for p in tried if p not in (low, high)]
    points = [low, high, *sorted(others, key=lambda p: abs(p.used))[:1]]
    weights, used = np.array(points).T
    if np.diff(np.sort(used)).min() < _APART:
        weights, used = weights[:2], used[:2]
    # Lagrange's polynomial of the weight over the share.
    rest = [np.delete(used, i) for i in range(len(used))]
    share = [np.prod((aim - r) / (u - r)) for u, r in zip(used, rest, strict=True)]
    return float(weights @ np.array(share))
