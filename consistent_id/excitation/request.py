"""The request of a problem's ``[excitation]`` table, as values of a design.

The scene is the one that the file requests, or the robot's own shapes without one.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import ConsistentIdError, ProblemError
from consistent_id.excitation.aims import Aim, PathForm, forms_to_try, interest_names
from consistent_id.excitation.criteria import Objective
from consistent_id.excitation.unused_limits import unused_limits
from consistent_id.excitation.unweighed_links import links_behind_tip, massless_links
from consistent_id.excitation.verification import FRICTION_SHARE, FileParts
from consistent_id.motion.collisions.bodies import (
    Body,
    Box,
    Capsule,
    Cylinder,
    Shape,
    Sphere,
    plane,
)
from consistent_id.motion.collisions.confinement import (
    OrientationCone,
    Workspace,
    within_cones,
    within_workspaces,
)
from consistent_id.motion.collisions.planning_scene import planning_scene_bodies
from consistent_id.motion.collisions.scene import PairNote, Scene
from consistent_id.motion.collisions.scene_building import build_scene, scene_from_urdf
from consistent_id.motion.collisions.separation import nearest
from consistent_id.motion.collisions.urdf_bodies import has_collision_shapes
from consistent_id.motion.limits import MotionLimits, motion_limits
from consistent_id.problems.problem import Problem
from consistent_id.problems.stated_model import drawn_drives
from consistent_id.problems.task_tables import (
    CLEARANCE,
    BodyTable,
    BoxTable,
    ConeTable,
    ExcitationTable,
    LimitsTable,
    RodTable,
    SceneTable,
    SphereTable,
    WorkspaceTable,
)
from consistent_id.recordings.joint_paths import FourierTrajectory
from consistent_id.robot.loaders.urdf_in_place import rotation_of
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import did_you_mean

_WHERE = "[excitation.scene]"
_SHAPES = ("sphere", "box", "capsule", "cylinder")

_NONE = "no scene"


def requested_scene(problem: Problem) -> Scene | None:
    """Return the scene of ``[excitation.scene]``; None without, or if left out.

    Raises
    ------
    ProblemError
        If the table contradicts itself or the robot; it names the key.
    """
    table = problem.table.excitation.scene
    if table is None or not problem.table.excitation.collisions:
        return None
    if table.robot == "urdf" and problem.table.model.urdf is None:
        raise ProblemError(_without_shapes(problem))
    bodies = [_body(body, number) for number, body in enumerate(table.bodies, 1)]
    try:
        if table.planning_scene is not None:
            file = problem.file(table.planning_scene)
            bodies += planning_scene_bodies(file, problem.moving)
        of = _of_urdf if table.robot == "urdf" else _of_bodies
        boxes = [_workspace(box) for box in table.workspaces]
        scene = within_workspaces(of(problem, table, bodies), boxes)
        return within_cones(scene, [_cone(cone) for cone in table.cones])
    except ConsistentIdError as cause:
        raise ProblemError(f"{_WHERE}: {cause}") from None


def default_scene(
    problem: Problem, pose: dict[str, float] | None
) -> tuple[Scene | None, tuple[str, ...]]:
    """Return the collision shapes of a problem's URDF as a scene, and notes on it.

    If a shape cannot be read, there is no scene, and a note gives the reason; it is not
    an error, because the scene is a default.

    Parameters
    ----------
    problem : Problem
        Without ``[excitation.scene]``.
    pose : dict from joint to position, optional
        Pose of the robot: shapes that touch there are too large, and are not checked.
    """
    urdf = problem.table.model.urdf
    if not problem.table.excitation.collisions:
        return None, (f"{_NONE}, as requested",)
    if urdf is None:
        return None, (f"{_NONE}: no URDF, and no [excitation.scene]",)
    file = problem.file(urdf)
    if not has_collision_shapes(file):
        return None, (f"{_NONE}: {file.name} has no <collision> shapes",)
    try:
        scene = scene_from_urdf(
            file, problem.moving, clearance=CLEARANCE, readable_only=True
        )
    except ConsistentIdError as cause:
        return None, (f"{_NONE}: {cause}",)
    around = (
        "self-collisions are avoided, by the shapes of the URDF; obstacles are "
        "unknown: --ground, [excitation.scene]; --no-collisions"
    )
    return (scene if pose is None else _apart_at(scene, pose)), (around,)


def _cone(table: ConeTable) -> OrientationCone:
    return OrientationCone(
        table.link,
        float(np.radians(table.angle_deg)),
        np.array(table.axis),
        np.array(table.direction),
    )


def _workspace(table: WorkspaceTable) -> Workspace:
    sides = [table.x, table.y, table.z]
    low, high = np.array(
        [(-np.inf, np.inf) if side is None else side for side in sides]
    ).T
    return Workspace(table.link, low, high, np.array(table.point))


def _without_shapes(problem: Problem) -> str:
    """Return what to do for a scene of a robot whose shapes are not read."""
    mjcf = problem.table.model.mjcf
    whose = "and this robot has none"
    if mjcf is not None:
        whose = f"not from MJCF files such as {Path(mjcf).name}"
    link = problem.moving.link_names[-1]
    return (
        f"collision shapes are read from URDF files only, {whose}: --ground, "
        "--clearance, --allowed and --planning-scene need them. Leave these out, and "
        "collisions are not checked; or use the robot's URDF; or describe the robot's "
        "bodies: consistent-id init ROBOT writes a problem.toml, in which "
        '[excitation.scene] needs robot = "bodies", and a table '
        "[[excitation.scene.bodies]] for each body, such as "
        f'name = "{link}", link = "{link}", sphere = {{ radius = 0.1 }}'
    )


def _of_urdf(problem: Problem, table: SceneTable, bodies: list[Body]) -> Scene:
    urdf = problem.table.model.urdf
    if urdf is None:
        raise ProblemError(_without_shapes(problem))
    return scene_from_urdf(
        problem.file(urdf),
        problem.moving,
        package_dirs=[problem.file(folder) for folder in table.packages],
        elements=table.elements,
        pieces=table.pieces,
        ground=table.ground,
        added=bodies,
        clearance=CLEARANCE if table.clearance is None else table.clearance,
        relax=table.clearance is None,
        extra=table.extra,
        allowed=table.allowed,
    )


def _of_bodies(problem: Problem, table: SceneTable, bodies: list[Body]) -> Scene:
    if not any(body.frame for body in bodies):
        raise ProblemError(
            'robot = "bodies", but none of [[excitation.scene.bodies]] has a link; say '
            "which of them are the robot's"
        )
    floor = [] if table.ground is None else [plane(table.ground)]
    return build_scene(
        problem.moving,
        [*floor, *bodies],
        clearance=CLEARANCE if table.clearance is None else table.clearance,
        relax=table.clearance is None,
        extra=table.extra,
        allowed=table.allowed,
    )


def _body(table: BodyTable, number: int) -> Body:
    where = f"[[excitation.scene.bodies]] {number}, {table.name!r}"
    shapes = {name: getattr(table, name) for name in _SHAPES}
    given = [name for name, shape in shapes.items() if shape is not None]
    if len(given) != 1:
        seen = " and ".join(given) or "none"
        raise ProblemError(f"{where} needs one of {', '.join(_SHAPES)}; it has {seen}")
    rotation, translation = (
        rotation_of(np.radians(table.rpy_deg).tolist()),
        np.array(table.position),
    )
    shape: Shape
    match shapes[given[0]]:
        case SphereTable() as ball:
            shape = Sphere(ball.radius)
        case BoxTable() as box:
            shape = Box(box.size)
        case rod:
            length, turn, middle = _rod(rod, where)
            kind = Capsule if given == ["capsule"] else Cylinder
            shape = kind(rod.radius, length)
            translation, rotation = translation + rotation @ middle, rotation @ turn
    return Body(table.name, shape, table.link, rotation, translation)


def _rod(rod: RodTable, where: str) -> tuple[float, Matrix, Vector]:
    """Return length, orientation and middle of a capsule or cylinder."""
    if (rod.length is None) == (rod.ends is None):
        seen = "neither" if rod.length is None else "both"
        raise ProblemError(f"{where}: a rod needs length or ends; it has {seen}")
    if rod.ends is None:
        return float(rod.length or 0.0), np.eye(3), np.zeros(3)
    first, last = np.array(rod.ends)
    way = last - first
    length = float(np.linalg.norm(way))
    if length == 0.0:
        raise ProblemError(f"{where}: both ends are {rod.ends[0]}; write a sphere")
    return length, _along(way / length), (first + last) / 2.0


def _along(way: Vector) -> Matrix:
    """Return a rotation of z to a unit vector."""
    return np.asarray(plane(normal=way).rotation)


def _apart_at(scene: Scene, pose: dict[str, float]) -> Scene:
    """Leave out pairs that touch in the start pose; relax those that are near there."""
    if not scene.pairs:
        return scene
    q = [[pose[name] for name in scene.robot.joint_names]]
    pairs, notes = [], list(scene.notes)
    for pair, distance in zip(scene.pairs, nearest(scene, q).distance[0], strict=True):
        names = scene.names(pair)
        if distance <= 0.0:
            notes.append(PairNote(*names, False, "they touch in the start pose"))
            continue
        if distance < pair.wanted:
            seen = f"{distance * 1e3:.1f} mm apart in the start pose"
            notes.append(PairNote(*names, True, f"{seen}; so only contact is excluded"))
            pair = replace(pair, wanted=0.0)
        pairs.append(pair)
    return replace(scene, pairs=tuple(pairs), notes=tuple(notes))


_TABLE = "[excitation]"

_HARMONICS = 5  # of base frequencies that are requested without a number


@dataclass(frozen=True, slots=True, eq=False)
class DesignRequest:
    """Forms, aim, limits and scene of a path, and options for playing it.

    Parameters
    ----------
    forms : tuple of PathForm
        Forms to choose from: one, if the number of harmonics is requested.
    aim : Aim
    limits : MotionLimits
    scene : Scene, optional
    start_pose : dict from joint to position, optional
        Where the robot rests before and after, all joints of it.
    periods : int, optional
        How often a periodic path is repeated; None to play its duration once.
    notes : tuple of str
        Notes on the default scene.
    friction_share : float
        Share of the effort limits that is left for unknown friction.
    stated : FileParts
        What the robot's file says of its torque, beside the bodies of the model.
    """

    forms: tuple[PathForm, ...]
    aim: Aim
    limits: MotionLimits
    scene: Scene | None
    start_pose: dict[str, float] | None
    periods: int | None
    notes: tuple[str, ...] = ()
    friction_share: float = FRICTION_SHARE
    stated: FileParts = FileParts()  # noqa: RUF009  frozen

    @property
    def form(self) -> PathForm:
        """The first of the forms."""
        return self.forms[0]


def design_request(problem: Problem) -> DesignRequest:
    """Return the design that the ``[excitation]`` table of a problem requests.

    Raises
    ------
    ProblemError
        If a joint is unknown, its limits leave no motion, the scene contradicts itself,
        a path is to be repeated that rests or is no whole period, or the start pose is
        outside the limits or has bodies too near to one another.
    """
    table = problem.table.excitation
    if table.rest and table.periods != 1:
        raise ProblemError(
            f"{_TABLE} periods is {table.periods}, but a path that rests at its ends "
            f"is not repeated; give rest = false, or leave periods out and play it "
            f"several times"
        )
    limits = _limits(table.limits, problem.moving)
    forms = _forms(table, limits)
    refine: Objective | Literal["default"] | None = "default"
    if table.refine is not None:
        refine = None if table.refine == "none" else table.refine
    aim = Aim(
        objective=table.objective,
        refine=refine,
        growth=table.growth,
        condition_at_most=table.condition_at_most,
        scaling=table.scaling,
        noise=table.noise,
        rate=table.rate,
        correlation_time=table.correlation_time,
        interest=_interest(problem, refine),
        others=table.others,
    )
    pose = _pose(table.start_pose, limits) if table.start_pose else None
    scene = requested_scene(problem)
    stated = FileParts(
        drawn_drives(problem),
        links_behind_tip(problem),
        massless_links(problem),
        unused_limits(problem),
    )
    notes: tuple[str, ...] = ()
    if table.scene is None:
        scene, notes = default_scene(problem, pose)
    elif scene is not None and pose is not None:
        _require_clear(scene, pose)
    periods = None if table.periods == 1 else table.periods
    if periods is not None:
        for form in forms:
            _require_whole_period(form, periods)
    left = table.limits.friction_share
    left = FRICTION_SHARE if left is None else left
    return DesignRequest(forms, aim, limits, scene, pose, periods, notes, left, stated)


def _interest(
    problem: Problem, refine: Objective | Literal["default"] | None
) -> tuple[str, ...]:
    """Return the parameters of interest: for a wrench sensor those of the tool."""
    table, robot = problem.table.excitation, problem.model.robot
    if table.interest or problem.arm is None:
        return interest_names(robot, table.interest)
    no_errors = table.objective == "condition" and refine is None
    return () if no_errors else robot.link_names


def _forms(table: ExcitationTable, limits: MotionLimits) -> tuple[PathForm, ...]:
    """Return the form that is requested, or those to try."""
    bases = table.base_frequencies
    if table.harmonics is None and bases is None:
        return forms_to_try(
            limits, table.duration, rest=table.rest, smooth=table.smooth
        )
    return (
        PathForm(
            table.duration,
            _HARMONICS if table.harmonics is None else table.harmonics,
            None if bases is None else tuple(bases),
            table.rest,
            smooth=table.smooth,
        ),
    )


def _limits(given: LimitsTable, robot: RobotModel) -> MotionLimits:
    try:
        limits = motion_limits(
            robot,
            position={
                name: (low, high) for name, (low, high) in given.position.items()
            },
            velocity=given.velocity,
            acceleration=given.acceleration,
            jerk=given.jerk,
            effort=given.effort,
            effort_rate=given.effort_rate,
            effort_rms=given.effort_rms,
        )
        limits = limits.with_currents(given.current, given.torque_constant)
    except ProblemError as cause:
        raise ProblemError(
            f"[excitation.limits] {cause}. Its keys: position = {{ "
            f"{robot.joint_names[0]} = [-1.0, 1.0] }}, velocity = 1.0, acceleration = "
            "5.0, jerk, effort, effort_rate, effort_rms, one for all joints or by "
            "name; init ROBOT writes a problem file for them. In the shell --velocity, "
            "--acceleration; --lock JOINT ... for joints that stand still"
        ) from None
    return limits.within(given.share)


def _pose(given: dict[str, float], limits: MotionLimits) -> dict[str, float]:
    """Return the pose of all joints: those that are not given in their middle."""
    for joint, value in given.items():
        if joint not in limits.joints:
            near = did_you_mean(joint, limits.joints)
            raise ProblemError(f"{_TABLE} start_pose: no joint {joint!r}; {near}")
        j = limits.joints.index(joint)
        if not limits.lower[j] <= value <= limits.upper[j]:
            raise ProblemError(
                f"{_TABLE} start_pose: {joint} = {value:g}, expected between "
                f"{limits.lower[j]:.6g} and {limits.upper[j]:.6g}, its range (times "
                "the share that is used)"
            )
    return dict(zip(limits.joints, limits.middle.tolist(), strict=True)) | given


def _require_whole_period(form: PathForm, periods: int) -> None:
    """Refuse to repeat a path whose duration is not a whole period."""
    still = np.zeros((len(form.frequencies), 1))
    path = FourierTrajectory(
        ("any",), form.frequencies, np.zeros(1), still, still, form.duration
    )
    if path.period is None or not np.isclose(path.period, form.duration):
        raise ProblemError(
            f"{_TABLE} periods = {periods}: the path repeats after {path.period} s, "
            f"not after its duration of {form.duration:g} s; play it once, or leave "
            "out base_frequencies"
        )


def _require_clear(scene: Scene, pose: dict[str, float]) -> None:
    if not scene.pairs:
        return
    found = nearest(scene, [[pose[name] for name in scene.robot.joint_names]])
    k = int(found.slack[0].argmin())
    if found.slack[0, k] < 0.0:
        first, second = scene.names(scene.pairs[k])
        raise ProblemError(
            f"{_TABLE} start_pose: bodies {first!r} and {second!r} are "
            f"{found.distance[0, k] * 1e3:.1f} mm apart (negative: penetration), at "
            f"least {scene.pairs[k].wanted * 1e3:.1f} mm are required; give another "
            f"pose"
        )
