"""A move replayed in 3-D: one HTML file that needs neither network nor server.

The robot and its obstacles are drawn in a viser scene.
"""

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.files import write_atomically
from consistent_id.errors import ProblemError
from consistent_id.motion.collisions.bodies import (
    Body,
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    Hull,
    Sphere,
)
from consistent_id.motion.collisions.scene import Scene, place_of
from consistent_id.motion.moves import Move
from consistent_id.recordings.joint_paths import sampled
from consistent_id.robot.kinematics import FixedPlace, LinkPlaces, link_places
from consistent_id.robot.model import RobotModel

_RATE = 30.0  # pictures per second
_PAUSE = 1.0  # [s] before it begins again
_WAY, _PATH = (150, 150, 150), (0, 114, 178)  # colours off and on the trajectory

_ROOT = "/robot"
_THICK = 0.025  # radius of a link without a shape, in reaches of the robot
_FLOOR = 4.0  # width of the piece of a half-space that is drawn, in reaches

Pose = Mapping[str, float]
Show = Callable[[Pose], None]


class _Paint(NamedTuple):
    """Colour of a mesh, and its opacity if it is transparent."""

    colour: tuple[int, int, int]
    opacity: float | None = None


_LINKS = _Paint((0, 114, 178)), _Paint((86, 180, 233))  # of links in turn
_JOINT = _Paint((90, 90, 90))
_OPACITY = 0.35  # of bodies of a scene
_BODY, _OBSTACLE = _Paint((86, 180, 233), _OPACITY), _Paint((213, 94, 0), _OPACITY)
_GROUND = _Paint((200, 200, 200), _OPACITY)

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Drawn:
    """A robot in a viewer.

    Parameters
    ----------
    show : callable
        Moves it to a pose, by joint.
    by_shapes : bool
        Whether it is drawn by its file's shapes, or as sticks.
    """

    show: Show
    by_shapes: bool


@dataclass(frozen=True, slots=True)
class ShapesFile:
    """A URDF with visual shapes, and where the rest of it is.

    Parameters
    ----------
    urdf : Path
    package_dirs : tuple of str or Path
        Folders in which ``package://name/...`` is searched for, besides those above.
    locked : mapping of str to float, optional, [rad or m]
        Positions of the file's joints that do not move.
    """

    urdf: Path
    package_dirs: tuple[str | Path, ...] = ()
    locked: Mapping[str, float] | None = None


def write_replay(
    move: Move,
    robot: RobotModel,
    file: str | Path,
    *,
    shapes: ShapesFile | None = None,
    scene: Scene | None = None,
) -> Path:
    """Write a page that replays a move; return the file.

    Run-in, trajectory and run-out are shown by a label and by the colour of the path of
    the last link's origin.  The page contains viewer, robot and motion.

    Parameters
    ----------
    shapes : ShapesFile, optional
        The robot's file; its visual shapes are drawn by Pinocchio's
        ``ViserVisualizer``.  Without shapes, links are sticks.
    scene : Scene, optional
        Scene whose obstacles are drawn, and, with sticks, the robot's bodies.

    Raises
    ------
    ProblemError
        If viser is missing, or the file cannot be written.
    """
    require_viewer(file)
    import viser

    with redirect_stdout(StringIO()):  # of the server's address, which is not needed
        server = viser.ViserServer("127.0.0.1", 0, verbose=False)
        try:
            html = _recorded(server, move, robot, shapes, scene).as_html()
        finally:
            server.stop()
    title = f"<title>{robot.name}: {move.duration:.1f} s</title>"
    generator = '<meta name="generator" content="consistent-id: replay">'
    marked = html.replace("<title>Viser</title>", generator + title, 1)
    return write_atomically(file, marked)


def require_viewer(file: str | Path) -> None:
    """Require the library for drawing.

    Raises
    ------
    ProblemError
        If it is missing; the message says how to install it.
    """
    from importlib.util import find_spec

    if find_spec("viser") is None:
        raise ProblemError(
            f"{file}: a replay needs viser; pip install 'consistent-id[viz]'"
        )


def _recorded(
    server: Any,
    move: Move,
    robot: RobotModel,
    shapes: ShapesFile | None,
    scene: Scene | None,
) -> Any:
    samples = sampled(move, _RATE)
    tip = _draw_path(server, move, robot)
    drawn = drawn_robot(server, robot, shapes)
    shows = [drawn.show]
    if scene is not None:
        shows.append(drawn_bodies(server, scene, _seen(drawn.by_shapes)))
    _look(server, tip)
    above = (0.0, 0.0, 1.1 * float(tip[:, 2].max()))
    label = server.scene.add_label("/phase", "", position=above)
    recording = server.get_scene_serializer()
    step = float(np.diff(samples.time)[0])
    for time, q in zip(samples.time, samples.position, strict=True):
        phase = _phase(move, time)
        if label.text != phase:
            label.text = phase
        pose = dict(zip(move.joints, q.tolist(), strict=True))
        for show in shows:
            show(pose)
        recording.insert_sleep(step)
    recording.insert_sleep(_PAUSE)
    return recording


