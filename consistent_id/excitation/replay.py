"""A move replayed in 3-D: one HTML file that needs neither network nor server."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id._support.files import write_atomically
from consistent_id.errors import ProblemError
from consistent_id.excitation.drawings import drawn_bodies, drawn_robot, reach_of
from consistent_id.motion.collisions.bodies import Body
from consistent_id.motion.collisions.scene import Scene
from consistent_id.motion.move import Move
from consistent_id.recordings.paths import sampled
from consistent_id.robot.kinematics import link_places
from consistent_id.robot.model import RobotModel

_RATE = 30.0  # pictures per second
_PAUSE = 1.0  # [s] before it begins again
_WAY, _PATH = (150, 150, 150), (0, 114, 178)  # colours off and on the trajectory


def write_replay(
    move: Move,
    robot: RobotModel,
    file: str | Path,
    *,
    urdf: Path | None = None,
    package_dirs: Iterable[str | Path] = (),
    locked: Mapping[str, float] | None = None,
    scene: Scene | None = None,
) -> Path:
    """Write a page that replays a move; return the file.

    Run-in, trajectory and run-out are shown by a label and by the colour of the path of
    the last link's origin.  The page holds viewer, robot and motion.

    Parameters
    ----------
    urdf : Path, optional
        The robot's file; its visual shapes are drawn by Pinocchio's
        ``ViserVisualizer``.  Without shapes, links are sticks.
    package_dirs : iterable of str or Path
        Folders in which ``package://name/...`` is looked for, besides those above.
    locked : mapping of str to float, optional, [rad or m]
        Positions of the file's joints that do not move.
    scene : Scene, optional
        Whose obstacles are drawn too; and the robot's bodies, where sticks are.

    Raises
    ------
    ProblemError
        If viser is missing, or the file cannot be written.
    """
    require_viewer(file)
    import viser

    with redirect_stdout(StringIO()):  # of the server's address, which nobody needs
        server = viser.ViserServer("127.0.0.1", 0, verbose=False)
        try:
            html = _recorded(
                server, move, robot, urdf, package_dirs, locked, scene
            ).as_html()
        finally:
            server.stop()
    title = f"<title>{robot.name}: {move.duration:.1f} s</title>"
    generator = '<meta name="generator" content="consistent-id: replay">'
    marked = html.replace("<title>Viser</title>", generator + title, 1)
    return write_atomically(file, marked)


def require_viewer(file: str | Path) -> None:
    """Refuse to go on without the library that draws.

    Raises
    ------
    ProblemError
        If it is missing; it says how to install it.
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
    urdf: Path | None,
    package_dirs: Iterable[str | Path],
    locked: Mapping[str, float] | None,
    scene: Scene | None,
) -> Any:
    samples = sampled(move, _RATE)
    tip = _draw_path(server, move, robot)
    drawn = drawn_robot(server, robot, urdf, package_dirs, locked)
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
    """Return which bodies of the robot to show: those that shapes do not show."""

    def seen(body: Body) -> bool:
        frame = body.frame or ""
        of_file = body.name == frame or body.name.startswith(f"{frame}:")
        return not (by_shapes and of_file)

    return seen
