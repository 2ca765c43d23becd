"""The fit of an inertial to other evidence on a link: its shapes, and other links.

A link's shapes fill a solid of assumed uniform density.  Costs are minus logarithms of
probabilities.  Their widths are those of what half of the published robots at hand
state (``python benchmarks/repair_causes.py --evidence`` prints them); tails are those
of Student's t with three degrees of freedom, because some of what is published is made
up.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.errors import ModelError, ProblemError
from consistent_id.motion.collisions.urdf_bodies import link_bodies
from consistent_id.robot.inertia import second_moments
from consistent_id.robot.loaders.xml import Element

SCALE = 0.43  # of ln(second moments over those of the solid), mean of three
FORM = 0.34  # of the same, entries of the differences from the mean
DENSITY = 0.67  # of ln(density over the usual one) of the hull
USUAL_DENSITY = 990.0  # [kg/m^3]; median of mass over volume of the hull
LOOSE_DENSITY = 1.0  # of the same, of the ellipsoid with the same second moments
RATIO = 1.2  # of ln(largest second moment over smallest), per axis, without shapes
PRODUCT = 0.06  # of a product of inertia over its diagonal entries
_FREEDOM = 3.0
_FLOOR = 1e-6  # of the largest second moment; thinner bodies are plates or rods
_VANISHING = 1e-30  # of the solid's; keeps logarithms finite
_DIGITS = 1e-6  # of the largest entry: twins state the same digits

_DIRECTIONS = 400  # in which a shape's farthest point is taken: hulls to about 1 %
_FLAT = 1e-4  # least thickness over size; thinner shapes have hardly any volume


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

    def outside(self, point: Vector) -> float:
        """Return the distance from the hull to a point, over the hull's length.

        It is zero for a point inside, and never more than the true distance.
        """
        around = directions()
        along = self.points @ around.T
        distance = (around @ point - along.max(axis=0)).max()
        return float(max(distance, 0.0) / np.ptp(along, axis=0).max())


@dataclass(frozen=True, slots=True, eq=False)
class LinkBody:
    """A link's mass, centre of mass and central inertia in the link's frame."""

    name: str
    mass: float
    com: Vector
    inertia: Matrix


def radius_of_gyration(body: LinkBody) -> float:
    """Return ``sqrt(tr(I) / 2 m)`` [m], the distance of mass from its centre."""
    return float(np.sqrt(max(np.trace(body.inertia), 0.0) / (2.0 * body.mass)))


def misfit(body: LinkBody, solid: LinkSolid | None) -> float:
    """Return the cost of a consistent body beside a solid, or by itself."""
    spread = second_moments(body.inertia) / body.mass
    values, axes = np.linalg.eigh(spread)
    values = np.maximum(values, max(_FLOOR * values[-1], _VANISHING))
    if solid is not None:
        return _beside(axes * values @ axes.T, body.mass, solid)
    volume = 4.0 / 3.0 * np.pi * 5.0**1.5 * float(np.sqrt(values.prod()))
    density = np.log(body.mass / volume / USUAL_DENSITY) / LOOSE_DENSITY
    ratios = np.log(values[1:] / values[:-1]) / RATIO
    diagonal = np.diag(body.inertia)
    products = body.inertia / np.sqrt(np.outer(diagonal, diagonal)) / PRODUCT
    above = products[np.triu_indices(3, 1)]
    terms = [density, *ratios, *above]
    return sum(_student(float(term**2), 1) for term in terms)


def _beside(spread: Matrix, mass: float, solid: LinkSolid) -> float:
    values, axes = np.linalg.eigh(solid.spread)
    whiten = axes / np.sqrt(values)
    found, turned = np.linalg.eigh(whiten.T @ spread @ whiten)
    found = np.maximum(found, _FLOOR * abs(found[-1]))
    logarithm = turned * np.log(np.maximum(found, _VANISHING)) @ turned.T
    mean = float(np.trace(logarithm)) / 3.0
    form = float(np.linalg.norm(logarithm - mean * np.eye(3)))
    density = float(np.log(mass / solid.volume / USUAL_DENSITY))
    return (
        _student((mean / SCALE) ** 2, 1)
        + _student((form / FORM) ** 2, 5)
        + _student((density / DENSITY) ** 2, 1)
    )


def _student(squares: float, dimensions: int) -> float:
    """Return the cost of a sum of squares under Student's distribution."""
    return (_FREEDOM + dimensions) / 2.0 * float(np.log1p(squares / _FREEDOM))


def twin_inertias(
    body: LinkBody, others: Sequence[LinkBody]
) -> list[tuple[str, Matrix]]:
    """Return the inertias that a link would have as the mirror image of others.

    A twin has the same mass, and the same centre of mass up to signs.  Where that is on
    a plane of the frame, there are several.  Centres at the origin give no information.
    """
    found: list[tuple[str, Matrix]] = []
    size = float(abs(body.com).max())
    if size == 0.0:
        return found
    for other in others:
        if other is body or abs(other.mass - body.mass) > _DIGITS * body.mass:
            continue
        for signs in product((1.0, -1.0), repeat=3):
            if abs(signs * other.com - body.com).max() <= _DIGITS * size:
                found.append((other.name, other.inertia * np.outer(signs, signs)))
    return found


def alike(first: Matrix, second: Matrix) -> bool:
    """Return whether two inertias have the same digits."""
    size = float(max(abs(first).max(), abs(second).max()))
    return bool(abs(first - second).max() <= _DIGITS * size)


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
