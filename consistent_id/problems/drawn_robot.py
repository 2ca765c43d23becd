"""Shapes of links and nominal drives, read from the file that a problem names."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from consistent_id.errors import ConsistentIdError, ModelError
from consistent_id.problems.problem import Problem
from consistent_id.robot.drawn_parts import DrawnDrive, DrawnParts
from consistent_id.robot.loaders.xml import Element
from consistent_id.robot.model import RobotModel

if TYPE_CHECKING:
    from consistent_id.motion.collisions.bodies import Body


def drawn_parts(problem: Problem) -> DrawnParts:
    """Return what the robot's file draws; only the fault where it cannot be read.

    It is evidence beside the robot, which needs neither shapes nor nominal drives.
    """
    model, scene = problem.table.model, problem.table.excitation.scene
    packages = [] if scene is None else [problem.file(p) for p in scene.packages]
    try:
        if model.urdf is not None:
            return _of_urdf(problem.file(model.urdf), problem.model.robot, packages)
        if model.mjcf is not None:
            return _of_mjcf(problem.file(model.mjcf), problem.model.robot)
    except ConsistentIdError as cause:
        return DrawnParts(fault=str(cause))
    return DrawnParts()


def _of_urdf(file: Path, robot: RobotModel, packages: list[Path]) -> DrawnParts:
    from consistent_id.motion.collisions.urdf_bodies import urdf_shapes

    shapes = urdf_shapes(file, packages)
    unread = {link.name for link in shapes.unread} | {name for name, _ in shapes.bare}
    drives = {}
    for joint in shapes.root.all("joint"):
        stated = joint.child("dynamics")
        if stated is not None:
            drives[joint.name] = DrawnDrive(
                _number(stated, "damping"), _number(stated, "friction")
            )
    return DrawnParts(dict(_reaches(robot, shapes.bodies, unread)), drives)


def _number(element: Element, name: str) -> float:
    """Return a value that is not negative; zero, which is none, if it is no number."""
    try:
        value = float(element.attributes.get(name, "0"))
    except ValueError:
        return 0.0
    return value if 0.0 <= value < np.inf else 0.0


def _reaches(
    robot: RobotModel, bodies: "tuple[Body, ...]", unread: set[str]
) -> Iterator[tuple[str, float]]:
    """Yield links and their farthest points, those of merged links included."""
    for link in robot.links:
        places = {link.name: (np.eye(3), np.zeros(3))}
        places |= {f.name: (f.rotation, f.translation) for f in link.merged}
        if unread & set(places):
            continue
        reach = [
            float(np.linalg.norm(R @ _middle(body) + t)) + body.shape.ball[1]
            for body in bodies
            if body.frame in places
            for R, t in (places[body.frame],)
        ]
        if reach and np.isfinite(max(reach)):
            yield link.name, max(reach)


def _middle(body: "Body") -> Any:
    turn = np.eye(3) if body.rotation is None else np.asarray(body.rotation)
    origin = np.zeros(3) if body.translation is None else np.asarray(body.translation)
    return turn @ np.asarray(body.shape.ball[0]) + origin


def _of_mjcf(file: Path, robot: RobotModel) -> DrawnParts:
    """Return shapes of bodies that merge no others, and the joints' drives.

    Shapes that do not contain the body's own mass are not those of the whole body.
    """
    from consistent_id.export.mjcf_bodies import require_mujoco
    from consistent_id.robot.loaders.mjcf_spec import stand_in

    mujoco = require_mujoco()
    try:
        spec = mujoco.MjSpec.from_file(str(file))
        unseen = set(stand_in(spec, file, mujoco))
        compiled = spec.compile()
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(f"{file}: MuJoCo refuses it: {cause}") from None
    blind = {
        body.name
        for body in spec.bodies
        if any(geom.meshname in unseen for geom in body.geoms)
    }
    drives, reach = {}, {}
    joints = {compiled.joint(j).name: j for j in range(compiled.njnt)}
    for joint in robot.joint_names:
        if joint not in joints:
            continue
        k = int(compiled.jnt_dofadr[joints[joint]])
        drives[joint] = DrawnDrive(
            float(compiled.dof_damping[k]),
            float(compiled.dof_frictionloss[k]),
            float(compiled.dof_armature[k]),
        )
    names = {compiled.body(b).name: b for b in range(compiled.nbody)}
    for link in robot.links:
        if link.merged or link.name in blind or link.name not in names:
            continue
        b = names[link.name]
        first = int(compiled.body_jntadr[b])
        origin = compiled.jnt_pos[first] if first >= 0 else np.zeros(3)
        far = [
            float(np.linalg.norm(compiled.geom_pos[g] - origin))
            + float(compiled.geom_rbound[g])
            for g in range(compiled.ngeom)
            if compiled.geom_bodyid[g] == b
        ]
        mass, extent = float(compiled.body_mass[b]), 0.0
        if mass > 0.0:
            spread = float(compiled.body_inertia[b].sum()) / (2.0 * mass)
            centre = float(np.linalg.norm(compiled.body_ipos[b] - origin))
            extent = centre + np.sqrt(spread)
        if far and extent <= max(far) < np.inf:
            reach[link.name] = max(far)
    return DrawnParts(reach, drives)
