"""Proof that a point is optimal, without trust in the solver that found it.

Let ``f(u) = 1/2 ||G u - g||^2`` and ``v`` be any feasible point, ``d = v - u``.  Then
``f(v) = f(u) + grad f(u).d + 1/2 ||G d||^2``, and writing the gradient through
multipliers of the right sign leaves

``f(u) - f(v) <= complementarity - r.d - 1/2 ||G d||^2``

where ``r`` is the part that the multipliers do not explain.  On the steps that
equalities allow, its part along a singular vector of ``G`` with value ``s`` contributes
at most ``r_s^2 / (2 s^2)``; along all others together, where ``G`` is flat, at most the
gain of the linear function in a ball, ``radius ||r|| - r.(centre - u)``.  The least
such sum is the gap.  It is valid for any result of the solver, for all ``v`` in a ball
about a centre (the nominal robot) that is `RADIUS` times as large as the centre itself,
and reaches `RADIUS` times as far as ``u`` is from it, or in a ball that is given
(`proven_within`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.singular import svd
from consistent_id._support.tables import brief
from consistent_id.constraints.cones.least_norm import (
    TOLERANCES,
    ConeSolution,
    LeastNorm,
    free_optimum,
    solve_half_square,
    solve_least_norm,
)
from consistent_id.constraints.cones.local_metric import solve_about
from consistent_id.constraints.cones.programmes import COARSE, Ball, Multipliers
from consistent_id.constraints.cones.repeated import solve_squares
from consistent_id.constraints.cones.sets import ConicSet, stacked
from consistent_id.errors import SolverError

_FINE = (1e-12, 1e-10)  # tolerances for moderate numbers, or for magnified ones
_FLAT = 1e-3
"""Gap that no tolerance closes: the objective is flat where the point diverged."""

_MANY = 200
"""Parameters from which the first try is not refined: that saves a third of its time
and is mostly enough; with fewer, a second try costs more than it saves.
"""

_MAGNIFIED = (1e4, 1e6)
"""Factors of half the square.  Its multipliers may be better than the norm's, for free
masses and for torque that no robot has (``benchmarks/odd_torque.py``).  The first
factor is mostly enough.
"""

_LOCAL = 4
"""Solutions about the last point, in units of the room there: their gaps differ as the
solver's last digits do, and one or two are mostly enough.
"""

_NO_COST = 1e-9  # share of the objective, far below the allowed gap

OptimumVerdict = Literal["certified", "uncertified"]

GAP_TOLERANCE = 1e-6
"""Largest relative gap of a certified optimum."""

FEASIBILITY_TOLERANCE = 1e-7
"""Largest violation of a certified point, in units of typical parameters."""

RADIUS = 10.0
"""Radius of the ball of a proof, in units of one plus its centre's norm."""


@dataclass(frozen=True, slots=True)
class OptimumProof:
    """The proof about an optimum.

    Parameters
    ----------
    statement : str
        The proven statement, or the gap to it.
    allowed : str
        The allowed gaps, for a reader of a failed proof.
    """

    certified: bool
    statement: str
    allowed: str
    figures: dict[str, float] = field(default_factory=dict)


@brief
@dataclass(frozen=True, slots=True)
class Certificate:
    """The optimum's verdict, and the recomputed figures behind it.

    Parameters
    ----------
    verdict : {"certified", "uncertified"}
    reason : str
        The checks, or the failed one, in words.
    figures : dict of str to float
        Residuals, gaps, eigenvalues, by name.
    """

    verdict: OptimumVerdict
    reason: str
    figures: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Optimality:
    """The recomputed figures of a solution.

    Parameters
    ----------
    objective : float
        Half the squared norm, dimensionless.
    gap : float
        Upper bound on the excess over the optimum, divided by `reference`.
    violation : float
        Largest violation of a constraint, in units of typical parameters.
    stationarity : float
        Norm of the gradient that the multipliers leave unexplained.
    radius : float
        Radius of the ball about the centre in which the proof is valid.
    """

    objective: float
    gap: float
    violation: float
    stationarity: float
    radius: float = np.inf

    @property
    def verdict(self) -> OptimumVerdict:
        """``"certified"`` iff gap and violation are within the tolerances."""
        return "certified" if self.within(GAP_TOLERANCE) else "uncertified"

    def within(self, gap: float) -> bool:
        """Return whether the point is feasible and within a gap of the optimum."""
        return self.gap <= gap and self.violation <= FEASIBILITY_TOLERANCE


_Proven = tuple[ConeSolution, Optimality]


