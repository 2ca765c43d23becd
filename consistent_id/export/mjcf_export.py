"""An identified robot for MuJoCo: built anew, or put into its own MJCF file."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from consistent_id.errors import ModelError
from consistent_id.estimation.estimate import Estimate
from consistent_id.export.drive_values import (
    JointDrive,
    follower_drives,
    in_leader,
    joint_drives,
    not_expressed,
)
from consistent_id.export.export_formats import Export, exporter, provenance
from consistent_id.export.mjcf_bodies import (
    MjcfSource,
    put_into,
    quaternion,
    read_spec,
    require_mujoco,
    set_body,
    spec_tree,
)
from consistent_id.export.mjcf_in_place import put_in_place
from consistent_id.export.mjcf_tendons import add_gears, add_slopes, set_number
from consistent_id.export.mjcf_text import exact_xml
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.model import Joint, Mimic

WEAK = 1e-4  # stiffness over offset, [1/rad] or [1/m], of a spring that is a preload
_EXPRESSED = ("damping", "friction", "armature", "stiffness")
_DRIVE = ("damping", "frictionloss", "armature", "stiffness")


class Specified(NamedTuple):
    """A ``mujoco.MjSpec``, and what it cannot say of the estimate."""

    spec: Any
    notes: tuple[str, ...]


def to_mjcf(
    estimate: Estimate,
    source: str | Path | None = None,
    *,
    folder: str | Path | None = None,
    copy_files: bool = False,
    allow_refused: bool = False,
) -> Export:
    """Return MJCF with explicit inertials, armature, damping, friction loss, springs.

    Parameters
    ----------
    estimate : Estimate
    source : str or Path, optional
        The MJCF file that the model was loaded from; all else in it keeps its bytes.
        Only a file that includes or repeats parts is written anew, by MuJoCo.  Without
        a source the robot is built anew: bodies, joints and limits, links fixed to them
        as sites, no shapes.
    folder : str or Path, optional
        Where the file will be written, from where the source's meshes and textures are
        to be found; the source's own by default.
    copy_files : bool
        Whether meshes and textures are to be copied there, too.
    allow_refused : bool
        Export what is refused, too; MuJoCo will not take all of it.

    Raises
    ------
    ModelError
        If MuJoCo is not installed or refuses the result, or `source` is not the
        model's.
    ProblemError
        If the estimate is refused.
    """
    mujoco = require_mujoco()
    spec, notes = mujoco_spec(estimate, source, allow_refused=allow_refused)
    line = provenance(estimate)
    try:
        if source is not None:
            place = None if folder is None else Path(folder)
            done = put_in_place(spec, Path(source), line, place, copy_files)
            return Export("mjcf", done.content, (*notes, *done.notes), done.files)
        text = exact_xml(spec)
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(f"MuJoCo refuses the estimate: {cause}") from None
    comment = line.replace("--", "- -").encode("ascii", "replace")
    return Export("mjcf", b"<!-- " + comment + b" -->\n" + text, notes)


@exporter("mjcf")
def mujoco_spec(
    estimate: Estimate,
    source: str | Path | None = None,
    *,
    allow_refused: bool = False,
) -> Specified:
    """Return the ``mujoco.MjSpec`` that `to_mjcf` writes, not compiled yet.

    Parameters
    ----------
    estimate : Estimate
    source : str or Path, optional
        See `to_mjcf`.
    allow_refused : bool
        Export what is refused, too.
    """
    mujoco = require_mujoco()
    if source is None:
        spec, more = _built(estimate, mujoco)
        tree = spec_tree(spec)
    else:
        spec, model = read_spec(Path(source))
        tree = spec_tree(spec)
        more = put_into(MjcfSource(spec, tree, model, Path(source).name), estimate)
    for drive in joint_drives(estimate):
        if drive.terms.names:
            _set_drive(spec, tree.joints[drive.joint], drive)
    for drive in follower_drives(estimate):
        joint = tree.joints[drive.joint]
        more += [in_leader(drive.joint)] if _resists(joint) else []
        _set_drive(spec, joint, drive)
    exempt = _preloads(estimate) | add_gears(spec, tree.joints, estimate)
    sloped, of_slopes = add_slopes(spec, tree.joints, estimate)
    exempt |= sloped
    more = [*more, *of_slopes]
    notes = not_expressed(estimate, "MuJoCo", _EXPRESSED, exempt)
    return Specified(spec, (*notes, *_weak_springs(estimate), *more))


def _preloads(estimate: Estimate) -> set[tuple[str, str]]:
    """Return offsets, which are those of springs: ``spring (q - springref)``."""
    return {(drive.joint, "offset") for drive in joint_drives(estimate)}


def _weak_springs(estimate: Estimate) -> list[str]:
    """Say which offsets are springs that were not identified."""
    weak = [
        drive.joint
        for drive in joint_drives(estimate)
        if drive.values.get("offset") and not drive.simulated("stiffness")
    ]
    if not weak:
        return []
    return [
        f"MuJoCo has no torque offset; those of {', '.join(weak)} are weak springs "
        f"with preload, off by {100 * WEAK:g} % of the offset per rad or m"
    ]


def _built(estimate: Estimate, mujoco: Any) -> tuple[Any, list[str]]:
    robot = estimate.model.robot
    spec = mujoco.MjSpec()
    spec.modelname = robot.name
    spec.compiler.degree = False
    spec.option.gravity = robot.gravity
    notes: list[str] = []
    bodies: list[Any] = []
    for joint, link, vector in zip(
        robot.joints, robot.links, estimate.links, strict=True
    ):
        parent = spec.worldbody if joint.parent < 0 else bodies[joint.parent]
        body = parent.add_body(
            name=link.name,
            pos=joint.translation,
            quat=quaternion(joint.rotation),
        )
        _add_joint(body, joint, mujoco)
        notes += set_body(body, InertialParameters(vector))
        for frame in link.merged:
            where = {"pos": frame.translation, "quat": quaternion(frame.rotation)}
            body.add_site(name=frame.name, **where)
        bodies.append(body)
    for joint in robot.joints:
        if joint.mimic is not None:
            _add_follower(spec, joint.name, joint.mimic, mujoco)
    return spec, notes


def _add_follower(spec: Any, name: str, mimic: Mimic, mujoco: Any) -> None:
    made = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=name)
    made.objtype, made.name2 = mujoco.mjtObj.mjOBJ_JOINT, mimic.joint
    made.data[:2] = mimic.offset, mimic.multiplier
    made.data[2:5] = 0.0


def _add_joint(body: Any, joint: Joint, mujoco: Any) -> None:
    if joint.kind == "free":
        body.add_joint(name=joint.name, type=mujoco.mjtJoint.mjJNT_FREE)
        return
    slides = joint.kind == "prismatic"
    kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
    made = body.add_joint(name=joint.name, type=kind, axis=joint.axis)
    limits = joint.limits
    if joint.kind != "continuous" and np.isfinite([limits.lower, limits.upper]).all():
        made.range = [limits.lower, limits.upper]
    if np.isfinite(limits.effort) and limits.effort > 0.0:
        made.actfrcrange = [-limits.effort, limits.effort]


def _resists(joint: Any) -> bool:
    """Return whether a joint states friction, armature or a spring."""
    return any(np.any(getattr(joint, name)) for name in _DRIVE)


def _set_drive(spec: Any, joint: Any, drive: JointDrive) -> None:
    """Set damping, Coulomb friction, armature and spring of a joint."""
    turns = joint.type == require_mujoco().mjtJoint.mjJNT_HINGE
    angle = 180.0 / np.pi if turns and spec.compiler.degree else 1.0
    offset = drive.values.get("offset", 0.0)
    spring = drive.simulated("stiffness") or WEAK * abs(offset)
    set_number(joint, "damping", drive.simulated("damping") or 0.0)
    set_number(joint, "frictionloss", drive.simulated("friction") or 0.0)
    set_number(joint, "armature", drive.simulated("armature") or 0.0)
    set_number(joint, "stiffness", spring)
    if spring:
        joint.springref = -angle * offset / spring
