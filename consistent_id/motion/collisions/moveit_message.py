"""``moveit_msgs/PlanningScene`` messages, as YAML or JSON: their collision objects.

``ros2 topic echo --once /monitored_planning_scene`` writes one; keys that are no
objects are passed over.
"""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from consistent_id.errors import ProblemError
from consistent_id.motion.collisions.moveit_objects import (
    PlacedShape,
    Pose,
    SceneObject,
    beyond,
    pose_of,
    shape_of,
)
from consistent_id.robot.solids import mesh_vertices

_REMOVED = 1  # the operation that takes an object away
_IDENTITY = (0.0, 0.0, 0.0, 1.0)


class _Point(msgspec.Struct, frozen=True):
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class _Quaternion(msgspec.Struct, frozen=True):
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 0.0


class _PoseRecord(msgspec.Struct, frozen=True):
    position: _Point = _Point()
    orientation: _Quaternion = _Quaternion()

    def value(self) -> Pose:
        """Return it; all zeros, as messages are made, stand for no rotation."""
        p, q = self.position, self.orientation
        turned = (q.x, q.y, q.z, q.w)
        turned = turned if any(turned) else _IDENTITY
        return pose_of(np.array([p.x, p.y, p.z]), np.array(turned))


class _Primitive(msgspec.Struct, frozen=True):
    type: int
    dimensions: list[float]


class _Mesh(msgspec.Struct, frozen=True):
    vertices: list[_Point] = []
    resource: str | None = None
    scale: float = 1.0


class _Header(msgspec.Struct, frozen=True):
    frame_id: str = ""


class _Object(msgspec.Struct, frozen=True):
    id: str = ""
    header: _Header = _Header()
    pose: _PoseRecord = _PoseRecord()
    primitives: list[_Primitive] = []
    primitive_poses: list[_PoseRecord] = []
    meshes: list[_Mesh] = []
    mesh_poses: list[_PoseRecord] = []
    planes: list[Any] = []
    operation: int | str = 0


class _Attached(msgspec.Struct, frozen=True):
    link_name: str = ""
    object: _Object = _Object()


class _World(msgspec.Struct, frozen=True):
    collision_objects: list[_Object] = []


class _State(msgspec.Struct, frozen=True):
    attached_collision_objects: list[_Attached] = []


class _Scene(msgspec.Struct, frozen=True):
    world: _World = _World()
    robot_state: _State = _State()
    collision_objects: list[_Object] = []


# shape_msgs/SolidPrimitive: its types, and the order of their dimensions for shape_of.
_PRIMITIVES = {
    1: ("box", (0, 1, 2)),
    2: ("sphere", (0,)),
    3: ("cylinder", (1, 0)),
    4: ("cone", (1, 0)),
}


def objects_of_message(message: Any, where: Path) -> list[SceneObject]:
    """Return the objects of a message, those attached to links among them.

    Raises
    ------
    ProblemError
        With the key of the first fault.
    """
    try:
        scene = msgspec.convert(message, type=_Scene, strict=False)
    except msgspec.ValidationError as cause:
        raise ProblemError(f"{where}: {cause} ($ is the file)") from None
    every = [*scene.world.collision_objects, *scene.collision_objects]
    found = [_object(one, one.header.frame_id, where) for one in every if _there(one)]
    for held in scene.robot_state.attached_collision_objects:
        frame = held.object.header.frame_id or held.link_name
        found.append(_object(held.object, frame, where))
    return found


def _there(one: _Object) -> bool:
    return one.operation != _REMOVED


def _object(one: _Object, frame: str, where: Path) -> SceneObject:
    name = f"{where}: object {one.id!r}"
    if one.planes:
        raise ProblemError(f"{name}: planes are not read; give a box, or `ground`")
    poses = [*one.primitive_poses, *one.mesh_poses]
    parts = len(one.primitives) + len(one.meshes)
    if not parts or (poses and len(poses) != parts):
        raise ProblemError(
            f"{name}: {parts} shapes with {len(poses)} poses, expected as many, or none"
        )
    shapes = []
    every: list[_Primitive | _Mesh] = [*one.primitives, *one.meshes]
    for k, part in enumerate(every):
        try:
            shape = _shape(part, where)
            own = (poses[k] if poses else _PoseRecord()).value()
            shapes.append(beyond(one.pose.value(), PlacedShape(shape, *own)))
        except ProblemError as cause:
            raise ProblemError(f"{name}: {cause}") from None
    return SceneObject(one.id, frame, tuple(shapes))


def _shape(part: _Primitive | _Mesh, where: Path) -> Any:
    if isinstance(part, _Mesh):
        if part.resource is not None:
            file = where.parent / part.resource.removeprefix("file://")
            return shape_of("mesh", mesh_vertices(file, scale=part.scale))
        points = [[point.x, point.y, point.z] for point in part.vertices]
        return shape_of("mesh", np.array(points).reshape(-1, 3))
    if part.type not in _PRIMITIVES:
        raise ProblemError(f"primitive of type {part.type}, expected 1 to 4")
    kind, order = _PRIMITIVES[part.type]
    if len(part.dimensions) < len(order):
        raise ProblemError(
            f"a {kind} with dimensions {part.dimensions}, expected {len(order)}"
        )
    return shape_of(kind, np.array([part.dimensions[k] for k in order]))
