"""The feet of a robot and their contacts, from columns' names or from their motion."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import RecordingError
from consistent_id.motion.collisions.bodies import Sphere
from consistent_id.motion.collisions.urdf_bodies import link_bodies
from consistent_id.problems.task_tables import ALWAYS
from consistent_id.recordings.column_names import shown
from consistent_id.recordings.readers.beside_columns import ContactColumns
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.sensor_words import contact_names, matched_frame
from consistent_id.recordings.signals import differentiated, low_passed, resampled
from consistent_id.recordings.signals.base_signals import stretches
from consistent_id.recordings.signals.clocks import is_uniform, own_rate
from consistent_id.regression.rows.contact_maps import contact_slip
from consistent_id.robot.kinematics import ancestors, fixed_place
from consistent_id.robot.loaders.mjcf_spec import read_spec
from consistent_id.robot.loaders.robot_file import is_mjcf
from consistent_id.robot.loaders.urdf_lint import read_bytes
from consistent_id.robot.loaders.xml import parse
from consistent_id.robot.model import Link, RobotModel
from consistent_id.robot.parameters import did_you_mean

_WORDS = ("foot", "sole", "toe", "ankle", "calf", "shank", "feet")  # the best first
_SOLE = 5  # joints of a leg with which its foot can be flat on the ground

SLIP = 0.05
"""Speed [m/s] above which feet that move against each other do not stand.  A swinging
foot is about ten times as fast, a rolling or creeping foot has a fifth of this speed.
"""

_STANDS = 0.9  # share of the samples in which feet are at rest, of a robot that stands
# s; one and a half periods of a draft's 30 Hz.  Two, as `impact_guard` says, leave less
# of a robot that trots.
_GUARD = 0.05
_SHORTEST = 1.0  # s, of a stretch between gaps in which motion is looked at
_CUTOFF = 10.0  # Hz, of the motion by which feet are seen to stand


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
        The contact's place in the frame; for a ball, its centre.
    radius : float, [m]
        The radius of a ball.
    shaped : bool
        Whether the model's file has a ball there; else `point` is the frame's origin.
    """

    frame: str
    names: tuple[str, ...]
    surface: bool
    point: Vector
    radius: float = 0.0
    shaped: bool = False


def feet_of(robot: RobotModel, path: Path) -> tuple[Foot, ...]:
    """Return the robot's feet: the last bodies of its limbs, if their names say so.

    Parameters
    ----------
    robot : RobotModel
        A robot with a floating base.
    path : Path
        The robot's URDF or MJCF file, which has the shapes.
    """
    parents = {joint.parent for joint in robot.joints}
    last = [k for k in range(len(robot.links)) if k not in parents and k > 0]
    ends = {k: frame for k in last if (frame := _frame(robot.links[k])) is not None}
    return tuple(_foot(robot, path, k, frame) for k, frame in ends.items())


def _frame(link: Link) -> str | None:
    """Return the frame of a body whose name is that of a foot, if there is one."""
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


@dataclass(frozen=True, slots=True)
class ContactGuess:
    """Columns of contacts, and notes on them.

    Parameters
    ----------
    assumed : bool
        Whether feet are assumed to stand; `require_standing` checks the motion.
    """

    columns: tuple[ContactColumns, ...]
    notes: tuple[str, ...] = ()
    assumed: bool = False


def guessed_contacts(names: Sequence[str], feet: Sequence[Foot]) -> ContactGuess:
    """Return a contact for each foot: its column, or one that is always closed."""
    by_frame = {foot.frame: foot for foot in feet}
    candidates = contact_names(names)
    others = {foot.frame: foot.names for foot in feet}
    flags: dict[str, str] = {}
    for column in candidates:
        frame = matched_frame(column, others)
        if frame is not None and frame not in flags:
            flags[frame] = column
    if feet and set(flags) == set(by_frame):
        found = [_contact(by_frame[frame], flag) for frame, flag in flags.items()]
        said = ", ".join(f"{frame}: {flag}" for frame, flag in flags.items())
        return ContactGuess(tuple(found), (f"contacts are {said}", *_shapes(feet)))
    standing = tuple(_contact(foot, True) for foot in feet)
    if not standing:
        note = "no foot is found in the robot's file: there are no contacts"
        return ContactGuess((), (note,))
    note = (
        f"no column has contact flags of {shown(list(by_frame))}: they are at rest "
        f"against each other, and assumed to stand all the time"
    )
    return ContactGuess(standing, (note, *_shapes(feet)), assumed=True)


