"""A MoveIt planning scene as bodies: obstacles, and objects attached to the robot.

``ros2 topic echo --once /monitored_planning_scene`` writes a message of type
``moveit_msgs/PlanningScene``; keys other than objects are ignored.  The motion
planner's window saves ``.scene`` files:

(name)
* id
x y z                  pose of the object; not in older files
qx qy qz qw
number of shapes, of each: kind, sizes, x y z, qx qy qz qw, four of colour
number of subframes, of each: name, pose; not in older files
.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.files import LARGEST_MODEL, read_input
from consistent_id._support.given_values import require_type
from consistent_id.errors import ModelError, ProblemError
from consistent_id.motion.collisions.bodies import (
    Body,
    Box,
    Cylinder,
    Hull,
    Shape,
    Sphere,
)
from consistent_id.motion.files.robot_formats import plain_yaml
from consistent_id.robot.kinematics import FixedPlace, fixed_place
from consistent_id.robot.model import RobotModel
from consistent_id.robot.solids import mesh_vertices

_PLANNING = ("", "world", "map", "odom")
"""Frames that count as that of the robot's base."""

_CORNERS = 24  # sides of the polygon around a cone's circle
_SMALLEST = 1e-6  # least norm of a quaternion with a direction

_REMOVED = 1  # the operation that removes an object
_IDENTITY = (0.0, 0.0, 0.0, 1.0)

# shape_msgs/SolidPrimitive: its types, and the order of their dimensions for shape_of.
_PRIMITIVES = {
    1: ("box", (0, 1, 2)),
    2: ("sphere", (0,)),
    3: ("cylinder", (1, 0)),
    4: ("cone", (1, 0)),
}
_TEXT_SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "cone": 2}
_MOST_NUMBERS = 1_000_000  # most numbers of one mesh; more indicate a faulty file

_T = TypeVar("_T")


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
        Frame of the poses: a link, or the frame of the planning scene.
    """

    name: str
    frame: str
    shapes: tuple[PlacedShape, ...]


def planning_scene_bodies(path: str | Path, robot: RobotModel) -> tuple[Body, ...]:
    """Return the objects of a MoveIt planning scene as bodies.

    Parameters
    ----------
    path : str or Path
        ``.scene``, as MoveIt's window saves it, or a ``moveit_msgs/PlanningScene`` as
        ``.yaml`` (with the extra ``ros``) or ``.json``.  Boxes, spheres, cylinders,
        cones and meshes; of a mesh, given by vertices or by the file `resource`, the
        hull is used.
    robot : RobotModel
        The robot in whose base frame objects stand; those in a link's frame move with
        it.

    Raises
    ------
    ProblemError
        If it cannot be read, or an object is in an unknown frame.
    """
    require_type(robot, RobotModel, "robot")
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
    """Return an object's shapes; fixed ones are placed in the base frame."""
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


def _place(name: str, one: SceneObject, robot: RobotModel, path: Path) -> FixedPlace:
    try:
        return fixed_place(robot, name)
    except ModelError as cause:
        raise ProblemError(f"{path}: object {one.name!r}: {cause}") from None


