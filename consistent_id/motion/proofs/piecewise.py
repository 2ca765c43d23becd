"""Paths whose derivatives jump: proven piece by piece, where each piece is smooth."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.motion.proofs.peaks import Peaks
from consistent_id.recordings.paths import JointPath


class Bounds(NamedTuple):
    """Proven bounds, and values that are reached; arrays of shape (functions,)."""

    lowest: Vector
    highest: Vector
    least: Vector
    most: Vector
    least_time: Vector
    most_time: Vector


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