class Parabola(NamedTuple):
    """A parabola below a convex function that has the problem's gradient at a solution.

    Parameters
    ----------
    objective : float, optional
        Value of the function at the solution; by default the problem's own objective.
    curvature : ndarray, shape (rows, parameters), optional
        ``C`` such that the function has a curvature of ``C^T C`` or more; by default
        the problem's ``G``.
    triangle : ndarray, optional
        Factor of the curvature along the steps that equalities allow, if it is known.
    """

    objective: float | None = None
    curvature: Matrix | None = None
    triangle: Matrix | None = None


_OWN = Parabola()  # the problem's own objective


@np.errstate(over="ignore", invalid="ignore")  # what overflows has no proof
def certify(
    problem: LeastNorm,
    solution: ConeSolution,
    within: Ball,
    *,
    reference: float = 0.0,
    below: Parabola = _OWN,
    enough: float = _NO_COST,
    beyond: bool = True,
) -> Optimality:
    """Recompute feasibility and the duality gap of a solution.

    Parameters
    ----------
    within : Ball
        Where the proof is valid; see `ball_about`.
    reference : float
        Reference of the relative gap, if larger than the objective.
    below : Parabola
        Below the function whose optimality is proven.
    enough : float
        Relative gap that is small enough: no tighter bound is then computed.
    beyond : bool
        Whether the proof is valid also `RADIUS` times as far as the solution is from
        the ball's centre.
    """
    domain, centre = problem.domain, within.centre
    objective, curvature, triangle = below
    # The proof is for the nearest point on the equalities; the change of the objective
    # is part of the gap.
    u = _onto_equalities(domain, solution.u)
    moved = abs(_half_square(problem, solution.u) - _half_square(problem, u))
    objective = _half_square(problem, u) if objective is None else objective
    rest, duals = unexplained(problem, u, solution.multipliers)
    E = domain.equalities.steps
    away = float(np.linalg.norm(u - centre))
    radius = max(within.radius, RADIUS * away) if beyond else within.radius
    gap = moved + _rounding(problem, u) + _complementarity(domain, u, duals)
    scale = max(objective, reference)
    slopes, to_centre = E.T @ rest, E.T @ (centre - u)
    if triangle is None:
        curvature = problem.G if curvature is None else curvature
        triangle = _rows_of(domain.equalities.along(curvature))
    gap += _cost_of_rest(triangle, slopes, to_centre, radius, enough * scale)
    gap = min(gap, objective)  # the optimum is not below 0
    figures = (
        objective,
        gap / scale if scale > 0.0 else 0.0,
        domain.violation(solution.u),
        float(np.linalg.norm(rest)),
    )
    if not np.isfinite(figures).all():
        return Optimality(np.inf, np.inf, np.inf, np.inf, radius)
    return Optimality(*figures, radius)


def _half_square(problem: LeastNorm, u: Vector) -> float:
    return float(np.sum((problem.G @ u - problem.g) ** 2)) / 2


def _rounding(problem: LeastNorm, u: Vector) -> float:
    """Bound the rounding error of half the square, large if the point is far away."""
    G, g, size = problem.G, problem.g, len(u) + 2
    terms = abs(G) @ abs(u) + abs(g)
    error = size * np.finfo(float).eps * float(np.linalg.norm(terms))
    return error * (float(np.linalg.norm(G @ u - g)) + error)


def _onto_equalities(domain: ConicSet, u: Vector) -> Vector:
    return u + domain.equalities.inverse @ (domain.b_eq - domain.A_eq @ u)


def _complementarity(domain: ConicSet, u: Vector, duals: Multipliers) -> float:
    """Return the complementarity: multipliers times slacks, zero at the optimum."""
    paid = float(abs(duals.equal @ (domain.b_eq - domain.A_eq @ u)))
    paid += float(duals.at_most @ np.maximum(domain.b_in - domain.A_in @ u, 0.0))
    products = domain.block_rows.products(u, stacked(duals.blocks))
    return paid + float(np.maximum(products, 0.0).sum())


def ball_about(centre: Vector, reach: float = 0.0) -> Ball:
    """Return the ball in which proofs are valid, with a radius of at least `reach`."""
    return Ball(centre, max(RADIUS * (1.0 + float(np.linalg.norm(centre))), reach))


