"""Convex shapes on links and in the world, which must not touch.

A shape has a function for its farthest point in a direction.  A separating plane needs
nothing else: two shapes are at least ``min n.b - max n.a`` apart, for any unit vector
``n``.
"""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Protocol
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Matrix, Vector, chunks, freeze, frozen
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError

_ORTHONORMAL = 1e-9  # entries of R^T R - 1
_CHUNK = 4096  # directions at a time, so that their products stay in cache
_MOST_NEIGHBOURS = 254  # of a corner, which coal counts in one byte
_DIRECTIONS = 1024  # 128, with at most as many corners, are always few enough


class Shape(Protocol):
    """A convex set in its own frame, [m]."""

    def farthest(self, directions: Array) -> Array:
        """Return the farthest point in each direction, both (directions, 3)."""

    @property
    def ball(self) -> tuple[Vector, float]:
        """Centre and radius of a ball around it."""

    def __hash__(self) -> int:
        """Shapes are values."""


@brief
@dataclass(frozen=True, slots=True)
class Sphere:
    """A ball about the origin of its frame; `radius` in m."""

    radius: float

    def __post_init__(self) -> None:
        _positive("sphere", radius=self.radius)

    def farthest(self, directions: Array) -> Array:
        """Return the farthest point in each direction."""
        length = np.linalg.norm(directions, axis=1, keepdims=True)
        unit = directions / np.where(length > 0.0, length, 1.0)
        return np.asarray(self.radius * unit)

    @property
    def ball(self) -> tuple[Vector, float]:
        """Itself."""
        return np.zeros(3), self.radius


@brief
@dataclass(frozen=True, slots=True)
class Box:
    """A box about the origin of its frame; `size` along x, y and z in m."""

    size: tuple[float, float, float]

    def __post_init__(self) -> None:
        size = tuple(frozen(self.size, (3,), "box size").tolist())
        freeze(self, size=size)
        for name, value in zip("xyz", size, strict=True):
            _positive("box", **{name: value})

    def farthest(self, directions: Array) -> Array:
        """Return the farthest point in each direction, one of the corners."""
        return np.asarray(np.where(directions < 0.0, -0.5, 0.5) * np.array(self.size))

    @property
    def ball(self) -> tuple[Vector, float]:
        """Ball through the corners."""
        return np.zeros(3), float(np.linalg.norm(self.size)) / 2.0


@brief
@dataclass(frozen=True, slots=True)
class Capsule:
    """Points within `radius` of a centred segment of `length` along z; both in m."""

    radius: float
    length: float

    def __post_init__(self) -> None:
        _positive("capsule", radius=self.radius, length=self.length)

    def farthest(self, directions: Array) -> Array:
        """Return the farthest point in each direction."""
        points = Sphere(self.radius).farthest(directions)
        points[:, 2] += np.where(directions[:, 2] < 0.0, -0.5, 0.5) * self.length
        return points

    @property
    def ball(self) -> tuple[Vector, float]:
        """Ball around it."""
        return np.zeros(3), self.radius + self.length / 2.0


@brief
@dataclass(frozen=True, slots=True)
class Cylinder:
    """A cylinder about the z axis, centred, with flat ends; both in m."""

    radius: float
    length: float

    def __post_init__(self) -> None:
        _positive("cylinder", radius=self.radius, length=self.length)

    def farthest(self, directions: Array) -> Array:
        """Return the farthest point in each direction."""
        points = Sphere(self.radius).farthest(directions * np.array([1.0, 1.0, 0.0]))
        points[:, 2] = np.where(directions[:, 2] < 0.0, -0.5, 0.5) * self.length
        return points

    @property
    def ball(self) -> tuple[Vector, float]:
        """Ball through the rims."""
        return np.zeros(3), float(np.hypot(self.radius, self.length / 2.0))


@brief
@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Hull:
    """The convex hull of points, such as a mesh's vertices.

    Parameters
    ----------
    points : array_like, shape (points, 3), [m]
        Only the corners of the hull are kept.
    """

    points: Matrix
    facets: Any = field(init=False, repr=False)  # corners' places, outwards

    def __post_init__(self) -> None:
        from scipy.spatial import ConvexHull, QhullError

        points = frozen(self.points, (None, 3), "hull points")
        try:
            hull = ConvexHull(points)
        except (QhullError, ValueError):
            raise ProblemError(
                f"hull of {len(points)} points: they lie in a plane, expected four or "
                "more that do not; use a thin box instead"
            ) from None
        place = np.zeros(len(points), dtype=np.intp)
        place[hull.vertices] = np.arange(len(hull.vertices))
        corners = frozen(points[hull.vertices], (None, 3), "corners")
        facets = place[hull.simplices]
        a, b, c = corners[facets].transpose(1, 0, 2)
        inwards = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0.0
        facets[inwards] = facets[inwards][:, ::-1]
        facets.setflags(write=False)
        freeze(self, points=corners, facets=facets)

    def farthest(self, directions: Array) -> Array:
        """Return the farthest point in each direction, one of the corners."""
        farthest = np.empty((len(directions), 3))
        for part in chunks(len(directions), _CHUNK):
            heights = directions[part] @ self.points.T
            farthest[part] = self.points[heights.argmax(axis=1)]
        return farthest

    @property
    def ball(self) -> tuple[Vector, float]:
        """Ball about the middle of the bounding box."""
        centre = (self.points.min(axis=0) + self.points.max(axis=0)) / 2.0
        return centre, float(np.linalg.norm(self.points - centre, axis=1).max())


