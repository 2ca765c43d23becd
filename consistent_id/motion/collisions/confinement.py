"""Boxes and cones for a point or a direction of the robot, as collision bodies.

Beyond each face of a box is a half-space that only this point must avoid.

A unit vector ``d`` of a link is within the angle ``c`` of an axis ``e`` of the base
frame if ``d.e >= cos c``: the point ``d / sin c``, drawn from the base's origin for any
position of the link, stays off the half-space ``x.e <= cos c / sin c``.  Near the
cone's edge the distance of the two in metres is the remaining angle in rad.

So search and proof treat boxes and cones like collisions.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Vector, array_default, freeze, freeze_arrays
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.motion.collisions.bodies import Body, Sphere, plane
from consistent_id.motion.collisions.scene import Scene, kept_off

# M; radius of the ball that represents a point; faces are set back by it
_RADIUS = 1e-3

# Rad; least difference from an empty cone, or from all directions
_NARROWEST = np.radians(1.0)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Workspace:
    """A box in the robot's base frame for a point of a link.

    Parameters
    ----------
    link : str
        Moving, or fixed to a moving one, such as ``"tool0"``.
    low, high : array_like, shape (3,), [m]
        Corners of the box; infinite for axes without a bound.
    point : array_like, shape (3,), [m]
        In the link's frame.
    """

    link: str
    low: Vector
    high: Vector
    point: Vector = array_default((0.0, 0.0, 0.0))

    def __post_init__(self) -> None:
        where = f"workspace of {self.link!r}"
        shapes = dict.fromkeys(("low", "high"), (3,))
        freeze_arrays(self, shapes, where, finite=False)
        freeze_arrays(self, {"point": (3,)}, where)
        if not (self.low < self.high).all():
            raise ProblemError(
                f"{where}: low {self.low.tolist()} is not below high "
                f"{self.high.tolist()}"
            )


@brief
@dataclass(frozen=True, slots=True, eq=False)
class OrientationCone:
    """A cone about an axis of the base frame for a direction of a link.

    Parameters
    ----------
    link : str
        Moving, or fixed to a moving one, such as ``"tool0"``.
    angle : float, [rad]
        Largest angle between axis and direction; from 1 to 179 degrees.
    axis : array_like, shape (3,)
        In the base frame; normalised.  Down by default.
    direction : array_like, shape (3,)
        In the link's frame; normalised.
    """

    link: str
    angle: float
    axis: Vector = array_default((0.0, 0.0, -1.0))
    direction: Vector = array_default((0.0, 0.0, 1.0))

    def __post_init__(self) -> None:
        where = f"cone of {self.link!r}"
        freeze_arrays(self, dict.fromkeys(("axis", "direction"), (3,)), where)
        for name in ("axis", "direction"):
            vector = getattr(self, name)
            if not vector.any():
                raise ProblemError(f"{where}: {name} is zero, expected a direction")
            freeze(self, **{name: vector / np.linalg.norm(vector)})
        if not _NARROWEST <= self.angle <= np.pi - _NARROWEST:
            raise ProblemError(
                f"{where}: angle is {np.degrees(self.angle):g} degrees, expected 1 to "
                "179"
            )


def within_workspaces(scene: Scene, workspaces: Iterable[Workspace]) -> Scene:
    """Return a scene in which points of the robot must stay within boxes.

    Parameters
    ----------
    scene : Scene
    workspaces : sequence of Workspace

    Raises
    ------
    ModelError
        If the robot has no such link.
    ProblemError
        If a link does not move.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> from consistent_id.motion import Body, build_scene
    >>> arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.5)])
    >>> tip = Body("tip", Sphere(0.1), "link2")
    >>> box = Workspace("link2", [-1.0, 0.1, -np.inf], [1.0, 1.0, np.inf])
    >>> scene = within_workspaces(build_scene(arm, [tip]), [box])
    >>> [scene.names(pair)[1] for pair in scene.pairs]
    ['low x of link2', 'high x of link2', 'low y of link2', 'high y of link2']
    """
    require_type(scene, Scene, "scene")
    for box in workspaces:
        require_type(box, Workspace, "workspaces")
        point = f"point of {box.link}"
        ball = Body(point, Sphere(_RADIUS), box.link, translation=box.point)
        scene = kept_off(scene, ball, _faces(box), f"workspace of {box.link!r}")
    return scene


def within_cones(scene: Scene, cones: Iterable[OrientationCone]) -> Scene:
    """Return a scene in which directions of the robot must stay within cones.

    Parameters
    ----------
    scene : Scene
    cones : sequence of OrientationCone

    Raises
    ------
    ModelError
        If the robot has no such link.
    ProblemError
        If a link does not move.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> from consistent_id.motion import Body, build_scene
    >>> from consistent_id.motion.collisions.separation import nearest
    >>> arm = from_modified_dh("arm", [DHRow(np.pi / 2, 0), DHRow(0, 0.5)])
    >>> upright = OrientationCone("link2", 0.5, axis=(0, 0, 1), direction=(1, 0, 0))
    >>> bare = build_scene(arm, [Body("tip", Sphere(0.1), "link2")])
    >>> scene = within_cones(bare, [upright])
    >>> nearest(scene, [[np.pi / 2, 0.49]]).distance.round(4).tolist()
    [[0.0099]]
    """
    require_type(scene, Scene, "scene")
    for cone in cones:
        require_type(cone, OrientationCone, "cones")
        length = 1.0 / np.sin(cone.angle)
        point = Body(
            f"direction of {cone.link}",
            Sphere(_RADIUS),
            cone.link,
            translation=length * cone.direction,
            turning=True,
        )
        height = length * np.cos(cone.angle) - _RADIUS
        label = f"outside of the cone of {cone.link} (1 mm is 1 mrad)"
        beyond = replace(plane(height, cone.axis, label), turning=True)
        scene = kept_off(scene, point, [beyond], f"cone of {cone.link!r}")
    return scene


def _faces(box: Workspace) -> list[Body]:
    """Return the half-spaces outside, set back by the ball's radius."""
    faces = []
    for name, inwards in zip("xyz", np.eye(3), strict=True):
        k = "xyz".index(name)
        for end, sign, place in (("low", 1.0, box.low[k]), ("high", -1.0, box.high[k])):
            if np.isfinite(place):
                height = sign * place - _RADIUS
                label = f"{end} {name} of {box.link}"
                faces.append(plane(height, sign * inwards, label))
    return faces
