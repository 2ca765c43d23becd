"""Several least-norm problems over one set, solved together and certified."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

from consistent_id._support.arrays import Vector
from consistent_id.constraints.cones.certificate import (
    GAP_TOLERANCE,
    Optimality,
    Parabola,
    ball_about,
    certify,
)
from consistent_id.constraints.cones.least_norm import (
    ConeSolution,
    LeastNorm,
    free_optimum,
)
from consistent_id.constraints.cones.repeated import solve_squares
from consistent_id.errors import SolverError

_ENOUGH = 0.1  # share of the allowed gap below which no tighter bound is computed


def certified_squares(
    problems: Sequence[LeastNorm],
    centre: Vector,
    origin: Vector,
    *,
    reference: float = 0.0,
    reach: float = 0.0,
    gap: float = GAP_TOLERANCE,
) -> list[tuple[ConeSolution, Optimality] | None]:
    """Solve problems over the same domain; None where no optimum is proven.

    Least squares without the links' cones is tried first.  What it leaves is solved
    together, by the squares of the norms.

    Parameters
    ----------
    problems : sequence of LeastNorm
    centre : ndarray, shape (parameters,)
        Of the balls in which proofs are valid, see `ball_about`.
    origin : ndarray, shape (parameters,)
        A point near the optima.
    reference, gap
        See `solve_certified`.
    """
    within = ball_about(centre, reach)
    found: list[tuple[ConeSolution, Optimality] | None] = []
    left: list[_Open] = []
    for place, problem in enumerate(each.compressed() for each in problems):
        free = free_optimum(problem, centre)
        prove = partial(
            certify,
            problem,
            within=within,
            reference=reference,
            below=Parabola(triangle=free.triangle),
            enough=_ENOUGH * gap,
        )
        solution = free.solution
        proof = None if solution is None else prove(solution)
        if solution is not None and proof is not None and proof.within(gap):
            found.append((solution, proof))
        else:
            found.append(None)
            left.append(_Open(place, problem, prove))
    if not left:
        return found
    try:
        solutions = solve_squares([case.problem for case in left], origin)
    except SolverError:
        return found
    for case, solution in zip(left, solutions, strict=True):
        proof = case.prove(solution)
        if proof.within(gap):
            found[case.place] = solution, proof
    return found


class _Open(NamedTuple):
    """A problem that needs cones, its place, and the proof of a solution."""

    place: int
    problem: LeastNorm
    prove: Callable[[ConeSolution], Optimality]
