"""The robot's own shapes as a scene, where nothing is said of what must not touch."""

from dataclasses import replace

from consistent_id.errors import ConsistentIdError
from consistent_id.motion.collisions.scene import PairNote, Scene
from consistent_id.motion.collisions.scene_file import scene_from_urdf
from consistent_id.motion.collisions.separation import nearest
from consistent_id.motion.collisions.urdf_bodies import has_collision_shapes
from consistent_id.problems.problem import Problem

_NONE = "no scene"


def default_scene(
    problem: Problem, pose: dict[str, float] | None
) -> tuple[Scene | None, tuple[str, ...]]:
    """Return the collision shapes of a problem's URDF as a scene, and notes on it.

    A shape that cannot be read is no error, since nobody has asked for it: there is no
    scene then, and the note says why.

    Parameters
    ----------
    problem : Problem
        Without ``[excitation.scene]``.
    pose : dict from joint to position, optional
        In which the robot stands: shapes that touch there are too large, and not
        watched.
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
        "the robot keeps off itself, by the shapes of its URDF; of what stands around "
        "it nothing is known: --ground, [excitation.scene]; --no-collisions"
    )
    return (scene if pose is None else _apart_at(scene, pose)), (around,)


def _apart_at(scene: Scene, pose: dict[str, float]) -> Scene:
    """Leave out pairs that touch where the robot stands."""
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
