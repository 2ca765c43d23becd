"""Objects of a planning scene, as shapes in the frame of a link or of the robot."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.errors import ProblemError
from consistent_id.motion.collisions.bodies import Box, Cylinder, Hull, Shape, Sphere

_CORNERS = 24  # of the polygon around a cone's circle
_SMALLEST = 1e-6  # of a quaternion that has a direction


class Pose(NamedTuple):
    """Orientation, shape (3, 3), and position, shape (3,), [m]."""

    rotation: Matrix
    translation: Vector


class PlacedShape(NamedTuple):
    """A shape, and its pose."""

    shape: Shape
    rotation: Matrix
    translation: Vector


@dataclass(frozen=True, slots=True, eq=False)
class SceneObject:
    """One object of a planning scene.

    Parameters
    ----------
    frame : str
        Of the poses: a link, or the frame that the scene is planned in.
    """

    name: str
    frame: str
    shapes: tuple[PlacedShape, ...]


def shape_of(kind: str, sizes: Array) -> Shape:
    """Return a shape by MoveIt's name and its sizes [m].

    Parameters
    ----------
    kind : str
        ``box`` (x, y, z), ``sphere`` (radius), ``cylinder`` and ``cone`` (radius,
        length), or ``mesh`` (its vertices, whose hull is taken).
    """
    values = np.asarray(sizes, dtype=np.float64)
    if kind == "mesh":
        return Hull(values)
    numbers = values.tolist()
    if kind == "box":
        return Box((numbers[0], numbers[1], numbers[2]))
    if kind == "sphere":
        return Sphere(numbers[0])
    if kind == "cylinder":
        return Cylinder(numbers[0], numbers[1])
    return _cone(numbers[0], numbers[1])


def _cone(radius: float, length: float) -> Hull:
    """Return a hull around a cone along z, its tip upwards, the middle at zero."""
    if not (radius > 0.0 and length > 0.0):
        raise ProblemError(
            f"cone: radius {radius:g} m, length {length:g} m, expected more than 0"
        )
    angles = 2.0 * np.pi * np.arange(_CORNERS) / _CORNERS
    around = radius / np.cos(np.pi / _CORNERS)
    rim = np.column_stack(
        [
            around * np.cos(angles),
            around * np.sin(angles),
            np.full(_CORNERS, -length / 2.0),
        ]
    )
    return Hull(np.vstack([rim, [0.0, 0.0, length / 2.0]]))


def pose_of(position: Array, quaternion: Array) -> Pose:
    """Return a pose from a position [m] and a quaternion x, y, z, w.

    Raises
    ------
    ProblemError
        If the quaternion is zero.
    """
    q = np.asarray(quaternion, dtype=np.float64)
    size = float(np.linalg.norm(q))
    if not size > _SMALLEST:
        raise ProblemError("an orientation is the quaternion 0, expected one of size 1")
    x, y, z, w = q / size
    v = np.array([x, y, z])
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation = (w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * cross
    return Pose(rotation, np.asarray(position, dtype=np.float64))


def beyond(frame: Pose, placed: PlacedShape) -> PlacedShape:
    """Return a shape whose pose was given in a frame."""
    return PlacedShape(
        placed.shape,
        frame.rotation @ placed.rotation,
        frame.translation + frame.rotation @ placed.translation,
    )
