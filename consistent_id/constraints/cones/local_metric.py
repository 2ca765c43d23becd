"""A least-norm problem solved again about a point, in units of the room around it.

Torque that no robot has is fitted best by robots that none is: links of a thousand
times their typical size in one direction, and without thickness in another.  An
eigenvalue of such a link may be 1e10 times another one, and so may be the multipliers'.
A solver's tolerance is then a small part of the largest of them, and all of the others.

About a point `u` of the problem, a step ``d`` has a cost of
``slope.d + 1/2 ||G d||^2``, in which the misfit at `u` is not a large constant that
takes the digits.  Slacks are divided by their value at `u`, and links transformed to
``T J(u + d) T`` with ``T = J(u)^-1/2``, which is one at `u`: each eigenvalue counts
relative to its own size there.  The steps' coordinates are those in which the sum of
all squares, of slacks, links, misfit and the ball, is a sphere.

The transformation is exact: multipliers ``Z`` of transformed links are ``T Z T`` of the
links themselves.  Certificates check the result in the original coordinates.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.constraints.cones.least_norm import (
    ConeSolution,
    LeastNorm,
    all_multipliers,
    free_set,
)
from consistent_id.constraints.cones.programmes import (
    Ball,
    ConePoint,
    ConeRows,
    solve_cones,
)
from consistent_id.constraints.cones.sets import (
    lengths,
    matrices,
    smat,
    stacked,
    svec,
)

_ROOM = 1e-6
"""Least slack or eigenvalue that counts as room: below it, multipliers are accurate
enough, and a link that is flat up to rounding has no inverse.
"""

_MAGNIFIED = 1e10
"""Objective in the solver's units: its tolerances are absolute."""

_TOLERANCE = 1e-10


class _Room(NamedTuple):
    """Rows in units of their room, and what turns their multipliers back.

    Parameters
    ----------
    sizes : ndarray
        By which inequalities are divided.
    roots : tuple of ndarray
        ``T`` of each semidefinite block.
    """

    equal: ConeRows
    at_most: ConeRows
    blocks: ConeRows
    sizes: Vector
    roots: tuple[Matrix, ...]

    def duals(self, point: ConePoint) -> list[Vector]:
        """Return the multipliers of the rows in their own units."""
        equal, at_most, z = point.duals[:3]
        blocks = matrices(z, self.blocks.orders)
        pairs = zip(self.roots, blocks, strict=True)
        return [equal, at_most / self.sizes, stacked([T @ Z @ T for T, Z in pairs])]


def solve_about(
    problem: LeastNorm,
    start: Vector,
    within: Ball,
    *,
    scale: float,
    pivoted: bool = True,
) -> ConeSolution:
    """Solve the problem within a ball, by a step from a point near its solution.

    Parameters
    ----------
    start : ndarray, shape (parameters,)
        The point; it need not be feasible.
    scale : float
        Size of the objective, half a square, of which a small part is to be accurate.
    pivoted : bool
        Whether rows are sorted and columns pivoted, see `_metric`.

    Raises
    ------
    SolverError
        If the solver returns no finite point with multipliers.
    """
    G, domain = problem.G, problem.domain
    reduced = free_set(domain)
    free, u = reduced.free, reduced.start.copy()
    u[free] = start[free]
    times = _MAGNIFIED / scale
    rows = G[:, free] * np.sqrt(times)
    residual = np.sqrt(times) * (G @ u - problem.g)
    ball = within.moved(u).rows()
    ball = replace(ball, A=ball.A[:, free])
    room = _in_units_of_room(*reduced.about(u[free]), far=float(abs(u).max()))
    metric, (blocks, at_most, ball_rows, rows) = _metric(
        [room.blocks.A, room.at_most.A, ball.A, rows], pivoted=pivoted
    )
    cones = [
        replace(room.equal, A=room.equal.A @ metric),
        replace(room.at_most, A=at_most),
        replace(room.blocks, A=blocks),
        replace(ball, A=ball_rows),
    ]
    point = _cheapest_step(rows, residual, cones)
    u[free] += metric @ point.x[-len(metric) :]
    return ConeSolution(
        domain.snapped(u),
        all_multipliers(
            domain, room.duals(point), 1.0 / times, G.T @ (G @ u - problem.g)
        ),
        point.status,
        point.build_seconds,
        point.solve_seconds,
    )


def _in_units_of_room(
    equal: ConeRows, at_most: ConeRows, blocks: ConeRows, *, far: float
) -> _Room:
    """Return rows in units of the room that they leave at the origin."""
    sizes = np.maximum(at_most.b, _ROOM * max(1.0, far))
    A, b, roots = blocks.A.copy(), blocks.b.copy(), []
    ends = np.cumsum([0, *lengths(blocks.orders)])
    for F, low, high in zip(
        matrices(blocks.b, blocks.orders), ends[:-1], ends[1:], strict=True
    ):
        values, vectors = np.linalg.eigh(F)
        room = np.maximum(values, _ROOM * max(1.0, float(values[-1])))
        T = (vectors / np.sqrt(room)) @ vectors.T
        A[low:high] = svec(T @ smat(A[low:high].T) @ T).T
        b[low:high] = svec(T @ F @ T)
        roots.append(T)
    return _Room(
        equal,
        replace(at_most, A=at_most.A / sizes[:, None], b=at_most.b / sizes),
        replace(blocks, A=A, b=b),
        sizes,
        tuple(roots),
    )


def _metric(
    parts: Sequence[Matrix], *, pivoted: bool = True
) -> tuple[Matrix, list[Matrix]]:
    """Return ``V`` such that ``||A V e|| = ||e||``, and ``A V`` of each of the parts.

    ``A`` are the parts under each other; it has full rank.  Rows of the misfit may be
    1e14 times those of links.  Householder's method keeps the digits of small rows if
    large ones come first and columns are pivoted [Cox1998]_.  Parts of the orthonormal
    factor have all digits that products with ``V`` lose.  Where ``V`` itself is
    inaccurate, the products are what a step with it changes: without pivots, they are
    returned.
    """
    from scipy.linalg import qr, solve_triangular

    A = np.vstack(parts)
    if not pivoted:
        R = np.linalg.qr(A, mode="r")
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            V = solve_triangular(R, np.eye(len(R)), check_finite=False)
            return V, [part @ V for part in parts]
    order = np.argsort(-abs(A).max(axis=1), kind="stable")
    Q = np.empty(A.shape)
    Q[order], R, pivots = qr(
        A[order], mode="economic", pivoting=True, check_finite=False
    )
    V = np.empty(R.shape)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        V[pivots] = solve_triangular(R, np.eye(len(R)), check_finite=False)
    return V, np.split(Q, np.cumsum([len(part) for part in parts])[:-1])


def _cheapest_step(G: Matrix, residual: Vector, cones: list[ConeRows]) -> ConePoint:
    """Minimise ``1/2 ||residual + G e||^2`` over steps `e` in cones.

    Variables are ``(r, e)`` with ``r = G e`` up to a rotation; the square of the
    residual itself is left out.
    """
    R = np.asarray(np.linalg.qr(G, mode="r"))
    count, size = R.shape
    rows = [replace(c, A=np.hstack([np.zeros((len(c.b), count)), c.A])) for c in cones]
    rows.insert(-1, ConeRows("zero", np.hstack([np.eye(count), -R]), np.zeros(count)))
    cost = np.append(np.zeros(count), G.T @ residual)
    curvature = np.where(np.arange(count + size) < count, 1.0, 0.0)
    return solve_cones(cost, rows, tolerance=_TOLERANCE, curvature=curvature)
