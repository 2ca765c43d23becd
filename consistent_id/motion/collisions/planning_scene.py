"""A MoveIt planning scene as bodies: what stands around a robot, and what it holds."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from consistent_id._support.inputs import LARGEST_MODEL, read_input
from consistent_id.errors import ModelError, ProblemError
from consistent_id.motion.collisions.bodies import Body
from consistent_id.motion.collisions.moveit_message import objects_of_message
from consistent_id.motion.collisions.moveit_objects import Pose, SceneObject, beyond
from consistent_id.motion.collisions.moveit_text import objects_of_text
from consistent_id.motion.files.ros import plain_yaml
from consistent_id.robot.model import RobotModel
from consistent_id.robot.places import Place, fixed_place

_PLANNING = ("", "world", "map", "odom")
"""Frames that are taken for that of the robot's base."""


def planning_scene_bodies(path: str | Path, robot: RobotModel) -> tuple[Body, ...]:
    """Return the objects of a MoveIt planning scene as bodies.

    Parameters
    ----------
    path : str or Path
        ``.scene``, as MoveIt's window saves it, or a ``moveit_msgs/PlanningScene`` as
        ``.yaml`` (with the extra ``ros``) or ``.json``.  Boxes, spheres, cylinders,
        cones and meshes, of which the hull is taken, by their vertices or by
        `resource`, a file.
    robot : RobotModel
        In whose base frame objects stand; those of a link's frame move with it.

    Raises
    ------
    ProblemError
        If it cannot be read, or an object is in a frame that is not known.
    """
    path = Path(path)
    content = read_input(path, ProblemError, LARGEST_MODEL)
    if path.suffix.lower() == ".scene":
        found = objects_of_text(content.decode("utf-8", "replace"), path)
    else:
        found = objects_of_message(_message(content, path), path)
    return tuple(body for one in found for body in _bodies(one, robot, path))


def _message(content: bytes, path: Path) -> Any:
    if path.suffix.lower() != ".json":
        return plain_yaml(content, path)
    try:
        return msgspec.json.decode(content)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as cause:
        raise ProblemError(f"{path}: not JSON: {cause}") from None


def _bodies(one: SceneObject, robot: RobotModel, path: Path) -> list[Body]:
    """Return an object's shapes; what stands still is placed in the base frame."""
    link, stands = None, Pose(np.eye(3), np.zeros(3))
    name = one.frame.removeprefix("/")
    if name not in _PLANNING:
        place = _place(name, one, robot, path)
        if place.link >= 0:
            link = name
        else:
            stands = Pose(place.rotation, place.translation)
    many = len(one.shapes) > 1
    return [
        Body(f"{one.name}:{k}" if many else one.name, shape, link, turned, where)
        for k, placed in enumerate(one.shapes, 1)
        for shape, turned, where in [beyond(stands, placed)]
    ]


def _place(name: str, one: SceneObject, robot: RobotModel, path: Path) -> Place:
    try:
        return fixed_place(robot, name)
    except ModelError as cause:
        raise ProblemError(f"{path}: object {one.name!r}: {cause}") from None
