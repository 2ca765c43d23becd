"""Convex quadratic programmes over the same cones, solved in step with each other.

``minimise 1/2 x.P x + q.x  subject to  b - A x in K``, for several ``P`` and ``q``.

The programmes of this package are small: a link's pseudo-inertia is 4 x 4.  A solver
that takes one after another spends most of its time on the way to these few numbers.
Here each operation of an interior-point method is carried out for all programmes at
once, on stacked arrays, which takes a half to a third of the time.

The method is the primal-dual one with Nesterov's and Todd's scaling and Mehrotra's
correction [Vandenberghe2010]_, whose letters are used.  Its result is not trusted: it
says which programmes ended within the tolerance, others are left to Clarabel, and
certificates check what is delivered.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, IntArray, Matrix, Vector
from consistent_id.constraints.cones.programmes import ConeRows
from consistent_id.constraints.cones.scalings import Cone, Scaling, cones_of
from consistent_id.constraints.cones.sets import row_spaces

_ITERATIONS = 50  # ten are usual
_TO_BOUNDARY = 0.99  # share of the way that a step takes
_NEAR = 0.1  # relative gap of the place where programmes that are alike start
_STUCK = 1e-3  # share of the tolerance below which a gap is that of no optimum
_EXACT = 1e-6  # error of rows and gradient, relative to the largest term
_RAISED = (0.0, 1e-14, 1e-12)  # of the diagonal
_MANY = 5  # programmes from which a common start is worth its time
_AT_ONCE = 64  # programmes, whose matrices then fit into a processor's cache


class SolvedTogether(NamedTuple):
    """Points of programmes, and multipliers of their rows.

    Parameters
    ----------
    x : ndarray, shape (programmes, variables)
    z : ndarray, shape (programmes, rows)
        As the rows are stacked, ``P x + q + A^T z = 0``; zero for equalities.
    ended : ndarray of bool, shape (programmes,)
        Whether gap, rows and gradient are within the tolerance.
    """

    x: Matrix
    z: Matrix
    ended: BoolArray


def solve_together(
    P: Array,
    q: Matrix,
    rows: Sequence[ConeRows],
    *,
    tolerance: float,
    least: Vector | None = None,
    enough: float = -np.inf,
) -> SolvedTogether:
    """Solve programmes over the same rows.

    Parameters
    ----------
    P : ndarray, shape (programmes or 1, variables, variables)
        Symmetric positive semidefinite.
    q : ndarray, shape (programmes, variables)
    rows : sequence of ConeRows
    tolerance : float
        On gap, rows and gradient, absolute or relative to the largest of their terms;
        on the latter two, a millionth at the most.
    least : ndarray, shape (programmes,), optional
        Constants of the objectives, which count when gaps are relative.
    enough : float
        A programme has also ended where its rows are within the tolerance and its
        objective is at most this, which only bounds its optimum.
    """
    least = np.zeros(len(q)) if least is None else least
    equal = [block for block in rows if block.kind == "zero" and len(block.b)]
    if equal:
        A, b = (np.concatenate([getattr(r, name) for r in equal]) for name in "Ab")
        known = row_spaces(A)
        start, steps = known.inverse @ b, known.steps
        along = [
            replace(r, A=r.A @ steps, b=r.b - r.A @ start) if r.kind != "zero" else r
            for r in rows
        ]
        least = least + (q + start @ P / 2.0) @ start
        q = (q + start @ P) @ steps
        until = _Until(tolerance, enough)
        found = _in_parts(steps.T @ P @ steps, q, along, least, until)
        return found._replace(x=start + found.x @ steps.T)
    return _in_parts(P, q, rows, least, _Until(tolerance, enough))


class _Until(NamedTuple):
    """When a programme has ended; see `solve_together`."""

    tolerance: float
    enough: float = -np.inf


def _in_parts(
    P: Array, q: Matrix, rows: Sequence[ConeRows], least: Vector, until: _Until
) -> SolvedTogether:
    cones = cones_of(rows)
    x, z = np.zeros_like(q), np.zeros((len(q), sum(len(r.b) for r in rows)))
    ended = np.zeros(len(q), dtype=bool)
    found, every = SolvedTogether(x, z, ended), _Programmes(P, q, least)
    if not cones:
        return _without_cones(every, found)
    with np.errstate(all="ignore"):
        like = _near_all(every, cones) if len(q) >= _MANY else None
        if like is not None:
            _solve_in_parts(every, cones, until, found, like)
        _solve_in_parts(every, cones, until, found)
    return found


def _without_cones(every: "_Programmes", found: SolvedTogether) -> SolvedTogether:
    """Return the points where gradients vanish."""
    P, q, _ = every
    factors, failed = _factors(np.tile(P, (len(q) // len(P), 1, 1)))
    return found._replace(x=_solutions(factors, -q), ended=~failed)


def _solve_in_parts(
    every: "_Programmes",
    cones: Sequence[Cone],
    until: _Until,
    found: SolvedTogether,
    like: "_Iterate | None" = None,
) -> None:
    """Solve what has not ended, some at a time, and write the results.

    Each starts where another one is, if that is given.
    """
    left = np.flatnonzero(~found.ended)
    for first in range(0, len(left), _AT_ONCE):
        part = left[first : first + _AT_ONCE]
        some = every.kept(part)
        # One that diverges ends its part: the others that are left have not ended.
        with suppress(np.linalg.LinAlgError):
            now = _start(some, cones) if like is None else like.repeated(some)
            _solve_part(now, cones, until, found, part)


class _Programmes(NamedTuple):
    """Objectives ``1/2 x.P x + q.x + least``."""

    P: Array
    q: Matrix
    least: Vector

    def kept(self, which: BoolArray | IntArray) -> "_Programmes":
        """Return some of them."""
        P = self.P if len(self.P) == 1 else self.P[which]
        return _Programmes(P, self.q[which], self.least[which])


class _Iterate(NamedTuple):
    """Programmes that have not ended, and where they are."""

    of: _Programmes
    x: Matrix
    scalings: list[Scaling]

    def kept(self, which: BoolArray) -> "_Iterate":
        """Return some of them."""
        scalings = [tuple(part[which] for part in each) for each in self.scalings]
        return _Iterate(self.of.kept(which), self.x[which], scalings)

    def repeated(self, others: _Programmes) -> "_Iterate":
        """Return the place of the only programme for others."""
        count = len(others.q)
        scalings = [
            tuple(np.repeat(part, count, axis=0) for part in each)
            for each in self.scalings
        ]
        return _Iterate(others, np.repeat(self.x, count, axis=0), scalings)


class _Residuals(NamedTuple):
    """Gradient that multipliers leave, rows that slacks leave, and by cone ``s.z``."""

    of_x: Matrix
    of_z: list[Matrix]
    gap: Vector
    within: BoolArray


def _solve_part(
    now: _Iterate,
    cones: Sequence[Cone],
    until: _Until,
    found: SolvedTogether,
    left: IntArray,
) -> None:
    """Solve programmes at once, and write their results."""
    for _ in range(_ITERATIONS):
        z = [c.back(w, w[-1]) for c, w in zip(cones, now.scalings, strict=True)]
        rests = _residuals(now, cones, z, until)
        found.x[left], found.ended[left] = now.x, rests.within
        for cone, duals in zip(cones, z, strict=True):
            found.z[left[:, None], cone.places] = cone.entries(duals)
        # At the boundary without an optimum, steps have become short.
        stuck = rests.gap < _STUCK * until.tolerance
        going = ~rests.within & ~stuck & np.isfinite(rests.of_x).all(axis=1)
        if not going.all():
            if not going.any():
                break
            now, left = now.kept(going), left[going]
            of_z = [rest[going] for rest in rests.of_z]
            rests = _Residuals(rests.of_x[going], of_z, rests.gap[going], going)
        now = _stepped(now, cones, rests)


def _near_all(programmes: _Programmes, cones: Sequence[Cone]) -> _Iterate | None:
    """Return where the mean programme comes by on the way to its optimum.

    There, far from all boundaries, is a good start for programmes that are alike.
    """
    mean = _Programmes(*(np.mean(part, axis=0)[None] for part in programmes))
    try:
        return _approached(_start(mean, cones), cones)
    except np.linalg.LinAlgError:
        return None


def _approached(now: _Iterate, cones: Sequence[Cone]) -> _Iterate | None:
    """Return a place with a gap of `_NEAR`; None if there is none."""
    for _ in range(_ITERATIONS):
        z = [c.back(w, w[-1]) for c, w in zip(cones, now.scalings, strict=True)]
        rests = _residuals(now, cones, z, _Until(_NEAR))
        if not np.isfinite(rests.of_x).all():
            return None
        if rests.within.all():
            return now
        now = _stepped(now, cones, rests)
    return None


def _start(programmes: _Programmes, cones: Sequence[Cone]) -> _Iterate:
    """Return the least ``1/2 x.P x + q.x + 1/2 ||A x - b||^2``, moved inside."""
    P, q, _ = programmes
    H, slope = np.tile(P, (len(q) // len(P), 1, 1)), q.copy()
    for cone in cones:
        H += cone.A.T @ cone.A
        slope -= cone.b @ cone.A
    factors, failed = _factors(H)
    x = _solutions(factors, -slope)
    x[failed] = 0.0
    s = [cone.b - x @ cone.A.T for cone in cones]
    pairs = zip(
        cones, _inside(cones, s), _inside(cones, [-each for each in s]), strict=True
    )
    return _Iterate(programmes, x, [cone.scaling(*pair) for cone, *pair in pairs])


def _inside(cones: Sequence[Cone], s: Sequence[Matrix]) -> list[Matrix]:
    """Return points, moved along the unit elements until they are inside all cones."""
    least = np.min([c.least(each) for c, each in zip(cones, s, strict=True)], axis=0)
    size = np.sqrt(sum(np.sum(each**2, axis=1) for each in s))
    shift = np.where(least <= 1e-8 * np.maximum(1.0, size), 1.0 - least, 0.0)
    return [
        each + shift[:, None] * cone.unit for cone, each in zip(cones, s, strict=True)
    ]


def _residuals(
    now: _Iterate, cones: Sequence[Cone], z: Sequence[Matrix], until: _Until
) -> _Residuals:
    curved = (now.of.P @ now.x[:, :, None])[:, :, 0]
    forces, of_z = np.zeros_like(now.x), list[Matrix]()
    for cone, duals in zip(cones, z, strict=True):
        forces += duals @ cone.A
    of_x = curved + now.of.q + forces
    gap, price, beyond = (np.zeros(len(now.x)) for _ in range(3))
    size = np.ones(len(now.x))
    for cone, w, duals in zip(cones, now.scalings, z, strict=True):
        s, values = cone.up(w, w[-1]), now.x @ cone.A.T
        of_z.append(values + s - cone.b)
        gap += np.sum(w[-1] ** 2, axis=1)
        price += duals @ cone.b
        beyond = np.maximum(beyond, abs(of_z[-1]).max(axis=1))
        size = np.maximum(size, abs(s).max(axis=1))
    half = np.sum(now.x * curved, axis=1) / 2
    primal = half + np.sum(now.of.q * now.x, axis=1) + now.of.least
    objective = np.minimum(abs(primal), abs(now.of.least - half - price))
    terms = np.maximum(abs(curved), abs(now.of.q)).max(axis=1)
    terms = np.maximum(1.0, np.maximum(terms, abs(forces).max(axis=1)))
    exact = min(until.tolerance, _EXACT)
    optimal = (gap <= until.tolerance * np.maximum(1.0, objective)) & (
        abs(of_x).max(axis=1) <= exact * terms
    )
    within = (optimal | (primal <= until.enough)) & (beyond <= exact * size)
    return _Residuals(of_x, of_z, gap, within)


def _stepped(now: _Iterate, cones: Sequence[Cone], rests: _Residuals) -> _Iterate:
    """Return the programmes after a step by prediction and correction."""
    both = list(zip(cones, now.scalings, strict=True))
    H = np.tile(now.of.P, (len(now.x) // len(now.of.P), 1, 1))
    for cone, w in both:
        cone.add_curvature(H, w)
    factors, failed = _factors(H)
    step = partial(_newton, now, both, rests, factors)
    _, ds, dz = step([-w[-1] for _, w in both])
    centring = (1.0 - np.minimum(1.0, _room(both, ds, dz))) ** 3
    target = centring * rests.gap / sum(cone.degree for cone in cones)
    x, ds, dz = step(
        [
            cone.divided(w, target[:, None] * cone.unit - cone.product(s, z)) - w[-1]
            for (cone, w), s, z in zip(both, ds, dz, strict=True)
        ],
        refined=True,
    )
    share = np.minimum(1.0, _TO_BOUNDARY * _room(both, ds, dz))[:, None]
    share[failed] = 0.0
    x[failed] = np.nan
    scalings = [
        cone.moved(w, w[-1] + share * s, w[-1] + share * z)
        for (cone, w), s, z in zip(both, ds, dz, strict=True)
    ]
    return now._replace(x=now.x + share * x, scalings=scalings)


def _newton(
    now: _Iterate,
    both: Sequence[tuple[Cone, Scaling]],
    rests: _Residuals,
    factors: Sequence[Matrix],
    wanted: Sequence[Matrix],
    *,
    refined: bool = False,
) -> tuple[Matrix, list[Matrix], list[Matrix]]:
    """Return steps for which ``lam o (W dz + W^-T ds)`` is ``lam o wanted``.

    They are those of ``x``, ``s`` and ``z``, the latter two scaled.
    """
    x = np.zeros_like(now.x)
    dz = [
        cone.down(w, rest) + d
        for (cone, w), rest, d in zip(both, rests.of_z, wanted, strict=True)
    ]
    for _ in range(1 + refined):
        slope = rests.of_x + (now.of.P @ x[:, :, None])[:, :, 0]
        for (cone, w), each in zip(both, dz, strict=True):
            slope += cone.back(w, each) @ cone.A
        more = _solutions(factors, -slope)
        x = x + more
        dz = [
            each + cone.down(w, more @ cone.A.T)
            for (cone, w), each in zip(both, dz, strict=True)
        ]
    return x, [d - each for d, each in zip(wanted, dz, strict=True)], dz


def _room(
    both: Sequence[tuple[Cone, Scaling]], ds: Sequence[Matrix], dz: Sequence[Matrix]
) -> Vector:
    """Return the multiple of a step that reaches the boundary of a cone."""
    ends = [
        cone.beyond(w, each)
        for (cone, w), *steps in zip(both, ds, dz, strict=True)
        for each in steps
    ]
    return np.asarray(1.0 / np.maximum(np.max(ends, axis=0), 1e-300))


def _factors(H: Array) -> tuple[list[Matrix], BoolArray]:
    """Return triangular factors of stacked matrices, and which have none.

    Rounding may make a matrix indefinite: its diagonal is then raised a little, which
    makes a step inexact, not its result.
    """
    from scipy.linalg.lapack import dpotrf

    found, failed = list[Matrix](), np.zeros(len(H), dtype=bool)
    for place, each in enumerate(H):
        for raised in _RAISED:
            diagonal = np.diag((1.0 + raised) * np.diag(each))
            upper = each if not raised else np.triu(each, 1) + diagonal
            factor, info = dpotrf(upper.T, lower=1, clean=0)
            if not info:
                break
        failed[place] = info != 0
        found.append(np.eye(len(factor)) if info else factor)
    return found, failed


def _solutions(factors: Sequence[Matrix], b: Matrix) -> Matrix:
    from scipy.linalg.lapack import dpotrs

    pairs = zip(factors, b, strict=True)
    return np.array([dpotrs(factor, each, lower=1)[0] for factor, each in pairs])
