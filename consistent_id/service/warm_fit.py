"""The anchored constrained fit, solved again and again from where it was before.

``minimise 1/2 ||R u - z||^2  subject to  u in a ConicSet``

An anchor makes ``R`` regular, so the optimum is unique and moves little when a few data
are added.  Its central path, the minima of ``1/2 ||R u - z||^2 - mu log det(slacks)``,
is followed down to a small ``mu`` [Nesterov1994]_, from the smallest ``mu`` at which
the last fit's point is still near the path.  Newton's steps are in coordinates in which
the misfit is a distance, so ``R`` is not squared.  `certify` checks the result from the
problem's own data; if it fails, the solver of single fits takes over.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector
from consistent_id._support.tables import brief
from consistent_id.constraints.cones.certificate import (
    Optimality,
    ball_about,
    certify,
    solve_certified,
)
from consistent_id.constraints.cones.interior import find_interior
from consistent_id.constraints.cones.least_norm import ConeSolution, LeastNorm
from consistent_id.constraints.cones.programmes import Multipliers
from consistent_id.constraints.cones.sets import ConicSet, lengths, matrices, smat, svec
from consistent_id.errors import SolverError
from consistent_id.regression.linear import triangle

REFERENCE = 0.5
"""Reference of the relative gap: half the squared misfit of the residual alone."""

PATH = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 5e-9)
"""Weights of the barrier; the last leaves a relative gap of some 5e-7 for seven links,
half of what a certificate allows."""

_NEAR = 1.0  # Newton's decrement at which a point is near the path
_HELD = 20.0  # the same for a point of the last fit, from which this one may begin
_LAST = 0.25  # the same for the last weight, whose point is delivered
_STEPS = 30  # most steps for one weight
_INSIDE = 0.9  # share of the way to the boundary that a step takes at most
_BLEND = 0.1  # share of the innermost point in a start, which may lie on the boundary


class _Blocks(NamedTuple):
    """Semidefinite blocks of one order that move: `places` are theirs in the stack."""

    A: Array
    b: Matrix
    places: IntArray


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ConeCoordinates:
    """A set in coordinates of the steps that its equalities leave free.

    ``u = particular + steps v``.  Rows and blocks that no step changes are left out.

    Attributes
    ----------
    rows, bounds : ndarray
        ``rows v <= bounds``; `moving` are their numbers in the set.
    blocks : tuple
        Blocks of each order.
    inner : ndarray, shape (free,)
        The innermost point.
    """

    domain: ConicSet
    steps: Matrix
    particular: Vector
    rows: Matrix
    bounds: Vector
    moving: IntArray
    blocks: tuple[_Blocks, ...]
    inner: Vector


class PathPoint(NamedTuple):
    """A point near the central path, for a weight of the barrier."""

    mu: float
    v: Vector


@dataclass(frozen=True, slots=True, eq=False)
class WarmFit:
    """An optimum, what was proven of it, and where the next fit begins.

    Parameters
    ----------
    u : ndarray, shape (parameters,)
        Dimensionless.
    optimality : Optimality
    path : tuple of PathPoint
        From the largest weight to the smallest; empty if another solver was used.
    steps : int
        Number of steps of Newton's method.
    """

    u: Vector
    optimality: Optimality
    path: tuple[PathPoint, ...]
    steps: int


@lru_cache(maxsize=16)
def cone_coordinates(domain: ConicSet) -> ConeCoordinates:
    """Return the coordinates of a normalised set, and its innermost point.

    Raises
    ------
    SolverError
        If the set has no inner point.
    """
    spaces = domain.equalities
    inside = find_interior(domain)
    if inside.margin < 0.0:
        raise SolverError(
            f"the constraints leave no room: their best point has {inside.margin:.1e}"
        )
    particular = spaces.inverse @ domain.b_eq
    rows = domain.A_in @ spaces.steps
    moving = np.flatnonzero(rows.any(axis=1))
    stack = domain.block_rows
    A, b = stack.A @ spaces.steps, stack.b + stack.A @ particular
    return ConeCoordinates(
        domain,
        spaces.steps,
        particular,
        rows[moving],
        domain.b_in[moving] - domain.A_in[moving] @ particular,
        moving,
        tuple(_moving_blocks(A, b, stack.orders)),
        spaces.steps.T @ (inside.u - particular),
    )


def _moving_blocks(A: Matrix, b: Vector, orders: Sequence[int]) -> list[_Blocks]:
    ends = np.cumsum(lengths(orders), dtype=np.intp)
    every = [np.arange(e - n, e) for e, n in zip(ends, lengths(orders), strict=True)]
    out = []
    for order in sorted(set(orders)):
        of_order = [p for p, k in zip(every, orders, strict=True) if k == order]
        moving = [p for p in of_order if A[p].any()]
        if moving:
            places = np.stack(moving)
            out.append(_Blocks(A[places], b[places], places))
    return out


def warm_fit(
    R: Matrix,
    z: Vector,
    cone: ConeCoordinates,
    centre: Vector,
    start: Sequence[PathPoint] = (),
) -> WarmFit:
    """Return the least ``||R u - z||`` over a set, certified.

    Parameters
    ----------
    R : ndarray, shape (parameters, parameters)
        Upper triangular and regular.
    z : ndarray, shape (parameters,)
    cone : ConeCoordinates
    centre : ndarray, shape (parameters,)
        Centre of the ball in which the proof is valid.
    start : sequence of PathPoint
        Start of the last fit.

    Raises
    ------
    InfeasibleError, SolverError
        See `solve_certified`.
    """
    problem = LeastNorm(R, z, cone.domain)
    found = _followed(problem, cone, start)
    ball = ball_about(centre)
    if found is not None:
        optimality = certify(problem, found.solution, ball, reference=REFERENCE)
        if optimality.verdict == "certified":
            u = found.solution.u
            return WarmFit(u, optimality, found.path, found.steps)
    solution, optimality = solve_certified(problem, centre, reference=REFERENCE)
    return WarmFit(solution.u, optimality, (), 0)


class _Followed(NamedTuple):
    solution: ConeSolution
    path: tuple[PathPoint, ...]
    steps: int


class _Barrier(NamedTuple):
    """``1/2 ||w - target||^2 - mu log det`` in coordinates ``w = T v``."""

    size: int
    target: Vector
    rows: Matrix
    bounds: Vector
    blocks: tuple[tuple[Array, Matrix], ...]

    def slacks(self, w: Vector) -> "_Slacks | None":
        """Return the slacks at a point; None outside."""
        room = self.bounds - self.rows @ w
        if room.min(initial=np.inf) <= 0.0:
            return None
        roots = []
        for A, b in self.blocks:
            try:
                L = np.linalg.cholesky(smat(A @ w + b))
            except np.linalg.LinAlgError:
                return None
            roots.append(np.linalg.inv(L))
        return _Slacks(room, tuple(roots))


class _Slacks(NamedTuple):
    """Slacks of rows, and inverse Cholesky factors of blocks."""

    room: Vector
    roots: tuple[Array, ...]


class _NewtonStep(NamedTuple):
    """Newton's step, its decrement over ``sqrt(mu)``, and the slacks' relative changes.

    Those of blocks are stacked matrices, turned by the blocks' roots.
    """

    d: Vector
    decrement: float
    changes: Vector


class _Centred(NamedTuple):
    """A point near the path, the step that is left, and the steps before it."""

    w: Vector
    at: _Slacks
    step: _NewtonStep
    taken: int


def _followed(
    problem: LeastNorm, cone: ConeCoordinates, start: Sequence[PathPoint]
) -> _Followed | None:
    """Follow the central path; None if a point of it is not found."""
    from scipy.linalg import solve_triangular

    started = perf_counter()
    size = len(cone.inner)
    A, b = problem.G @ cone.steps, problem.g - problem.G @ cone.particular
    both = triangle(np.asfortranarray(np.column_stack([A, b])))
    T, target = both[:size, :size], both[:size, size]
    if not np.diag(T).all():
        return None
    stack = np.vstack([cone.rows, *(k.A.reshape(-1, size) for k in cone.blocks)])
    seen = solve_triangular(T, stack.T, trans=1, check_finite=False).T
    ends = np.cumsum([len(cone.rows), *(k.places.size for k in cone.blocks)])
    blocks = tuple(
        (part.reshape(*k.places.shape, size), k.b)
        for part, k in zip(np.split(seen, ends[:-1])[1:], cone.blocks, strict=True)
    )
    barrier = _Barrier(len(seen), target, seen[: len(cone.rows)], cone.bounds, blocks)
    first, w = _beginning(barrier, T, cone, start)
    path, steps, centred = [p for p in start if p.mu > PATH[first]], 0, None
    for mu in PATH[first:]:
        centred = _centred(barrier, w, mu, _LAST if mu == PATH[-1] else _NEAR)
        if centred is None:
            return None
        w = centred.w
        steps += centred.taken
        path.append(PathPoint(mu, solve_triangular(T, w, check_finite=False)))
    if centred is None:
        return None
    # With the last step, the multipliers explain the whole gradient.
    v = solve_triangular(T, w + centred.step.d, check_finite=False)
    u = cone.particular + cone.steps @ v
    multipliers = _multipliers(problem, cone, u, centred, PATH[-1])
    solution = ConeSolution(u, multipliers, "Path", 0.0, perf_counter() - started)
    return _Followed(solution, tuple(path), steps)


def _beginning(
    barrier: _Barrier, T: Matrix, cone: ConeCoordinates, start: Sequence[PathPoint]
) -> tuple[int, Vector]:
    """Return the smallest weight whose point is still near the path, and the point."""
    for number in range(min(len(start), len(PATH)) - 1, -1, -1):
        point = start[number]
        w = T @ point.v
        at = barrier.slacks(w)
        if at is not None and _newton(barrier, w, at, point.mu).decrement < _HELD:
            return PATH.index(point.mu), w
    if start:
        blend = (1.0 - _BLEND) * start[0].v + _BLEND * cone.inner
        return 0, T @ blend
    return 0, T @ cone.inner


def _centred(barrier: _Barrier, w: Vector, mu: float, near: float) -> _Centred | None:
    """Return a point near the path for a weight, by damped steps of Newton."""
    at = barrier.slacks(w)
    for count in range(_STEPS):
        if at is None:
            return None
        step = _newton(barrier, w, at, mu)
        if step.decrement < near:
            return _Centred(w, at, step, count)
        share = min(1.0, _INSIDE / max(_lost(step.changes, at), 1e-300))
        w = w + share * step.d
        at = barrier.slacks(w)
    return None


def _newton(barrier: _Barrier, w: Vector, at: _Slacks, mu: float) -> _NewtonStep:
    """Return Newton's step: ``(1 + mu W^T W) d = target - w + mu W^T e``.

    `W` has the slacks' relative changes, and `e` is that of a change which keeps their
    proportions.
    """
    W = np.empty((barrier.size, len(w)))
    first = len(at.room)
    np.divide(barrier.rows, -at.room[:, None], out=W[:first])
    slope = W[:first].sum(axis=0)
    for (A, _), inverse in zip(barrier.blocks, at.roots, strict=True):
        turn = _Turn.of(inverse.shape[-1])
        size = A.shape[0] * A.shape[1]
        part = W[first : first + size].reshape(A.shape)
        np.matmul(turn.matrices(inverse), A, out=part)
        slope += part[:, turn.diagonal].sum(axis=(0, 1))
        first += size
    slope = barrier.target - w + mu * slope
    H = mu * (W.T @ W)
    H.flat[:: len(w) + 1] += 1.0
    d = _posv()(H, slope, overwrite_a=1)[1]
    return _NewtonStep(d, float(np.sqrt(max(slope @ d, 0.0) / mu)), W @ d)


def _lost(changes: Vector, at: _Slacks) -> float:
    """Return the largest share of a slack that a step takes away."""
    first = len(at.room)
    worst = float(-changes[:first].min(initial=0.0))
    for inverse in at.roots:
        count, k = len(inverse), inverse.shape[-1]
        size = count * k * (k + 1) // 2
        of_blocks = changes[first : first + size].reshape(count, -1)
        first += size
        # No eigenvalue is beyond the norm, which is had at once.
        large = np.einsum("ki,ki->k", of_blocks, of_blocks) > max(worst, _INSIDE) ** 2
        if large.any():
            worst = max(worst, -float(np.linalg.eigvalsh(smat(of_blocks[large])).min()))
    return worst


@dataclass(frozen=True, slots=True, eq=False)
class _Turn:
    """``svec(K F K^T)`` as a matrix times ``svec(F)``, of one order."""

    i: IntArray
    j: IntArray
    weight: Matrix
    diagonal: IntArray

    @staticmethod
    @lru_cache(maxsize=8)
    def of(order: int) -> "_Turn":
        j, i = np.tril_indices(order)
        root = np.where(i == j, np.sqrt(0.5), 1.0)
        return _Turn(i, j, np.outer(root, root), np.flatnonzero(i == j))

    def matrices(self, K: Array) -> Array:
        """Return the matrix of each `K`, shape (blocks, entries, entries)."""
        left, right = K[:, self.i], K[:, self.j]
        return np.asarray(
            self.weight
            * (
                left[:, :, self.i] * right[:, :, self.j]
                + left[:, :, self.j] * right[:, :, self.i]
            )
        )


@lru_cache(maxsize=1)
def _posv() -> Callable[..., tuple[Any, ...]]:
    from scipy.linalg.lapack import dposv

    return dposv  # type: ignore[no-any-return]


def _multipliers(
    problem: LeastNorm, cone: ConeCoordinates, u: Vector, point: _Centred, mu: float
) -> Multipliers:
    """Return the multipliers after the last step.

    They are ``mu`` over the slacks, less ``mu`` times their relative changes over them.
    """
    domain, at, changes = cone.domain, point.at, point.step.changes
    first = len(at.room)
    at_most = np.zeros(len(domain.b_in))
    at_most[cone.moving] = mu * (1.0 - changes[:first]) / at.room
    stack = np.zeros(len(domain.block_rows.b))
    for block, inverse in zip(cone.blocks, at.roots, strict=True):
        k, size = inverse.shape[-1], block.places.size
        left = np.eye(k) - smat(changes[first : first + size].reshape(len(inverse), -1))
        stack[block.places] = mu * svec(np.swapaxes(inverse, 1, 2) @ left @ inverse)
        first += size
    slope = problem.G.T @ (problem.G @ u - problem.g)
    slope += domain.A_in.T @ at_most - domain.block_rows.A.T @ stack
    equal = -domain.equalities.inverse.T @ slope
    return Multipliers(equal, at_most, matrices(stack, domain.block_rows.orders))