@brief
@dataclass(frozen=True, slots=True)
class HalfSpace:
    """All points with z at most 0 in its frame: the ground, a wall, a ceiling."""

    def farthest(self, directions: Array) -> Array:
        """Return the origin, which is farthest along z, the only bounded direction."""
        return np.zeros((len(directions), 3))

    @property
    def ball(self) -> tuple[Vector, float]:
        """No finite ball."""
        return np.zeros(3), np.inf


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A shape and the frame to which it is fixed.

    Parameters
    ----------
    name : str
    shape : Sphere, Box, Capsule, Cylinder, Hull or HalfSpace
    frame : str, optional
        A link of the robot, moving or fixed to another; without one, the body is an
        obstacle in the robot's base frame.
    rotation : array_like, shape (3, 3), optional
        Orientation of the shape in the frame.
    translation : array_like, shape (3,), optional, [m]
        Origin of the shape in the frame.
    turning : bool
        Whether it only turns with the frame, about the base's origin: a direction, not
        a position.
    """

    name: str
    shape: Shape
    frame: str | None = None
    rotation: Matrix | None = None
    translation: Vector | None = None
    turning: bool = False

    def __post_init__(self) -> None:
        where = f"body {self.name!r}"
        rotation = np.eye(3) if self.rotation is None else self.rotation
        rotation = frozen(rotation, (3, 3), f"{where}: rotation")
        far_off = abs(rotation.T @ rotation - np.eye(3)).max() > _ORTHONORMAL
        if far_off or np.linalg.det(rotation) < 0.0:
            raise ProblemError(
                f"{where}: expected a rotation matrix, got {rotation.tolist()}"
            )
        translation = np.zeros(3) if self.translation is None else self.translation
        translation = frozen(translation, (3,), f"{where}: translation")
        freeze(self, rotation=rotation, translation=translation)
        if self.frame is not None and isinstance(self.shape, HalfSpace):
            raise ProblemError(f"{where}: a half-space cannot move with {self.frame!r}")


def plane(
    height: float = 0.0, normal: ArrayLike = (0.0, 0.0, 1.0), name: str = "ground"
) -> Body:
    """Return the obstacle ``{x : normal.x <= height}`` in the robot's base frame.

    Parameters
    ----------
    height : float, [m]
        Height of its surface above the base's origin, along the normal.
    normal : array_like, shape (3,)
        Direction towards free space; normalised to a unit vector.
    name : str
    """
    up = frozen(normal, (3,), f"{name}: normal")
    length = float(np.linalg.norm(up))
    if length == 0.0:
        raise ProblemError(f"{name}: normal is zero, expected a direction")
    up = up / length
    first = np.cross(up, np.eye(3)[abs(up).argmin()])
    first /= np.linalg.norm(first)
    rotation = np.column_stack([first, np.cross(up, first), up])
    return Body(name, HalfSpace(), None, rotation, height * up)


def coal_geometry(shape: Shape) -> Any:
    """Return a shape in coal's form."""
    if not isinstance(shape, Hull):
        return _coal_primitive(shape)
    if shape not in _COAL_HULLS:
        _COAL_HULLS[shape] = _coal_hull(_thinned(shape))
    return _COAL_HULLS[shape]


# Hulls take long to convert, and much memory: they are kept as long as the shapes are.
_COAL_HULLS: WeakKeyDictionary[Hull, Any] = WeakKeyDictionary()


def _coal_hull(hull: Hull) -> Any:
    import coal

    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(list(hull.points))
    triangles.extend([coal.Triangle(*t) for t in hull.facets.tolist()])
    return coal.Convex(points, triangles)


@lru_cache(maxsize=512)
def _coal_primitive(shape: Shape) -> Any:
    import coal

    match shape:
        case Sphere(radius):
            return coal.Sphere(radius)
        case Box(size):
            return coal.Box(*size)
        case Capsule(radius, length):
            return coal.Capsule(radius, length)
        case Cylinder(radius, length):
            return coal.Cylinder(radius, length)
    raise ProblemError(
        f"shape {shape!r}: expected Sphere, Box, Capsule, Cylinder, Hull or HalfSpace"
    )


def _thinned(hull: Hull) -> Hull:
    """Keep corners farthest in fewer directions until coal can store all neighbours.

    Coal only finds directions: distances along them are those of all corners.
    """
    kept, directions = hull, _DIRECTIONS
    while _neighbours(kept) > _MOST_NEIGHBOURS:
        kept = Hull(np.unique(hull.farthest(_spread(directions)), axis=0))
        directions //= 2
    return kept


def _neighbours(hull: Hull) -> int:
    """Return the most neighbours of a corner."""
    a, b, c = hull.facets.T
    edges = np.sort(np.column_stack([[*a, *b, *c], [*b, *c, *a]]), axis=1)
    return int(np.bincount(np.unique(edges, axis=0).ravel()).max())


def _spread(count: int) -> Array:
    """Return directions evenly spread over the sphere, on a spiral."""
    number = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * number / count, np.pi * (1.0 + np.sqrt(5.0)) * number
    ring = np.sqrt(1.0 - z**2)
    return np.column_stack([ring * np.cos(turn), ring * np.sin(turn), z])


def _positive(what: str, **sizes: float) -> None:
    for name, size in sizes.items():
        if not 0.0 < size < np.inf:
            raise ProblemError(f"{what}: {name} is {size} m, expected more than 0")