def _draw_path(server: Any, move: Move, robot: RobotModel) -> Matrix:
    """Draw the path of the last link's origin; return its points, (samples, 3)."""
    samples = sampled(move, 4.0 * _RATE).of(robot.joint_names)
    tip = link_places(robot, samples.position).translation[:, -1]
    excites = move.excites(samples.time)[:-1, None, None]
    colours = np.where(excites, np.array(_PATH), np.array(_WAY))
    server.scene.add_line_segments(
        "/path",
        np.stack([tip[:-1], tip[1:]], axis=1).astype(np.float32),
        np.repeat(colours, 2, axis=1).astype(np.uint8),
        thickness=0.004 * reach_of(robot),
    )
    return np.asarray(tip)


def _look(server: Any, tip: Matrix) -> None:
    far = float(np.linalg.norm(tip, axis=1).max())
    middle = (tip.min(axis=0, initial=0.0) + tip.max(axis=0, initial=0.0)) / 2.0
    server.scene.set_up_direction("+z")
    server.initial_camera.position = middle + far * np.array([1.7, 1.3, 0.8])
    server.initial_camera.look_at = middle
    server.initial_camera.fov = np.radians(50.0)


def _phase(move: Move, time: float) -> str:
    begin, end = move.window
    return "run-in" if time < begin else "run-out" if time > end else "trajectory"


def _seen(by_shapes: bool) -> Callable[[Body], bool]:
    """Return the bodies of the robot that its shapes do not show."""

    def seen(body: Body) -> bool:
        frame = body.frame or ""
        of_file = body.name == frame or body.name.startswith(f"{frame}:")
        return not (by_shapes and of_file)

    return seen


def drawn_robot(
    server: Any, robot: RobotModel, shapes: ShapesFile | None = None
) -> Drawn:
    """Draw a robot by its file's visual shapes, or as sticks.

    Parameters
    ----------
    shapes : ShapesFile, optional
        Without one, or without shapes that can be read, sticks are drawn.
    """
    if shapes is not None:
        try:
            return Drawn(_meshes(server, shapes), True)
        except (ValueError, OSError, ImportError) as cause:
            _log.warning("%s: drawn as sticks: %s", shapes.urdf, cause)
            server.scene.remove_by_name(_ROOT)
    return Drawn(_sticks(server, robot), False)


def _meshes(server: Any, shapes: ShapesFile) -> Show:
    urdf, package_dirs = shapes.urdf, shapes.package_dirs
    locked: Pose = shapes.locked or {}
    import pinocchio as pin
    from pinocchio.visualize import ViserVisualizer

    folders = [str(Path(folder).absolute()) for folder in package_dirs]
    folders += [str(folder) for folder in urdf.absolute().parents]
    model = pin.buildModelFromUrdf(str(urdf))
    kind = pin.GeometryType.VISUAL
    drawn = pin.buildGeomFromUrdf(model, str(urdf), kind, package_dirs=folders)
    if not len(drawn.geometryObjects):
        raise ValueError("it has no visual shapes")
    # The visualizer cannot do without a collision model: an empty one.
    visualizer = ViserVisualizer(model, pin.GeometryModel(), drawn)
    visualizer.initViewer(viewer=server)
    visualizer.loadViewerModel(_ROOT)
    neutral = pin.neutral(model)

    def show(pose: Pose) -> None:
        q = neutral.copy()
        for name, value in {**locked, **pose}.items():
            joint = model.joints[model.getJointId(name)]
            turns = joint.nq == 2  # a continuous joint: cosine and sine
            q[joint.idx_q : joint.idx_q + joint.nq] = (
                (np.cos(value), np.sin(value)) if turns else value
            )
        visualizer.display(q)

    return show


def _sticks(server: Any, robot: RobotModel) -> Show:
    """Draw each link as rods from its joint to the next ones."""
    thick = _THICK * reach_of(robot)
    for number, (link, end) in enumerate(_rods(robot)):
        if np.linalg.norm(end) > thick / 4.0:
            rod = _rod(np.zeros(3), end, thick)
            _add(server, f"{_node(robot, link)}/rod {number}", rod, _LINKS[link % 2])
    for k, joint in enumerate(robot.joints):
        along = 1.6 * thick * joint.axis
        hub = _rod(-along, along, 1.3 * thick)
        _add(server, f"{_node(robot, k)}/axis", hub, _JOINT)
    handles = {
        k: server.scene.add_frame(_node(robot, k), show_axes=False)
        for k in range(len(robot.links))
    }
    tip = len(robot.links) - 1
    axes = {"axes_length": 4.0 * thick, "axes_radius": thick / 4.0}
    server.scene.add_frame(f"{_node(robot, tip)}/axes", **axes)

    def show(pose: Pose) -> None:
        places = link_places(robot, [[pose[name] for name in robot.joint_names]])
        for k, handle in handles.items():
            _put(handle, places, FixedPlace(k, np.eye(3), np.zeros(3)))

    return show


