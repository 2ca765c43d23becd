"""Least-norm problems over convex sets.

``minimise ||G u - g||  subject to  u in a ConicSet``

in dimensionless variables.  The norm itself is the objective, a second-order cone: its
square as a quadratic objective makes interior-point solvers stop early on these
problems.  What the solver says of its own success is not used; `certify` judges.
"""

from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.constraints.cones.pinned import all_multipliers, free_set
from consistent_id.constraints.cones.programmes import (
    Ball,
    ConeRows,
    Multipliers,
    solve_cones,
)
from consistent_id.constraints.cones.sets import ConicSet

_FAR = 1e3  # norm of g beyond which to rescale, and to which to magnify

TOLERANCES = (1e-10, 1e-9, 1e-8)
"""Tolerances worth asking of the solver, from the tightest on."""


@dataclass(frozen=True, slots=True, eq=False)
class LeastNorm:
    """The problem: objective ``||G u - g||`` over a set."""

    G: Matrix
    g: Vector
    domain: ConicSet


@dataclass(frozen=True, slots=True, eq=False)
class ConeSolution:
    """A point, multipliers of ``1/2 ||G u - g||^2``, and what it took."""

    u: Vector
    multipliers: Multipliers
    status: str
    build_seconds: float
    solve_seconds: float


def solve_least_norm(
    problem: LeastNorm,
    *,
    tolerance: float = TOLERANCES[0],
    within: Ball | None = None,
    origin: Vector | None = None,
    magnified: bool = False,
    refined: bool = True,
) -> ConeSolution:
    """Solve the problem once, with the given tolerance on gap and feasibility.

    Variables are ``(t, v)`` with ``u = origin + v``, the objective is
    ``t >= ||G v - (g - G origin)||``; parameters that the set pins are none.  A ball
    keeps `u` from running away where the objective is all but flat; its multiplier is
    left out.  An origin near the optimum, instead of zero, leaves small numbers to the
    solver, whose tolerances then mean more.  A magnified problem has large ones in the
    norm instead, so that the tolerances ask for more of its digits: where the optimum
    is far below one, its multipliers need them.  Of `refined` see `solve_cones`.

    Raises
    ------
    SolverError
        If the solver returns no finite point with multipliers.
    """
    G, domain = problem.G, problem.domain
    reduced = free_set(domain)
    free, start = reduced.free, reduced.start.copy()
    if origin is not None:
        start[free] = origin[free]
    rows = reduced.about(start[free], others=1)
    g = problem.g - G @ start
    # Far from the origin, absolute tolerances would ask for digits that are not there.
    distance = float(np.linalg.norm(g)) / _FAR
    scale = distance if magnified and distance > 0.0 else max(1.0, distance)
    size = int(free.sum())
    norm = np.zeros((1 + len(g), 1 + size))
    norm[0, 0] = -1.0
    norm[1:, 1:] = -G[:, free] / scale
    rows.append(ConeRows("second order", norm, np.append(0.0, -g / scale)))
    if within is not None:
        ball = within.moved(start).rows(others=1)
        rows.append(replace(ball, A=ball.A[:, np.append(True, free)]))
    cost = np.eye(1 + size)[0]
    point = solve_cones(cost, rows, tolerance=tolerance, refined=refined)
    u = start.copy()
    u[free] += point.x[1:]
    rest = G @ u - problem.g
    # Duals of the scaled norm, turned into those of half the square of the unscaled.
    multipliers = all_multipliers(
        domain, point.duals[:3], scale * float(np.linalg.norm(rest)), G.T @ rest
    )
    return ConeSolution(
        domain.snapped(u),
        multipliers,
        point.status,
        point.build_seconds,
        point.solve_seconds,
    )
