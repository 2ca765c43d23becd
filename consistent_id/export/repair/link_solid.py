"""The solid that a link's shapes fill, if it were of one density throughout."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.errors import ModelError, ProblemError
from consistent_id.motion.collisions.urdf_bodies import link_bodies
from consistent_id.robot.loaders.xml import Element

_DIRECTIONS = 400  # in which a shape's farthest point is taken: hulls to about 1 %
_FLAT = 1e-4  # least thickness over size; what is thinner has no volume to speak of


@dataclass(frozen=True, slots=True, eq=False)
class LinkSolid:
    """The convex hull of a link's shapes, in the link's frame.

    Parameters
    ----------
    points : ndarray, shape (points, 3), [m]
        Corners of the hull.
    volume : float, [m^3]
    spread : ndarray, shape (3, 3), [m^2]
        Second moments of mass about the centre, over the mass, at one density.
    """

    points: Array
    volume: float
    spread: Matrix

    def reach(self, point: Vector) -> float:
        """Return the distance from a point to the farthest corner, [m].

        No body inside the hull with its centre of mass there has a larger radius of
        gyration.
        """
        return float(np.linalg.norm(self.points - point, axis=1).max())


def hull_solid(points: Array) -> LinkSolid | None:
    """Return the solid hull of points; None if they lie in a plane."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return None
    corners = points[hull.vertices]
    inside = corners.mean(axis=0)
    tetrahedra = points[hull.simplices] - inside  # the fourth corner is inside
    volumes = abs(np.linalg.det(tetrahedra)) / 6.0
    volume = float(volumes.sum())
    sums = tetrahedra.sum(axis=1)
    centre = volumes @ sums / (4.0 * volume)
    # Of a tetrahedron, int x x^T = V/20 (sum of x_i x_i^T + s s^T), s the sum of x_i.
    corner = np.einsum("t,tia,tib->ab", volumes, tetrahedra, tetrahedra)
    whole = np.einsum("t,ta,tb->ab", volumes, sums, sums)
    spread = (corner + whole) / (20.0 * volume) - np.outer(centre, centre)
    axes = np.linalg.eigvalsh(spread)
    if axes[0] <= _FLAT**2 * axes[2]:
        return None
    return LinkSolid(corners, volume, spread)


def link_solids(path: Path, root: Element) -> Mapping[str, LinkSolid]:
    """Return the solids of a URDF's links, by name.

    Visual shapes are taken, or collision shapes where there are no others.  A link with
    a shape that cannot be read has no solid: part of a shape would mislead.
    """
    solids = {}
    for link in root.all("link"):
        points = list(_points(path, link))
        solid = hull_solid(np.vstack(points)) if points else None
        if solid is not None:
            solids[link.name] = solid
    return solids


def _points(path: Path, link: Element) -> Iterator[Array]:
    try:
        bodies = link_bodies(path, link, elements="visual")
    except (ModelError, ProblemError):
        return
    around = directions()
    for body in bodies:
        farthest = body.shape.farthest(around)
        corners = np.unique(farthest, axis=0)
        yield corners @ np.asarray(body.rotation).T + np.asarray(body.translation)


def directions() -> Array:
    """Return unit vectors spread evenly over the sphere, on a Fibonacci spiral.

    The last eight point to the corners of a cube.
    """
    k = np.arange(_DIRECTIONS) + 0.5
    height = 1.0 - 2.0 * k / _DIRECTIONS
    angle = np.pi * (1.0 + 5.0**0.5) * k
    radius = np.sqrt(1.0 - height**2)
    corners = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)])
    spiral = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    return np.vstack([spiral, corners / 3.0**0.5])
