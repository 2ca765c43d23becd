"""The scene that a problem file requests, or the robot's own shapes if it has none."""

from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import ConsistentIdError, ProblemError
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
from consistent_id.problems.excitation_tables import (
    BodyTable,
    BoxTable,
    ConeTable,
    RodTable,
    SceneTable,
    SphereTable,
    WorkspaceTable,
)
from consistent_id.problems.problem import Problem
from consistent_id.robot.loaders.urdf_inertial import rotation_of

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
        scene = scene_from_urdf(file, problem.moving)
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


def _of_urdf(problem: Problem, table: SceneTable, bodies: list[Body]) -> Scene:
    if problem.table.model.urdf is None:
        raise ProblemError(
            'robot = "urdf", but [model] has no urdf; write robot = "bodies", and give '
            "the robot's in [[excitation.scene.bodies]], each with its link"
        )
    return scene_from_urdf(
        problem.file(problem.table.model.urdf),
        problem.moving,
        package_dirs=[problem.file(folder) for folder in table.packages],
        elements=table.elements,
        pieces=table.pieces,
        ground=table.ground,
        added=bodies,
        clearance=table.clearance,
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
        clearance=table.clearance,
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
    """Leave out pairs that touch in the start pose."""
    if not scene.pairs:
        return scene
    q = [[pose[name] for name in scene.robot.joint_names]]
    touching = nearest(scene, q).distance[0] <= 0.0
    notes = [
        PairNote(*scene.names(pair), False, "they touch in the start pose")
        for pair, touches in zip(scene.pairs, touching, strict=True)
        if touches
    ]
    pairs = [p for p, touches in zip(scene.pairs, touching, strict=True) if not touches]
    return replace(scene, pairs=tuple(pairs), notes=(*scene.notes, *notes))