def stated_contacts(
    stated: dict[str, str], feet: Sequence[Foot], robot: RobotModel
) -> ContactGuess:
    """Return the contacts that a user names, in the shape of feet.

    Raises
    ------
    RecordingError
        If there is no such frame.
    """
    by_frame = {foot.frame: foot for foot in feet}
    merged = [frame.name for link in robot.links for frame in link.merged]
    known = [*by_frame, *robot.link_names, *merged]
    found = []
    for frame, column in stated.items():
        if frame not in known:
            near = did_you_mean(frame, list(by_frame) or known)
            raise RecordingError(f"--contact: no frame {frame!r}; {near}")
        foot = by_frame.get(frame) or Foot(frame, (frame,), False, np.zeros(3))
        found.append(_contact(foot, True if column == ALWAYS else column))
    used = [by_frame[frame] for frame in stated if frame in by_frame]
    return ContactGuess(tuple(found), _shapes(used))


def require_standing(
    robot: RobotModel, logs: Sequence[Recording], names: Sequence[str], file: Path
) -> None:
    """Refuse the assumption that feet stand if they move against each other.

    Parameters
    ----------
    logs : sequence of Recording
        With contacts that are closed all the time.
    names : sequence of str
        Names of the log's columns, for the message.

    Raises
    ------
    RecordingError
        The message proposes an option.
    """
    share = share_at_rest(robot, logs)
    if share < _STANDS:
        frames = [flags.frame for flags in logs[0].contacts]
        raise RecordingError(
            f"{file}: no column has contact flags, and feet do not stand all the "
            f"time: in {1 - share:.0%} of the samples {shown(frames)} move faster "
            f"than {SLIP} m/s against each other. Name the column of each: --contact "
            f"{frames[0]}=COLUMN ..., or {frames[0]}={ALWAYS} for a foot that is "
            "never lifted; for a robot that hangs or flies --contact none. If all "
            "feet stood, check the place and axes of the measuring unit: --imu "
            f"FRAME. The log has {shown(names)}"
        )


def share_at_rest(robot: RobotModel, logs: Sequence[Recording]) -> float:
    """Return the share of samples in which no closed contact slips."""
    at_rest = [
        (contact_slip(robot, smooth_motion(part)) < SLIP).all(axis=1)
        for part in without_gaps(logs)
    ]
    return float(np.concatenate(at_rest).mean()) if at_rest else 0.0


def without_gaps(logs: Sequence[Recording]) -> list[Recording]:
    """Return logs, cut at their gaps."""
    return [
        log.samples(stretch)
        for log in logs
        for stretch in stretches(log.time)
        if log.time[stretch][-1] - log.time[stretch][0] > _SHORTEST
    ]


def smooth_motion(log: Recording) -> Recording:
    """Return a log's motion filtered, with velocities, on a uniform clock."""
    even = log if is_uniform(log) else resampled(log, own_rate(log))
    cutoff = min(_CUTOFF, 0.2 * even.rate)
    return differentiated(low_passed(even, motion_cutoff=cutoff))


def _contact(foot: Foot, closed: str | bool) -> ContactColumns:
    return ContactColumns(
        foot.frame,
        closed,
        guard=_GUARD,
        point=foot.point,
        surface=foot.surface,
        radius=foot.radius,
    )


def _shapes(feet: Sequence[Foot]) -> tuple[str, ...]:
    """Return the assumed shapes of feet, in words."""
    soles = [foot.frame for foot in feet if foot.surface]
    bare = [foot.frame for foot in feet if not foot.surface and not foot.shaped]
    notes = [f"{shown(soles)} are soles, flat on the ground"] if soles else []
    if bare:
        notes.append(
            f"{shown(bare)} touch at the origin of their frames, as the file has no "
            "ball there: check point and radius"
        )
    return tuple(notes)
