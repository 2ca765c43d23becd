"""An MJCF file of one's own, whose bodies become the identified ones."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from consistent_id.errors import ModelError
from consistent_id.estimation.estimate import Estimate
from consistent_id.export.inertia_split import Part, split_inertia
from consistent_id.export.mjcf_body import require_mujoco, set_body
from consistent_id.export.mjcf_tree import SpecTree
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders import mjcf_assets
from consistent_id.robot.loaders.mjcf import compiled_body
from consistent_id.robot.model import FixedFrame, RobotModel


class Source(NamedTuple):
    """A file's specification, its bodies and joints, and its compiled model."""

    spec: Any
    tree: SpecTree
    model: Any
    file: str

    def body(self, name: str) -> InertialParameters:
        """Return a body's parameters in its own frame."""
        return compiled_body(self.model, self.tree.places[name])


def read_spec(path: Path) -> tuple[Any, Any]:
    """Return a file's specification, and its compiled model."""
    mujoco = require_mujoco()
    spec = mjcf_assets.read_spec(path, mujoco)
    try:
        return spec, spec.compile()
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(f"{path}: MuJoCo refuses it: {cause}") from None


def put_into(source: Source, estimate: Estimate) -> list[str]:
    """Put the estimate's bodies into a file's; return notes."""
    mujoco = require_mujoco()
    robot, spec, tree = estimate.model.robot, source.spec, source.tree
    from_geoms = mujoco.mjtInertiaFromGeom
    if spec.compiler.inertiafromgeom == from_geoms.mjINERTIAFROMGEOM_TRUE:
        for name, body in list(tree.bodies.items())[1:]:
            set_body(body, source.body(name), moves=False)
        spec.compiler.inertiafromgeom = from_geoms.mjINERTIAFROMGEOM_AUTO
    if not np.array_equal(spec.option.gravity, robot.gravity):
        spec.option.gravity = robot.gravity
    notes: list[str] = []
    for k, vector in enumerate(estimate.links):
        link, joint = robot.links[k].name, robot.joints[k].name
        whole = InertialParameters(vector)
        if link not in tree.bodies and not whole.vector.any():
            continue  # between two joints of one body nothing stands
        free = robot.joints[k].kind == "free"  # a body of the world, held or not
        if link not in tree.bodies or (not free and tree.carried.get(joint) != link):
            raise ModelError(
                f"{source.file}: no body {link!r} that joint {joint!r} alone moves. "
                "Give the file that the model was loaded from; if that body has "
                "several joints, export without source"
            )
        notes += _set_link(source, robot, k, whole)
    return notes


def _set_link(
    source: Source, robot: RobotModel, k: int, whole: InertialParameters
) -> list[str]:
    link = robot.links[k]
    own = FixedFrame(link.name, np.eye(3), np.zeros(3))
    parts = [
        _part(source, frame)
        for frame in (own, *link.merged)
        if frame.name in source.tree.bodies  # not so between joints of one body
    ]
    split = split_inertia(whole, parts)
    bodies = source.tree.bodies
    notes = set_body(bodies[link.name], split.bodies[0])
    for part, share in zip(parts[1:], split.bodies[1:], strict=True):
        if share is not part.body:
            set_body(bodies[part.name], share, moves=False)
    return [split.note, *notes] if split.note else notes


def _part(source: Source, frame: FixedFrame) -> Part:
    """Return a body where a link's frame is: its origin lies on the joint's axis."""
    hinge = require_mujoco().mjtJoint.mjJNT_HINGE
    anchor = np.zeros(3)
    for name, body in source.tree.carried.items():
        joint = source.tree.joints[name]
        if body == frame.name and joint.type == hinge:
            anchor = np.array(joint.pos)
    origin = frame.translation - frame.rotation @ anchor
    return Part(frame.name, source.body(frame.name), frame.rotation, origin)
