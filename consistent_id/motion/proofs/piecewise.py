"""Paths whose derivatives jump: proven piece by piece, where each piece is smooth."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.recordings.paths import JointPath


class Bounds(Protocol):
    """Proven bounds and values that are reached; arrays of shape (functions,)."""

    @property
    def lowest(self) -> Vector:
        """Proven: never below."""

    @property
    def highest(self) -> Vector:
        """Proven: never above."""

    @property
    def least(self) -> Vector:
        """Reached, at `least_time`."""

    @property
    def most(self) -> Vector:
        """Reached, at `most_time`."""

    @property
    def least_time(self) -> Vector:
        """When it is least [s]."""

    @property
    def most_time(self) -> Vector:
        """When it is most [s]."""


def smooth_pieces(path: JointPath) -> tuple[JointPath, ...]:
    """Return the pieces of a path that has any, as a `Move` has; else the path.

    Between pieces, higher derivatives jump: both values count, and no bound of a
    derivative holds across the junction.
    """
    return tuple(getattr(path, "pieces", (path,)))


class Merged(NamedTuple):
    """What `Bounds` has, as arrays of shape (functions,)."""

    lowest: Vector
    highest: Vector
    least: Vector
    most: Vector
    least_time: Vector
    most_time: Vector


def merged(found: Sequence[Bounds]) -> Merged:
    """Return the bounds of all pieces together."""
    least = np.array([one.least for one in found])
    most = np.array([one.most for one in found])
    first, last = least.argmin(axis=0), most.argmax(axis=0)
    each = np.arange(least.shape[1])
    return Merged(
        np.min([one.lowest for one in found], axis=0),
        np.max([one.highest for one in found], axis=0),
        least[first, each],
        most[last, each],
        np.array([one.least_time for one in found])[first, each],
        np.array([one.most_time for one in found])[last, each],
    )
