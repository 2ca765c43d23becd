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
and reaches `RADIUS` times as far as ``u`` is from it.

`conic_optimum` makes the same proof for the form that CVXPY gives a convex problem,
``minimise f(y) = 1/2 y.P y + q.y  subject to  b - A y in K``.  With ``g = P y + q`` and
multipliers in the dual cone, no feasible ``y'`` of a ball has less than
``f(y) + g.(y' - y)``, and `lower_bound` returns a lower bound of ``g.y'``.
"""

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.tables import brief
from consistent_id.constraints.cones.least_norm import (
    TOLERANCES,
    ConeSolution,
    LeastNorm,
    free_optimum,
    solve_half_square,
    solve_least_norm,
)
from consistent_id.constraints.cones.programmes import (
    COARSE,
    Ball,
    ConeKind,
    ConeRows,
    Multipliers,
    lower_bound,
)
from consistent_id.constraints.cones.repeated import solve_squares
from consistent_id.constraints.cones.sets import (
    ConicSet,
    lengths,
    stacked,
)
from consistent_id.errors import InfeasibleError, SolverError

_FINE = (1e-12, 1e-10)  # tolerances for moderate numbers, or for magnified ones
_FLAT = 1e-3
"""Gap that no tolerance of the solver closes: the objective is flat in directions in
which the point diverged, and only a ball can bound it.
"""

_MANY = 200
"""Number of parameters from which the first try is not refined: this saves a third of
the solver's time and is mostly enough; for fewer parameters, a second try costs more
than it saves.
"""

_MAGNIFIED = (1e4, 1e6)
"""Factors of half the square, tried last.  Four problems with torque that no robot has
(``benchmarks/odd_torque.py``) were proven by nothing else; these prove three of them.
"""

_NO_COST = 1e-9  # share of the objective, far below the allowed gap

OptimumVerdict = Literal["certified", "uncertified"]

GAP_TOLERANCE = 1e-6
"""Largest relative gap of a certified optimum."""

FEASIBILITY_TOLERANCE = 1e-7
"""Largest violation of a certified point, in units of typical parameters."""

RADIUS = 10.0
"""Radius of the ball in which a proof is valid, in units of one plus its centre's
norm.
"""

CLARABEL = {"tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10, "tol_feas": 1e-10}
"""Options of the solver."""


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


def certify(
    problem: LeastNorm,
    solution: ConeSolution,
    within: Ball,
    *,
    reference: float = 0.0,
    below: Parabola = _OWN,
    enough: float = _NO_COST,
) -> Optimality:
    """Recompute feasibility and the duality gap of a solution.

    Parameters
    ----------
    within : Ball
        Where the proof is valid, at least; see `ball_about`.
    reference : float
        Reference of the relative gap, if larger than the objective.
    below : Parabola
        Below the function whose optimality is proven.
    enough : float
        Relative gap that is small enough: no tighter bound is then computed.
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
    radius = max(within.radius, RADIUS * away)
    gap = moved + _complementarity(domain, u, duals)
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

    The methods are: without inequalities, if the result satisfies them; at several
    tolerances, for large problems first unrefined, and magnified; within the ball of
    the proof; about the best point so far; with half the square.  If a larger gap is
    enough, the square and a coarse tolerance are tried first.  If two results show that
    the objective is `_FLAT`, other tolerances are skipped, and each ball is tried once.

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
    for way in _ways(problem, centre, found, reach=reach, gap=gap):
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
    yield from (partial(solve_half_square, problem, times=t) for t in _MAGNIFIED)


def _is_flat(found: Sequence[_Proven]) -> bool:
    """Return whether two solutions show that the objective is `_FLAT`."""
    solved = [o.gap for _, o in found if o.violation <= FEASIBILITY_TOLERANCE]
    return len(solved) > 1 and min(solved) > _FLAT


def _quality(pair: _Proven) -> tuple[bool, float]:
    optimality = pair[1]
    return optimality.violation > FEASIBILITY_TOLERANCE, optimality.gap


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
    _, s, Vt = np.linalg.svd(curvature)
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
    wide = len(rows) < len(rest)
    if wide:
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


class ConicOptimum(NamedTuple):
    """``minimise 1/2 y.P y + q.y`` over rows, and a point with multipliers."""

    rows: tuple[ConeRows, ...] | None
    slope: Vector
    y: Vector
    duals: list[Vector]

    def gap(self) -> float:
        """Return the largest possible decrease of the objective in the ball."""
        within = ball_about(self.y)
        bound = lower_bound(self.slope, self.rows or (), self.duals, within)
        return max(float(self.slope @ self.y) - bound, 0.0)

    def violation(self) -> float:
        """Return the distance of the point from the cones."""
        return max((block.violation(self.y) for block in self.rows or ()), default=0.0)


def conic_optimum(problem: Any) -> ConicOptimum:
    """Solve by Clarabel, and assign the values of the problem's variables.

    The result has no rows if the problem needs unsupported cones.
    """
    import cvxpy as cp

    try:
        options = dict(CLARABEL)
        data, chain, inverse = problem.get_problem_data(
            cp.CLARABEL, solver_opts=options
        )
        found = chain.solve_via_data(problem, data, solver_opts=options)
        with warnings.catch_warnings():
            # "Solution may be inaccurate": the proof shows it, with figures.
            warnings.simplefilter("ignore", UserWarning)
            problem.unpack_results(found, chain, inverse)
    except (cp.error.SolverError, ValueError) as cause:
        raise SolverError(f"CVXPY found no point: {cause}") from None
    if "infeasible" in problem.status:
        raise InfeasibleError(
            "no parameters satisfy the package's constraints and your own together; "
            "loosen your own; CVXPY does not name them"
        )
    y, z = np.asarray(found.x), np.asarray(found.z)
    if problem.status not in ("optimal", "optimal_inaccurate"):
        raise SolverError(
            f"CVXPY ended {problem.status!r}; is the objective bounded from below?"
        )
    P = data.get("P")
    slope = data["c"] if P is None else data["c"] + P @ y
    rows = _cone_rows(data["A"].toarray(), data["b"], data["dims"])
    ends = np.cumsum([len(block.b) for block in rows or ()])[:-1]
    return ConicOptimum(rows, slope, y, np.split(z, ends))


def _cone_rows(A: Matrix, b: Vector, dims: Any) -> tuple[ConeRows, ...] | None:
    """Return CVXPY's rows, zero cone first; None if other cones are among them."""
    kinds: list[tuple[ConeKind, int, tuple[int, ...]]] = [
        ("zero", dims.zero, ()),
        ("nonnegative", dims.nonneg, ()),
        *(("second order", size, ()) for size in dims.soc),
        ("semidefinite", sum(lengths(dims.psd)), tuple(dims.psd)),
    ]
    ends = np.cumsum([size for _, size, _ in kinds])
    if ends[-1] != len(b):
        return None
    return tuple(
        ConeRows(kind, A[end - size : end], b[end - size : end], orders)
        for (kind, size, orders), end in zip(kinds, ends, strict=True)
    )
