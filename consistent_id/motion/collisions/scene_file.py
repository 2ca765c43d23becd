"""A scene from a robot's file."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from consistent_id.errors import ModelError
from consistent_id.motion.collisions.bodies import Body, plane
from consistent_id.motion.collisions.scene import Scene, place_of
from consistent_id.motion.collisions.scene_building import build_scene
from consistent_id.motion.collisions.urdf_bodies import Elements, urdf_bodies
from consistent_id.robot.model import RobotModel


def scene_from_urdf(
    path: str | Path,
    robot: RobotModel,
    *,
    package_dirs: Iterable[str | Path] = (),
    elements: Elements = "collision",
    pieces: int = 4,
    ground: float | None = None,
    added: Iterable[Body] = (),
    clearance: float = 0.0,
    extra: Mapping[str, float] | None = None,
    allowed: Sequence[tuple[str, str]] = (),
) -> Scene:
    """Return a robot's bodies, as its URDF shapes them, and what stands around it.

    A body has the name of its link; if a link has several shapes, they are
    ``link:1``, ``link:2``, ...  Meshes become convex hulls, which are never smaller.

    Parameters
    ----------
    path : str or Path
    robot : RobotModel
        Of the same file, or a part of it; joints that it locks stay where they are.
    package_dirs : iterable of str or Path
        Folders in which ``package://name/...`` is looked for as ``name/...``; so are
        the folders above the file.
    elements : {"collision", "visual"}
        Which shapes to take; of a link that has none of these, the others.
    pieces : int
        Into how many convex pieces a mesh may be cut where its hull is too large; 1
        for hulls as they are.
    ground : float, optional, [m]
        Height of a level floor above the robot's base frame.
    added : iterable of Body
        Boxes and other obstacles; a tool that the file does not have.
    clearance, extra, allowed
        See `build_scene`.

    Raises
    ------
    ModelError
        If the file or a mesh cannot be read, or no shape is of a link of the robot.
    ProblemError
        If a name is unknown, or an obstacle touches the robot at every random pose.
    """
    path = Path(path)
    found = urdf_bodies(path, package_dirs, elements, pieces)
    bodies = [body for body in found if _has(robot, body)]
    if not bodies:
        raise ModelError(
            f"{path}: {len(found)} shapes, none of a link of robot {robot.name!r}; "
            "load the robot from the same file, or build the scene by hand"
        )
    known = {body.name for body in bodies}
    dropped = tuple(body.name for body in found if body.name not in known)
    floor = [] if ground is None else [plane(ground)]
    scene = build_scene(
        robot,
        [*floor, *added, *bodies],
        clearance=clearance,
        extra=extra,
        allowed=allowed,
    )
    return replace(scene, dropped=dropped)


def _has(robot: RobotModel, body: Body) -> bool:
    try:
        place_of(robot, body)
    except ModelError:
        return False
    return True
