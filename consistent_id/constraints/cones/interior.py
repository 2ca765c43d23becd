"""Interior points of convex sets, or proofs and causes of emptiness.

``maximise t  subject to  F_k(u) >= t 1,  A_in u <= b_in - t,  A_eq u = b_eq,  t <= 1``

For ``t < 0`` the multipliers ``Z_k >= 0`` are a proof of emptiness in the manner of
Farkas: ``sum_k <Z_k, F_k(u)>`` is the same negative number for every candidate ``u``,
while any consistent ``u`` would make it zero or more.  Rounding of its slope is bounded
in a ball of a thousand units, or ten times the best point's norm.
"""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.singular import lstsq
from consistent_id._support.tables import brief
from consistent_id.constraints.cones.programmes import (
    ConePoint,
    ConeRows,
    set_multipliers,
    set_rows,
    solve_cones,
)
from consistent_id.constraints.cones.sets import ConicSet, stacked
from consistent_id.errors import SolverError

_REACH = 1e3  # least radius of the ball of proofs
_FARTHER = 10.0  # its radius, in units of the best point's norm
_TOLERANCES = (1e-11, 1e-8)
_EQUAL = 1e-9  # residual beyond which equalities contradict each other
# Of several best points, prefer a small one.  The weight adds a slope to the proof, so
# a small margin is solved again without it.
_SMALL = (1e-7, 1e-12)
_ROUNDING = 1e-9  # bound nearer to zero than this proves nothing
_VALUES = 3  # most equalities named in a proof
_SHARE = 0.01  # least multiplier, relative to the largest, that is named


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Interior:
    """The best point of a set and its margin, negative if the set is empty.

    Parameters
    ----------
    margin : float
        The least eigenvalue or slack at the best point; negative if there is none.
    bound : float
        Proven upper bound on the margin of any point of the ball.
    u : ndarray
        The best point.
    to_blame : tuple of str
        Labels of the constraints in the proof, heaviest first.
    multipliers : tuple of ndarray
        ``Z_k`` of each semidefinite block; traces and row weights sum to one.
    """

    margin: float
    bound: float
    u: Vector
    to_blame: tuple[str, ...]
    multipliers: tuple[Matrix, ...]

    @property
    def reach(self) -> float:
        """Radius of the ball of proofs, in normalised units."""
        return _reach_of(self.u)

    @property
    def proves_empty(self) -> bool:
        """True iff the multipliers prove that no point of the ball is in the set."""
        return self.bound < -_ROUNDING


def find_interior(domain: ConicSet) -> Interior:
    """Find the point of the largest margin of a normalised set, or prove it empty.

    Raises
    ------
    SolverError
        If the solver returns no point.
    """
    contradiction, size = _contradiction(domain)
    if contradiction is not None:
        return contradiction
    found = None
    for small in _SMALL:
        try:
            found = _best_point(domain, size, small)
        except SolverError:
            if small == _SMALL[-1] and found is None:
                raise
            continue
        if found.proves_empty or found.margin >= -_ROUNDING:
            break
    if found is None:
        raise SolverError("no point was found, nor a proof that there is none")
    return found


def irreducible_conflict(domain: ConicSet) -> tuple[int, ...]:
    """Return members that contradict each other, none of them superfluous.

    Members are left out one after another as long as the others are proven to be
    contradictory [Chinneck2008]_.  Each of the remaining members is needed for the
    contradiction, and leaving out any one of them resolves it.

    Parameters
    ----------
    domain : ConicSet
        Normalised.

    Returns
    -------
    tuple of int
        Counted as in `ConicSet.labels`; empty if no contradiction is proven.
    """
    if not _proven_empty(domain):
        return ()
    kept = list(range(len(domain.labels)))
    for member in reversed(range(len(domain.labels))):
        fewer = [m for m in kept if m != member]
        if _proven_empty(domain.only(fewer)):
            kept = fewer
    return tuple(kept)


def _proven_empty(domain: ConicSet) -> bool:
    try:
        return find_interior(domain).proves_empty
    except SolverError:
        return False


def _best_point(domain: ConicSet, size: float, small: float) -> Interior:
    """Solve once; a `small` weight of the norm selects one of several best points."""
    # The solver gets a problem of unit size, for any values of the equalities.
    original, domain = domain, domain.shrunk(size)
    width = domain.A_eq.shape[1]
    # Variables (t, r, u): t <= 1 and ||u|| <= r; r has a small weight.
    norm = np.zeros((1 + width, 2 + width))
    norm[0, 1], norm[1:, 2:] = -1.0, -np.eye(width)
    cost, capped = np.zeros(2 + width), np.zeros((1, 2 + width))
    cost[:2], capped[0, 0] = (-1.0, small), 1.0
    rows = [
        *set_rows(domain, margin=True, others=2),
        ConeRows("nonnegative", capped, np.ones(1)),
        ConeRows("second order", norm, np.zeros(1 + width)),
    ]
    solved = _solved(cost, rows)
    duals = set_multipliers(domain, solved.duals[:3])
    Z, y = duals.blocks, duals.at_most
    point, domain = size * solved.x[2:], original
    bound, taken = _bound(domain, point, Z, y)
    return Interior(
        margin=_margin(domain, point),
        bound=bound,
        u=point,
        to_blame=_blame(domain, Z, y, taken),
        multipliers=Z,
    )