def solve_certified(
    problem: LeastNorm,
    centre: Vector,
    *,
    reference: float = 0.0,
    reach: float = 0.0,
    gap: float = GAP_TOLERANCE,
) -> tuple[ConeSolution, Optimality]:
    """Try several methods until a solution is certified; else return the best.

    The methods are: without inequalities, if the result satisfies them; at a fine
    tolerance, for large problems first unrefined, and magnified; with half the square;
    at coarser tolerances; within the ball of the proof; about the best point so far;
    with half the square, magnified more; about the best point in units of the room
    there (`solve_about`); and that point again with multipliers found about it.  If a
    larger gap is enough, the square and a coarse tolerance are tried first.  If two
    results show that the objective is `_FLAT`, half the square and other tolerances
    are skipped, and each ball is tried once.

    Raises
    ------
    SolverError
        If no method gives a point.
    """
    problem = problem.compressed()
    free = free_optimum(problem, centre)
    proof_of = partial(
        certify,
        problem,
        within=ball_about(centre, reach),
        reference=reference,
        below=Parabola(triangle=free.triangle),
        enough=_NO_COST if gap <= GAP_TOLERANCE else gap / 2.0,
    )
    if free.solution is not None:
        optimality = proof_of(free.solution)
        if optimality.within(gap):
            return free.solution, optimality
    found: list[_Proven] = []
    failures: list[str] = []
    ways = _ways(problem, centre, found, reference=reference, reach=reach, gap=gap)
    for way in ways:
        try:
            solution = way()
        except SolverError as failure:
            failures.append(str(failure))
            continue
        optimality = proof_of(solution)
        found.append((solution, optimality))
        if optimality.within(gap):
            break
    if not found:
        raise SolverError("; ".join(dict.fromkeys(failures)))
    return min(found, key=_quality)


def _ways(
    problem: LeastNorm,
    centre: Vector,
    found: Sequence[_Proven],
    *,
    reference: float,
    reach: float,
    gap: float,
) -> Iterator[Callable[[], ConeSolution]]:
    """Yield cone programmes to try, given the results so far."""
    within = ball_about(centre, reach)
    solve = partial(solve_least_norm, problem)
    if gap > GAP_TOLERANCE:
        yield lambda: solve_squares([problem], centre)[0]
        yield partial(solve, tolerance=COARSE)
    elif len(centre) >= _MANY:
        yield partial(solve, tolerance=TOLERANCES[0], refined=False)
    yield partial(solve, tolerance=TOLERANCES[0])
    yield partial(solve, tolerance=_FINE[0], magnified=True)
    early = bool(found) and not _is_flat(found)
    squares = [partial(solve_half_square, problem, times=t) for t in _MAGNIFIED]
    yield from squares[:early]
    if not _is_flat(found):
        yield from (partial(solve, tolerance=t) for t in TOLERANCES[1:])
    for ball in (within, Ball(centre, RADIUS * within.radius)):
        tolerances = _FINE[:1] if _is_flat(found) else _FINE
        yield from (partial(solve, tolerance=t, within=ball) for t in tolerances)
    if _is_flat(found):
        return
    tried: set[tuple[int, float]] = set()
    for tolerance in 2 * _FINE:
        if not found:
            return
        start = min(found, key=_quality)[0]
        # The same programme has the same solution, so only a better start helps.
        if (id(start), tolerance) not in tried:
            tried.add((id(start), tolerance))
            yield partial(solve, tolerance=tolerance, within=within, origin=start.u)
    yield from squares[early:]
    for pivoted in (False, True):
        yield from _local_ways(
            problem, centre, found, within, reference=reference, pivoted=pivoted
        )


def _local_ways(
    problem: LeastNorm,
    centre: Vector,
    found: Sequence[_Proven],
    within: Ball,
    *,
    reference: float,
    pivoted: bool,
) -> Iterator[Callable[[], ConeSolution]]:
    """Yield cone programmes about the best point so far, then about their results."""
    solution, optimality = min(found, key=_quality)
    for _ in range(_LOCAL):
        u, scale, known = solution.u, max(optimality.objective, reference), len(found)
        if not 0.0 < scale < np.inf:
            return
        away = RADIUS * float(np.linalg.norm(u - centre))
        ball = Ball(centre, max(within.radius, away))
        yield partial(solve_about, problem, u, ball, scale=scale, pivoted=pivoted)
        if len(found) == known:  # it failed, and would fail again
            return
        about = found[-1]
        if pivoted:
            # Where the objective is flat, it may be far away, where rounding is large.
            # Its multipliers prove the nearer point, too.
            yield partial(replace, about[0], u=u)
        solution, optimality = about


