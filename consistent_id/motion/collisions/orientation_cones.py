"""Cones that a direction of the robot may not leave, as bodies kept apart.

A unit vector ``d`` of a link is within the angle ``c`` of an axis ``e`` of the base
frame if ``d.e >= cos c``: the point ``d / sin c``, drawn from the base's origin
wherever the link is, stays off the half-space ``x.e <= cos c / sin c``.  Near the
cone's edge the distance of the two in metres is the angle that is left in rad.  So a
search keeps the cone, and a proof covers it, as those of collisions.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Vector, array_default, freeze, freeze_arrays
from consistent_id.errors import ProblemError
from consistent_id.motion.collisions.bodies import Body, Sphere, plane
from consistent_id.motion.collisions.scene import Scene, kept_off

_RADIUS = 1e-3  # m; of the ball at the point, by which the face is set back
_NARROWEST = np.radians(1.0)  # rad; from a cone of nothing, or of all directions


@dataclass(frozen=True, slots=True, eq=False)
class OrientationCone:
    """A cone about an axis of the base frame that a direction of a link may not leave.

    Parameters
    ----------
    link : str
        Moving, or fixed to a moving one, such as ``"tool0"``.
    angle : float, [rad]
        Between the axis and the direction at most; from 1 to 179 degrees.
    axis : array_like, shape (3,)
        In the base frame; made a unit vector.  Down by default.
    direction : array_like, shape (3,)
        In the link's frame; made a unit vector.
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


def within_cones(scene: Scene, cones: Iterable[OrientationCone]) -> Scene:
    """Return a scene in which directions of the robot stay within cones, too.

    Raises
    ------
    ModelError
        If the robot has no such link.
    ProblemError
        If a link does not move.

    Examples
    --------
    >>> from consistent_id import Body, DHRow, build_scene, from_modified_dh
    >>> from consistent_id.motion.collisions.separation import nearest
    >>> arm = from_modified_dh("arm", [DHRow(np.pi / 2, 0), DHRow(0, 0.5)])
    >>> upright = OrientationCone("link2", 0.5, axis=(0, 0, 1), direction=(1, 0, 0))
    >>> bare = build_scene(arm, [Body("tip", Sphere(0.1), "link2")])
    >>> scene = within_cones(bare, [upright])
    >>> nearest(scene, [[np.pi / 2, 0.49]]).distance.round(4).tolist()
    [[0.0099]]
    """
    for cone in cones:
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
