"""Meshes cut into a few convex pieces, where one hull would be far too large.

A forearm with a wrist at its end fills much less than its hull.  Cut by planes, the
hulls of the pieces still cover the body, since each cross-section lies in the hull of
its rim, but fill less between.
"""

from collections.abc import Iterator

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id.errors import ProblemError

_PLACES = np.arange(1, 8) / 8.0  # where an axis of the bounding box may be cut
_ENOUGH = 1500  # triangles by which cuts are chosen; the pieces have all of them


def convex_pieces(triangles: Array, most: int, gain: float = 0.1) -> list[Array]:
    """Return point sets whose convex hulls together cover a mesh.

    The piece and the plane, perpendicular to an axis, that save most volume are cut
    first; it ends when no cut saves `gain` of the first hull's volume.

    Parameters
    ----------
    triangles : ndarray, shape (triangles, 3, 3), [m]
        Corners of the faces of a closed surface.
    most : int
        Largest number of pieces.
    """
    if most < 1:
        raise ProblemError(f"pieces: {most} at most, expected 1 or more")
    pieces = [np.asarray(triangles, dtype=np.float64)]
    if most == 1:
        return [triangles.reshape(-1, 3)]
    whole = _volume(triangles.reshape(-1, 3))
    cuts = [_best_cut(pieces[0])]
    while len(pieces) < most:
        k = int(np.argmax([cut[0] for cut in cuts]))
        saved, axis, height = cuts[k]
        if saved < gain * whole:
            break
        parts = _below(pieces[k], axis, height), -_below(-pieces[k], axis, -height)
        pieces[k : k + 1] = parts
        cuts[k : k + 1] = [_best_cut(part) for part in parts]
    return [piece.reshape(-1, 3) for piece in pieces]


def _best_cut(triangles: Array) -> tuple[float, int, float]:
    """Volume saved by the best plane, its axis and its place on that axis.

    Of fine meshes, as seen by some of the triangles.
    """
    triangles = triangles[:: 1 + len(triangles) // _ENOUGH]
    whole = _volume(triangles.reshape(-1, 3))
    best = (0.0, 0, 0.0)
    for axis, height in _planes(triangles):
        parts = (
            _volume(_rim(triangles, axis, height, 1.0)),
            _volume(_rim(triangles, axis, height, -1.0)),
        )
        saved = whole - sum(parts)
        if min(parts) > 0.0 and saved > best[0]:
            best = (saved, axis, height)
    return best


def _planes(triangles: Array) -> Iterator[tuple[int, float]]:
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    for axis in range(3):
        for share in _PLACES:
            yield axis, float(low[axis] + share * (high[axis] - low[axis]))


def _rim(triangles: Array, axis: int, height: float, side: float) -> Array:
    """Points of one side of a plane, and where the edges meet it."""
    start, end = triangles.reshape(-1, 3), np.roll(triangles, -1, axis=1).reshape(-1, 3)
    a, b = start[:, axis] - height, end[:, axis] - height
    cross = a * b < 0.0
    share = (a[cross] / (a[cross] - b[cross]))[:, None]
    met = start[cross] + share * (end[cross] - start[cross])
    return np.concatenate([start[side * a <= 0.0], met])


def _below(triangles: Array, axis: int, height: float) -> Array:
    """Return the part of a surface below a plane, as triangles."""
    under = triangles[:, :, axis] <= height
    count = under.sum(axis=1)
    kept = [triangles[count == 3]]
    for inside in (1, 2):
        cut = triangles[count == inside]
        # The corner that is alone on its side first.
        alone = (under[count == inside] == (inside == 1)).argmax(axis=1)
        order = (alone[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(cut, order[:, :, None], axis=1).transpose(1, 0, 2)
        ab, ac = _met(a, b, axis, height), _met(a, c, axis, height)
        if inside == 1:
            kept.append(np.stack([a, ab, ac], axis=1))
        else:
            kept += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(kept)


def _met(a: Array, b: Array, axis: int, height: float) -> Array:
    share = (height - a[:, axis]) / (b[:, axis] - a[:, axis])
    return np.asarray(a + share[:, None] * (b - a))


def _volume(points: Array) -> float:
    """Volume of the hull of points; 0 if they lie in a plane."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(points).volume)
    except (QhullError, ValueError):
        return 0.0