def proven_within(
    problem: LeastNorm,
    solution: ConeSolution,
    within: Ball,
    *,
    start: Vector,
    reference: float,
) -> tuple[ConeSolution, Optimality]:
    """Prove that no point of a ball is better than a solution, or than a better one.

    The solution may be outside the ball: it is then at least as good as all points
    inside.  If it is not proven, it is solved again in the ball, about a start.
    """
    problem = problem.compressed()
    proof_of = partial(
        certify, problem, within=within, reference=reference, beyond=False
    )
    found = [(solution, proof_of(solution))]
    for pivoted in _LOCAL * [False] + [True]:
        optimality = found[-1][1]
        scale = max(optimality.objective, reference)
        if optimality.verdict == "certified" or not 0.0 < scale < np.inf:
            break
        try:
            solution = solve_about(problem, start, within, scale=scale, pivoted=pivoted)
        except SolverError:
            break
        found.append((solution, proof_of(solution)))
        start = solution.u
    return min(found, key=_quality)


def _is_flat(found: Sequence[_Proven]) -> bool:
    """Return whether two solutions show that the objective is `_FLAT`."""
    solved = [o.gap for _, o in found if o.violation <= FEASIBILITY_TOLERANCE]
    return len(solved) > 1 and min(solved) > _FLAT


def _quality(pair: _Proven) -> tuple[float, float]:
    """Return by what a point is outside, if it is, and its gap: the less, the better.

    The gap of a point outside says nothing about points inside.
    """
    outside, gap = pair[1].violation, pair[1].gap
    return outside if outside > FEASIBILITY_TOLERANCE else 0.0, gap


def _cost_of_rest(
    curvature: Matrix, rest: Vector, to_centre: Vector, radius: float, enough: float
) -> float:
    """Bound ``-rest.d - 1/2 ||curvature d||^2`` for steps ``d`` that end in the ball.

    All is in coordinates of the steps that equalities allow.  If the bound with only
    the null space as flat is small `enough`, no better one is computed.
    """
    bound = _bound_by_qr(curvature, rest, to_centre, radius)
    if bound <= enough:
        return bound
    _, s, Vt = svd(curvature)
    s = np.append(s, np.zeros(len(Vt) - len(s)))
    along, to_centre = Vt @ rest, Vt @ to_centre
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        turns = np.where(s > 0.0, (along / s) ** 2 / 2, np.inf)
    # The first k directions, with the least curvature, are treated as flat; the best k
    # is used.
    order = np.argsort(-turns)
    along, to_centre = along[order], to_centre[order]
    parabolas = np.append(np.cumsum(turns[order][::-1])[::-1], 0.0)
    sizes = np.sqrt(np.append(0.0, np.cumsum(along**2)))
    gains = np.append(0.0, np.cumsum(along * to_centre))
    ends = np.maximum(radius * sizes - gains, 0.0)
    return float((parabolas + ends).min())


def _rows_of(curvature: Matrix) -> Matrix:
    """Return no more rows than columns, triangular ones where there are as many."""
    if len(curvature) < curvature.shape[1]:
        return curvature
    return np.asarray(np.linalg.qr(curvature, mode="r"))


def _bound_by_qr(rows: Matrix, rest: Vector, to_centre: Vector, radius: float) -> float:
    """Return the bound with the null space as flat.

    It is infinite where rows are dependent, which takes singular values.
    """
    from scipy.linalg import solve_triangular

    R, along, end = rows, rest, 0.0
    if wide := (len(rows) < len(rest)):
        Q, R = np.linalg.qr(rows.T)
        along = Q.T @ rest
        flat = rest - Q @ along
        end = radius * float(np.linalg.norm(flat)) - float(flat @ to_centre)
    if not np.diag(R).all():
        return np.inf
    with np.errstate(over="ignore", invalid="ignore"):
        turn = solve_triangular(R, along, trans=int(not wide), check_finite=False)
        bound = float(turn @ turn) / 2 + max(end, 0.0)
    return bound if np.isfinite(bound) else np.inf


def unexplained(
    problem: LeastNorm, u: Vector, duals: Multipliers
) -> tuple[Vector, Multipliers]:
    """Gradient that multipliers do not explain, after refining those of equalities."""
    domain = problem.domain
    rest = problem.G.T @ (problem.G @ u - problem.g)
    rest = rest + domain.A_in.T @ duals.at_most
    rest = rest - domain.block_rows.A.T @ stacked(duals.blocks)
    equal = -domain.equalities.inverse.T @ rest
    refined = Multipliers(equal, duals.at_most, duals.blocks)
    return rest + domain.A_eq.T @ equal, refined
