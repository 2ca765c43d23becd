"""The feet of a robot: the frames in which its legs end, and their shape."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.motion.collisions.bodies import Sphere
from consistent_id.motion.collisions.urdf_bodies import link_bodies
from consistent_id.robot.kinematics import ancestors
from consistent_id.robot.loaders.mjcf_assets import read_spec
from consistent_id.robot.loaders.robot_file import is_mjcf
from consistent_id.robot.loaders.urdf_lint import read_bytes
from consistent_id.robot.loaders.xml import parse
from consistent_id.robot.model import Link, RobotModel
from consistent_id.robot.places import fixed_place

_WORDS = ("foot", "sole", "toe", "ankle", "calf", "shank", "feet")  # the best first
_SOLE = 5  # joints of a leg from which on its foot can be laid flat on the ground


@dataclass(frozen=True, slots=True, eq=False)
class Foot:
    """A foot.

    Parameters
    ----------
    frame : str
        A moving link, or one that is fixed to it.
    names : tuple of str
        All links of the body.
    surface : bool
        Whether it is a sole, which transmits moments; else it is a ball or a point.
    point : ndarray, shape (3,), [m]
        Of the contact in the frame; of a ball its centre.
    radius : float, [m]
        Of a ball.
    shaped : bool
        Whether the model's file has a ball there; else the point is the frame's origin.
    """

    frame: str
    names: tuple[str, ...]
    surface: bool
    point: Vector
    radius: float = 0.0
    shaped: bool = False


def feet_of(robot: RobotModel, path: Path) -> tuple[Foot, ...]:
    """Return the robot's feet: the last bodies of its limbs that are named as such.

    Parameters
    ----------
    robot : RobotModel
        Whose base floats.
    path : Path
        Of its URDF or MJCF file, which has the shapes.
    """
    parents = {joint.parent for joint in robot.joints}
    last = [k for k in range(len(robot.links)) if k not in parents and k > 0]
    ends = {k: frame for k in last if (frame := _frame(robot.links[k])) is not None}
    return tuple(_foot(robot, path, k, frame) for k, frame in ends.items())


def _frame(link: Link) -> str | None:
    """Return the frame of a body that is named as a foot, if one is."""
    names = [*(merged.name for merged in link.merged), link.name]
    for word in _WORDS:
        for name in names:
            if word in name.lower():
                return name
    return None


def _foot(robot: RobotModel, path: Path, k: int, frame: str) -> Foot:
    link = robot.links[k]
    names = (link.name, *(merged.name for merged in link.merged))
    joints = sum(robot.joints[j].driven for j in ancestors(robot, k))
    if joints >= _SOLE:
        return Foot(frame, names, True, np.zeros(3))
    balls = list(_balls(path, robot, names))
    if len(balls) != 1:
        return Foot(frame, names, False, np.zeros(3))
    at, radius = balls[0]
    place = fixed_place(robot, frame)
    point = place.rotation.T @ (at - place.translation)
    return Foot(frame, names, False, point, radius, shaped=True)


def _balls(
    path: Path, robot: RobotModel, names: tuple[str, ...]
) -> Iterator[tuple[Vector, float]]:
    """Yield centres, in the link's frame, and radii of a body's collision spheres."""
    found = _mjcf_balls if is_mjcf(path) else _urdf_balls
    for name, at, radius in found(path, names):
        place = fixed_place(robot, name)
        yield place.translation + place.rotation @ at, radius


def _urdf_balls(
    path: Path, names: tuple[str, ...]
) -> Iterator[tuple[str, Vector, float]]:
    for link in parse(read_bytes(path)).all("link"):
        shapes = list(link.all("collision"))
        meshes = [s for s in shapes if any(e.tag == "mesh" for e in s.below())]
        if link.name in names and shapes and not meshes:
            for body in link_bodies(path, link):
                if isinstance(body.shape, Sphere):
                    yield link.name, np.array(body.translation), body.shape.radius


def _mjcf_balls(
    path: Path, names: tuple[str, ...]
) -> Iterator[tuple[str, Vector, float]]:
    import mujoco

    model = read_spec(path, mujoco).compile()
    for geom in range(model.ngeom):
        body = model.body(int(model.geom_bodyid[geom])).name
        ball = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE
        touches = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if body in names and ball and touches:
            yield body, model.geom_pos[geom].copy(), float(model.geom_size[geom, 0])
