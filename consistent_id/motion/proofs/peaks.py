"""Largest values of functions of time, proven, by dividing time where it matters."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, IntArray, Vector
from consistent_id.recordings.paths import JointPath

_SPLIT = 4
_MOST = 100_000  # stretches at once; more are given up, with the bound they have
_ROUNDING = 4.0 * np.finfo(float).eps  # of a time, relative to the latest one


class Bounds(NamedTuple):
    """Proven bounds, and values that are reached; arrays of shape (functions,)."""

    lowest: Vector
    highest: Vector
    least: Vector
    most: Vector
    least_time: Vector
    most_time: Vector


class Enclosed(NamedTuple):
    """Functions over stretches of time, each of shape (stretches, functions)."""

    value: Array
    """At the middle."""
    above: Array
    """A number that none of them exceeds in the stretch."""


class Enclosure(Protocol):
    """Encloses functions over stretches of time."""

    def __call__(self, middle: Vector, radius: float, cell: IntArray) -> Enclosed:
        """Enclose them over ``middle - radius`` to ``middle + radius`` [s].

        `cell` is which of the first, equal stretches each one is a part of.
        """


@dataclass(frozen=True, slots=True, eq=False)
class Peaks:
    """Where functions are largest; arrays of shape (functions,).

    Parameters
    ----------
    reached : ndarray
        A value that is taken, at time `at` [s].
    bound : ndarray
        Proven never to be exceeded.
    """

    reached: Vector
    at: Vector
    bound: Vector


@dataclass(slots=True)
class _Search:
    """Best values so far, and the bound of all stretches that are done with."""

    reached: Vector
    at: Vector
    bound: Vector

    def see(self, time: Vector, value: Array) -> None:
        best = value.argmax(axis=0)
        top = value[best, np.arange(value.shape[1])]
        better = top > self.reached
        self.reached = np.where(better, top, self.reached)
        self.at = np.where(better, time[best], self.at)

    def close(self, above: Array, done: BoolArray) -> None:
        self.bound = np.maximum(self.bound, np.where(done, above, -np.inf).max(axis=0))


def peaks(
    enclose: Enclosure,
    start: float,
    duration: float,
    cells: int,
    tolerance: Vector,
) -> Peaks:
    """Bound the largest value of each function over all time from start to end.

    A stretch whose bound exceeds the best value seen by less than `tolerance`, shape
    (functions,), is done with; the others are divided.
    """
    margin = _ROUNDING * (abs(start) + duration)
    cell = np.arange(cells)
    after = duration * (cell + 0.5) / cells
    radius = duration / (2 * cells)
    ends = np.array([start, start + duration])
    value = enclose(ends, 0.0, cell[[0, -1]]).value
    nothing = np.full(value.shape[1], -np.inf)
    search = _Search(nothing, nothing, nothing)
    search.see(ends, value)
    alive = np.ones((cells, value.shape[1]), dtype=bool)
    while True:
        found = enclose(start + after, radius + margin, cell)
        search.see(start + after, found.value)
        still = alive & (found.above > search.reached + tolerance)
        search.close(found.above, alive & ~still)
        rows = still.any(axis=1)
        if _SPLIT * rows.sum() > _MOST or radius < margin:
            search.close(found.above, still)
            break
        if not rows.any():
            break
        radius /= _SPLIT
        steps = radius * (2.0 * np.arange(_SPLIT) - (_SPLIT - 1))
        after = (after[rows, None] + steps).ravel()
        cell, alive = np.repeat(cell[rows], _SPLIT), np.repeat(still[rows], _SPLIT, 0)
    return Peaks(search.reached, search.at, search.bound)


def smooth_pieces(path: JointPath) -> tuple[JointPath, ...]:
    """Return the pieces of a path that has any, as a `Move` has; else the path.

    Between pieces, higher derivatives jump: both values count, and no bound of a
    derivative holds across the junction.
    """
    return tuple(getattr(path, "pieces", (path,)))


def bounds_of(found: Sequence[Peaks]) -> Bounds:
    """Return bounds from peaks of functions and of their negatives, a path's pieces."""
    reached = np.array([one.reached for one in found])
    piece, each = reached.argmax(axis=0), np.arange(reached.shape[1])
    most, least = np.split(reached[piece, each], 2)
    most_time, least_time = np.split(
        np.array([one.at for one in found])[piece, each], 2
    )
    highest, lowest = np.split(np.max([one.bound for one in found], axis=0), 2)
    return Bounds(-lowest, highest, -least, most, least_time, most_time)