def shape_of(kind: str, sizes: Array) -> Shape:
    """Return a shape by MoveIt's name and its sizes [m].

    Parameters
    ----------
    kind : str
        ``box`` (x, y, z), ``sphere`` (radius), ``cylinder`` and ``cone`` (radius,
        length), or ``mesh`` (its vertices, of which the hull is used).
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


class _PointRecord(msgspec.Struct, frozen=True):
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class _QuaternionRecord(msgspec.Struct, frozen=True):
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 0.0


class _PoseRecord(msgspec.Struct, frozen=True):
    position: _PointRecord = _PointRecord()
    orientation: _QuaternionRecord = _QuaternionRecord()

    def value(self) -> Pose:
        """Return it; all zeros, the default of messages, mean no rotation."""
        p, q = self.position, self.orientation
        turned = (q.x, q.y, q.z, q.w)
        turned = turned if any(turned) else _IDENTITY
        return pose_of(np.array([p.x, p.y, p.z]), np.array(turned))


class _PrimitiveRecord(msgspec.Struct, frozen=True):
    type: int
    dimensions: list[float]


class _MeshRecord(msgspec.Struct, frozen=True):
    vertices: list[_PointRecord] = []
    resource: str | None = None
    scale: float = 1.0


class _HeaderRecord(msgspec.Struct, frozen=True):
    frame_id: str = ""


class _ObjectRecord(msgspec.Struct, frozen=True):
    id: str = ""
    header: _HeaderRecord = _HeaderRecord()
    pose: _PoseRecord = _PoseRecord()
    primitives: list[_PrimitiveRecord] = []
    primitive_poses: list[_PoseRecord] = []
    meshes: list[_MeshRecord] = []
    mesh_poses: list[_PoseRecord] = []
    planes: list[Any] = []
    operation: int | str = 0


class _AttachedRecord(msgspec.Struct, frozen=True):
    link_name: str = ""
    object: _ObjectRecord = _ObjectRecord()


class _WorldRecord(msgspec.Struct, frozen=True):
    collision_objects: list[_ObjectRecord] = []


class _StateRecord(msgspec.Struct, frozen=True):
    attached_collision_objects: list[_AttachedRecord] = []


class _SceneRecord(msgspec.Struct, frozen=True):
    world: _WorldRecord = _WorldRecord()
    robot_state: _StateRecord = _StateRecord()
    collision_objects: list[_ObjectRecord] = []


def objects_of_message(message: Any, where: Path) -> list[SceneObject]:
    """Return the objects of a message, including those attached to links.

    Raises
    ------
    ProblemError
        With the key of the first fault.
    """
    try:
        scene = msgspec.convert(message, type=_SceneRecord, strict=False)
    except msgspec.ValidationError as cause:
        raise ProblemError(f"{where}: {cause} ($ is the file)") from None
    every = [*scene.world.collision_objects, *scene.collision_objects]
    found = [
        _message_object(one, one.header.frame_id, where) for one in every if _there(one)
    ]
    for held in scene.robot_state.attached_collision_objects:
        frame = held.object.header.frame_id or held.link_name
        found.append(_message_object(held.object, frame, where))
    return found


def _message_object(one: _ObjectRecord, frame: str, where: Path) -> SceneObject:
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
    every: list[_PrimitiveRecord | _MeshRecord] = [*one.primitives, *one.meshes]
    for k, part in enumerate(every):
        try:
            shape = _message_shape(part, where)
            own = (poses[k] if poses else _PoseRecord()).value()
            shapes.append(beyond(one.pose.value(), PlacedShape(shape, *own)))
        except ProblemError as cause:
            raise ProblemError(f"{name}: {cause}") from None
    return SceneObject(one.id, frame, tuple(shapes))


def _there(one: _ObjectRecord) -> bool:
    return one.operation != _REMOVED


def _message_shape(part: _PrimitiveRecord | _MeshRecord, where: Path) -> Any:
    if isinstance(part, _MeshRecord):
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


def objects_of_text(text: str, where: Path) -> list[SceneObject]:
    """Return the objects of a ``.scene`` file.

    Raises
    ------
    ProblemError
        With the line of the first fault.
    """
    reader = _TextReader(text.splitlines(), where)
    reader.line()  # the scene's name
    found = []
    while (head := reader.line()) != ".":
        if not head.startswith("*"):
            raise reader.fault(f"{head[:40]!r}, expected '* NAME' of an object, or '.'")
        found.append(_text_object(reader, head[1:].strip()))
    return found


def _text_object(reader: "_TextReader", name: str) -> SceneObject:
    posed = reader.ahead() > 1  # older files go on with the number of shapes
    frame = reader.pose() if posed else None
    shapes = []
    for _ in range(reader.count()):
        shapes += _text_shapes(reader)
    if posed:
        for _ in range(reader.count()):
            reader.line()
            reader.numbers(7)
    if frame is not None:
        shapes = [beyond(frame, placed) for placed in shapes]
    return SceneObject(name, "", tuple(shapes))


def _text_shapes(reader: "_TextReader") -> list[PlacedShape]:
    kind = reader.line()
    if kind == "mesh":
        vertices, triangles = reader.count(), reader.count()
        points = reader.numbers(3 * vertices).reshape(-1, 3)
        reader.numbers(3 * triangles)
        shape = reader.made(shape_of, "mesh", points)
    elif kind in _TEXT_SIZES:
        sizes = reader.numbers(_TEXT_SIZES[kind])
        shape = reader.made(shape_of, kind, sizes)
    else:
        known = ", ".join((*_TEXT_SIZES, "mesh"))
        raise reader.fault(f"shape {kind[:40]!r}, expected one of {known}")
    placed = PlacedShape(shape, *reader.pose())
    reader.numbers(4)
    return [placed]


@dataclass(slots=True)
class _TextReader:
    """Lines, and the numbers in them, one after another."""

    lines: list[str]
    where: Path
    number: int = 0
    words: list[str] = field(default_factory=list)

    def line(self) -> str:
        """Return the next line that is not empty."""
        while self.number < len(self.lines):
            text = self.lines[self.number].strip()
            self.number += 1
            if text:
                return text
        raise self.fault("it ends here, expected a last line '.'")

    def ahead(self) -> int:
        """Return the number of words of the next line."""
        left = (text.split() for text in self.lines[self.number :])
        return len(next((words for words in left if words), []))

    def numbers(self, count: int) -> Array:
        """Return a number of values, from as many lines as needed."""
        if count > _MOST_NUMBERS:
            raise self.fault(f"{count} numbers, expected {_MOST_NUMBERS} at most")
        while len(self.words) < count:
            self.words += self.line().split()
        taken, self.words = self.words[:count], self.words[count:]
        try:
            values = np.array([float(word) for word in taken])
        except ValueError as cause:
            raise self.fault(f"{cause}, expected {count} numbers") from None
        if not np.isfinite(values).all():
            raise self.fault(f"{taken}, expected finite numbers")
        return values

    def count(self) -> int:
        """Return a count."""
        (value,) = self.numbers(1)
        if value < 0 or value != int(value):
            raise self.fault(f"{value:g}, expected the number of shapes")
        return int(value)

    def pose(self) -> Pose:
        """Return a position and a quaternion as a pose."""
        return self.made(pose_of, self.numbers(3), self.numbers(4))

    def made(self, make: Callable[..., _T], *given: Any) -> _T:
        """Return a function's result; its errors name the line."""
        try:
            return make(*given)
        except ProblemError as cause:
            raise self.fault(str(cause)) from None

    def fault(self, text: str) -> ProblemError:
        return ProblemError(f"{self.where}, line {self.number}: {text}")