def _rods(robot: RobotModel) -> Iterator[tuple[int, Vector]]:
    """Yield links, -1 for the base, and in their frames where the next one begins."""
    for joint in robot.joints:
        yield joint.parent, joint.translation
    for k, link in enumerate(robot.links):
        for frame in link.merged:
            yield k, frame.translation


def drawn_bodies(server: Any, scene: Scene, shown: Callable[[Body], bool]) -> Show:
    """Draw a scene's obstacles, and its bodies of the robot, see-through.

    Parameters
    ----------
    shown : callable
        Returns whether a body of the robot is visible at first.
    """
    robot, moving = scene.robot, []
    for number, body in enumerate(scene.bodies):
        if body.turning:  # a direction has no position
            continue
        place = place_of(robot, body)
        folder = "obstacles" if body.frame is None else "bodies"
        name = f"/{folder}/{number} {body.name.replace('/', ' ')}"
        mesh = _mesh(body, _FLOOR * reach_of(robot))
        visible = body.frame is None or shown(body)
        handle = _add(server, name, mesh, _paint(body), visible)
        if place.link < 0:
            handle.position, handle.wxyz = place.translation, _wxyz(place.rotation)
        elif visible:
            moving.append((handle, place))

    def show(pose: Pose) -> None:
        places = link_places(robot, [[pose[name] for name in robot.joint_names]])
        for handle, place in moving:
            _put(handle, places, place)

    return show


def reach_of(robot: RobotModel) -> float:
    """Return the reach of a robot's links, stretched out [m]."""
    steps = [np.linalg.norm(joint.translation) for joint in robot.joints]
    tools = [
        np.linalg.norm(frame.translation)
        for link in robot.links
        for frame in link.merged
    ]
    return float(sum(steps) + max(tools, default=0.0)) or 1.0


def _node(robot: RobotModel, link: int) -> str:
    name = "base" if link < 0 else robot.link_names[link].replace("/", " ")
    return f"{_ROOT}/{name}"


def _put(handle: Any, places: LinkPlaces, place: FixedPlace) -> None:
    frame = places.of(place)
    handle.position, handle.wxyz = frame.translation[0], _wxyz(frame.rotation[0])


def _add(
    server: Any,
    name: str,
    mesh: Any,
    paint: _Paint,
    visible: bool = True,
) -> Any:
    return server.scene.add_mesh_simple(
        name,
        np.asarray(mesh.vertices, dtype=np.float32),
        np.asarray(mesh.faces, dtype=np.uint32),
        color=paint.colour,
        opacity=paint.opacity,
        side="double",
        visible=visible,
    )


def _rod(start: Vector, end: Vector, radius: float) -> Any:
    import trimesh

    way = end - start
    length = float(np.linalg.norm(way))
    capsule = trimesh.creation.capsule(height=length, radius=radius, count=(16, 16))
    capsule.apply_translation(-capsule.bounds.mean(axis=0))  # versions differ
    turned = trimesh.geometry.align_vectors((0.0, 0.0, 1.0), way)
    turned[:3, 3] = (start + end) / 2.0
    return capsule.apply_transform(turned)


def _mesh(body: Body, floor: float) -> Any:
    """Return a body's surface in its own frame."""
    import trimesh

    match body.shape:
        case Sphere(radius):
            return trimesh.creation.icosphere(subdivisions=3, radius=radius)
        case Box(size):
            return trimesh.creation.box(size)
        case Capsule(radius, length):
            half = np.array([0.0, 0.0, length / 2.0])
            return _rod(-half, half, radius)
        case Cylinder(radius, length):
            return trimesh.creation.cylinder(radius=radius, height=length)
        case Hull() as hull:
            return trimesh.Trimesh(hull.points, hull.facets, process=False)
    slab = trimesh.creation.box((floor, floor, 0.01))
    return slab.apply_translation((0.0, 0.0, -0.005))


def _paint(body: Body) -> _Paint:
    if isinstance(body.shape, HalfSpace):
        return _GROUND
    return _OBSTACLE if body.frame is None else _BODY


def _wxyz(rotation: Matrix) -> Array:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_quat()[[3, 0, 1, 2]])
