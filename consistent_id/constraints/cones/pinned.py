"""A convex set without the parameters that equalities pin, for solvers.

A mass from the datasheet, or a link that is known, is no unknown of a programme.  What
is left of the set is in the free parameters alone; semidefinite blocks of pinned ones
are numbers, and are left out where they hold.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from consistent_id._support.arrays import BoolArray, IntArray, Vector
from consistent_id.constraints.cones.matrices import (
    least_eigenvalues,
    lengths,
    stacked,
)
from consistent_id.constraints.cones.programmes import (
    ConeRows,
    Multipliers,
    set_multipliers,
    set_rows,
)
from consistent_id.constraints.cones.sets import ConicSet, block_rows

_HOLDS = 1e-8  # by which a number may miss what a normalised set asks of it


@dataclass(frozen=True, slots=True, eq=False)
class FreeSet:
    """What a set asks of the parameters that it does not pin.

    Parameters
    ----------
    free : ndarray of bool, shape (parameters,)
    start : ndarray, shape (parameters,)
        Values of pinned parameters; zero for free ones.
    rows : tuple of ConeRows
        For the free parameters: equalities, inequalities, semidefinite blocks.
    pins : ndarray of int, shape (pinned,)
        Equalities that pin parameters, in the order of the parameters.
    equal : ndarray of int
        Equalities that are left.
    entries : ndarray of bool
        Which entries of the set's stacked blocks are left.
    """

    free: BoolArray
    start: Vector
    rows: tuple[ConeRows, ConeRows, ConeRows]
    pins: IntArray
    equal: IntArray
    entries: BoolArray

    def about(self, y: Vector, others: int = 0) -> list[ConeRows]:
        """Return the rows for variables ``(others, steps of free parameters from y)``.

        Parameters
        ----------
        y : ndarray, shape (free,)
        others : int
        """
        return [
            replace(
                cone,
                A=np.pad(cone.A, ((0, 0), (others, 0))),
                b=cone.b - cone.A @ y,
            )
            for cone in self.rows
        ]


@lru_cache(maxsize=16)
def free_set(domain: ConicSet) -> FreeSet:
    """Return what a normalised set asks of the parameters that it does not pin."""
    alone = np.flatnonzero(np.count_nonzero(domain.A_eq, axis=1) == 1)
    columns = np.argmax(domain.A_eq[alone] != 0.0, axis=1)
    pinned, first = np.unique(columns, return_index=True)
    pins = alone[first]
    start = np.zeros(domain.A_eq.shape[1])
    start[pinned] = domain.b_eq[pins] / domain.A_eq[pins, pinned]
    free = np.ones(len(start), dtype=bool)
    free[pinned] = False
    equal, at_most, blocks = (
        replace(cone, A=cone.A[:, free], b=cone.b - cone.A @ start)
        for cone in set_rows(domain)
    )
    # A second row that pins a parameter is either the same or a contradiction.
    left = equal.A.any(axis=1) | (abs(equal.b) > _HOLDS)
    left[pins] = False
    number = np.repeat(np.arange(len(blocks.orders)), lengths(blocks.orders))
    asks = least_eigenvalues(blocks.b, blocks.orders) < -_HOLDS
    asks[number[blocks.A.any(axis=1)]] = True
    entries = asks[number]
    orders = tuple(k for k, kept in zip(blocks.orders, asks, strict=True) if kept)
    rows = (
        replace(equal, A=equal.A[left], b=equal.b[left]),
        at_most,
        ConeRows("semidefinite", blocks.A[entries], blocks.b[entries], orders),
    )
    return FreeSet(free, start, rows, pins, np.flatnonzero(left), entries)


def all_multipliers(
    domain: ConicSet, duals: Sequence[Vector], size: float, slope: Vector
) -> Multipliers:
    """Return multipliers of all of a set's constraints.

    Those of pins are what the others leave of the objective's gradient.

    Parameters
    ----------
    domain : ConicSet
    duals : sequence of ndarray
        Of the rows of `free_set`.
    size : float
        By which these are multiplied.
    slope : ndarray, shape (parameters,)
        The gradient.
    """
    found = free_set(domain)
    equal, z = np.zeros(len(domain.b_eq)), np.zeros(len(found.entries))
    equal[found.equal], z[found.entries] = duals[0], duals[2]
    others = set_multipliers(domain, (equal, duals[1], z)).times(size)
    pinned = ~found.free
    left = slope + domain.A_eq.T @ others.equal + domain.A_in.T @ others.at_most
    left -= block_rows(domain).A.T @ stacked(others.blocks)
    of_pins = -left[pinned] / domain.A_eq[found.pins, pinned]
    equal = others.equal.copy()
    equal[found.pins] = of_pins
    return replace(others, equal=equal)