def _solved(cost: Vector, rows: list[ConeRows]) -> ConePoint:
    """Solve with the tightest tolerance: slopes are multiplied by a large radius."""
    for tolerance in _TOLERANCES[:-1]:
        try:
            return solve_cones(cost, rows, tolerance=tolerance)
        except SolverError:
            continue
    return solve_cones(cost, rows, tolerance=_TOLERANCES[-1])


def _contradiction(domain: ConicSet) -> tuple[Interior | None, float]:
    """Return the proof that the equalities contradict each other, if they do.

    The second value is the norm of the smallest point that satisfies them, at least
    one. The residual ``y`` of the best approximation obeys ``A_eq^T y = 0`` and
    ``y.b_eq = ||y||^2 > 0``.
    """
    if len(domain.b_eq) == 0:
        return None, 1.0
    u = lstsq(domain.A_eq, domain.b_eq)
    residual = domain.b_eq - domain.A_eq @ u
    missed = float(np.linalg.norm(residual))
    if missed <= _EQUAL * (1.0 + float(np.linalg.norm(domain.b_eq))):
        return None, max(1.0, float(np.linalg.norm(u)))
    heavy = np.argsort(-abs(residual))
    largest = abs(residual).max()
    blame = tuple(
        domain.eq_labels[i] for i in heavy if abs(residual[i]) > _SHARE * largest
    )
    nothing = tuple(np.zeros_like(block.constant) for block in domain.blocks)
    reach = _reach_of(u)
    slope = float(np.linalg.norm(domain.A_eq.T @ residual))
    bound = (slope * reach - float(residual @ domain.b_eq)) / missed
    if bound >= -_ROUNDING:
        return None, max(1.0, float(np.linalg.norm(u)))
    return Interior(-missed, bound, u, blame, nothing), 1.0


def _margin(domain: ConicSet, u: Vector) -> float:
    margins = domain.block_rows.margins(u).tolist()
    if len(domain.b_in):
        margins.append(float((domain.b_in - domain.A_in @ u).min()))
    return min(margins, default=1.0)


def _reach_of(u: Vector) -> float:
    """Return the radius in which proofs about a best point are valid."""
    return max(_REACH, _FARTHER * float(np.linalg.norm(u)))


def _bound(
    domain: ConicSet, u: Vector, Z: tuple[Matrix, ...], y: Vector
) -> tuple[float, Vector]:
    """Upper bound on the margin of any ``v`` near `u`, and multipliers of equalities.

    ``margin(v) (sum tr Z + sum y) <= sum <Z, F(v)> + y.(b_in - A_in v)``, and the right
    side is linear in ``v``: its slope, less what equalities take up, times the radius.
    """
    weight = sum(float(np.trace(z)) for z in Z) + float(y.sum())
    taken = np.zeros(len(domain.b_eq))
    if weight <= 0.0:
        return 1.0, taken
    value = float(y @ (domain.b_in - domain.A_in @ u)) if len(y) else 0.0
    slope = -domain.A_in.T @ y if len(y) else np.zeros(len(u))
    blocks, z = domain.block_rows, stacked(Z)
    value += float(z @ (blocks.A @ u + blocks.b))
    slope = slope + blocks.A.T @ z
    if len(domain.b_eq):
        taken = lstsq(domain.A_eq.T, slope)
        slope = slope - domain.A_eq.T @ taken
        value += float(taken @ (domain.b_eq - domain.A_eq @ u))
    reach = _reach_of(u)
    return float((value + np.linalg.norm(slope) * reach) / weight), taken / weight


def _blame(
    domain: ConicSet, Z: tuple[Matrix, ...], y: Vector, taken: Vector
) -> tuple[str, ...]:
    """Labels of blocks and inequalities in the proof, then of the largest values."""
    shares = [
        (float(np.trace(z)), block.description)
        for block, z in zip(domain.blocks, Z, strict=True)
    ]
    shares += list(zip(y.tolist(), domain.in_labels, strict=True)) if len(y) else []
    largest = max((share for share, _ in shares), default=0.0)
    named = [pair for pair in shares if pair[0] > _SHARE * largest]
    heavy = np.argsort(-abs(taken))[:_VALUES]
    floor = _SHARE * abs(taken).max(initial=0.0)
    values = [domain.eq_labels[i] for i in heavy if abs(taken[i]) > floor]
    return (*(label for _, label in sorted(named, reverse=True)), *values)
