"""Boxes that a point of the robot may not leave, as bodies that it keeps off.

Beyond each face of the box is a half-space, and only the point is kept off it.  So a
search keeps the box, and a proof covers it, as those of collisions.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector, array_default, freeze_arrays
from consistent_id.errors import ProblemError
from consistent_id.motion.collisions.bodies import Body, Sphere, plane
from consistent_id.motion.collisions.scene import Scene, kept_off

_RADIUS = 1e-3  # m; of the ball that stands for the point, by which faces are set back


@dataclass(frozen=True, slots=True, eq=False)
class Workspace:
    """A box in the robot's base frame that a point of a link may not leave.

    Parameters
    ----------
    link : str
        Moving, or fixed to a moving one, such as ``"tool0"``.
    low, high : array_like, shape (3,), [m]
        Corners of the box; infinite where there is no face.
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


def within_workspaces(scene: Scene, workspaces: Iterable[Workspace]) -> Scene:
    """Return a scene in which points of the robot stay within boxes, too.

    Raises
    ------
    ModelError
        If the robot has no such link.
    ProblemError
        If a link does not move.

    Examples
    --------
    >>> from consistent_id import Body, DHRow, build_scene, from_modified_dh
    >>> arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.5)])
    >>> tip = Body("tip", Sphere(0.1), "link2")
    >>> box = Workspace("link2", [-1.0, 0.1, -np.inf], [1.0, 1.0, np.inf])
    >>> scene = within_workspaces(build_scene(arm, [tip]), [box])
    >>> [scene.names(pair)[1] for pair in scene.pairs]
    ['low x of link2', 'high x of link2', 'low y of link2', 'high y of link2']
    """
    for box in workspaces:
        point = f"point of {box.link}"
        ball = Body(point, Sphere(_RADIUS), box.link, translation=box.point)
        scene = kept_off(scene, ball, _faces(box), f"workspace of {box.link!r}")
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
