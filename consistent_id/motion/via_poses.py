"""Poses to go by, where something is in the straight way between two poses.

Two trees of straight ways grow from both poses towards random ones and towards each
other, until they meet [Kuffner2000]_; then corners are cut off.
"""

from collections.abc import Callable

import numpy as np

from consistent_id._support.arrays import BoolArray, Matrix, Vector

_STEP = 0.01  # of a joint's range, at most, between poses that are looked at
_REACH = 0.25  # of a joint's range, that a tree grows at a time
_GROWTHS = 300  # of the trees; a way that needs more is narrow
_CUTS = 60  # shortcuts that are tried

Free = Callable[[Matrix], BoolArray]


def via_poses(
    begin: Vector,
    end: Vector,
    span: tuple[Vector, Vector],
    free: Free,
    rng: np.random.Generator,
) -> Matrix | None:
    """Return poses between two others, with free straight ways from each to the next.

    Parameters
    ----------
    begin, end : ndarray, shape (joints,), [rad or m]
    span : tuple of two ndarray, shape (joints,), [rad or m]
        Least and greatest position of each joint.
    free : function
        From poses, shape (poses, joints), to whether each is free.

    Returns
    -------
    ndarray, shape (poses, joints), or None if no way was found
        Without the two ends; none where the straight way is free.

    Examples
    --------
    >>> def beside_the_wall(q):  # which is open above 1
    ...     return (abs(q[:, 0]) > 0.2) | (q[:, 1] > 1.0)
    >>> ends = np.array([-1.0, 0.0]), np.array([1.0, 0.0])
    >>> span = np.array([-2.0, -2.0]), np.array([2.0, 2.0])
    >>> way = via_poses(*ends, span, beside_the_wall, np.random.default_rng(0))
    >>> bool(way[:, 1].max() > 1.0)
    True
    """
    low, high = span
    width = high - low

    def unit(pose: Vector) -> Vector:
        return np.asarray((pose - low) / width)

    def reached(here: Vector, there: Vector) -> Vector:
        """Return the last free pose on the way, in shares of the ranges."""
        count = max(int(np.ceil(abs(there - here).max() / _STEP)), 1)
        way = here + np.linspace(0.0, 1.0, count + 1)[1:, None] * (there - here)
        walls = np.flatnonzero(~free(low + way * width))
        if not len(walls):
            return there
        return here if walls[0] == 0 else np.asarray(way[walls[0] - 1])

    found = _connected(unit(begin), unit(end), reached, rng)
    if found is None:
        return None
    return np.asarray(low + _shortened(found, reached, rng)[1:-1] * width)


Reached = Callable[[Vector, Vector], Vector]


def _connected(
    begin: Vector, end: Vector, reached: Reached, rng: np.random.Generator
) -> Matrix | None:
    """Return a free way of straight pieces, both ends included."""
    grown, other = _Tree(begin), _Tree(end)
    forwards = True
    for growth in range(_GROWTHS):
        goal = end if growth == 0 else rng.uniform(size=len(begin))
        near = grown.nearest(goal)
        away = goal - grown.poses[near]
        if growth:
            away = away * min(1.0, _REACH / abs(away).max())
        new = reached(grown.poses[near], grown.poses[near] + away)
        if not np.array_equal(new, grown.poses[near]):
            grown.add(new, near)
            meeting = other.nearest(new)
            last = reached(other.poses[meeting], new)
            if not np.array_equal(last, other.poses[meeting]):
                meeting = other.add(last, meeting)
            if np.array_equal(last, new):
                there = grown.back_from(len(grown.poses) - 1)[::-1]
                back = other.back_from(meeting)[1:]
                way = np.array([*there, *back])
                return way if forwards else way[::-1]
        grown, other, forwards = other, grown, not forwards
    return None


class _Tree:
    """Poses, each but the first reached from one before it."""

    def __init__(self, root: Vector) -> None:
        self.poses, self.parents = [root], [-1]

    def nearest(self, pose: Vector) -> int:
        return int(np.argmin(abs(np.array(self.poses) - pose).max(axis=1)))

    def add(self, pose: Vector, parent: int) -> int:
        self.poses.append(pose)
        self.parents.append(parent)
        return len(self.poses) - 1

    def back_from(self, place: int) -> list[Vector]:
        """Return the poses from one of them back to the root."""
        way = []
        while place >= 0:
            way.append(self.poses[place])
            place = self.parents[place]
        return way


def _shortened(way: Matrix, reached: Reached, rng: np.random.Generator) -> Matrix:
    """Return a way with fewer corners: two poses of it, at random, are joined."""
    for _ in range(_CUTS):
        if len(way) < 3:
            break
        first, last = np.sort(rng.choice(len(way), 2, replace=False))
        if last - first < 2:
            continue
        if np.array_equal(reached(way[first], way[last]), way[last]):
            way = np.vstack([way[: first + 1], way[last:]])
    return way
