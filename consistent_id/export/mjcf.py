"""An identified robot for MuJoCo: built anew, or put into its own MJCF file."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from consistent_id.errors import ModelError
from consistent_id.estimate import Estimate
from consistent_id.export._mjcf_body import principal_body, quaternion
from consistent_id.export._mjcf_text import exact_xml
from consistent_id.export.drive_values import JointDrive, joint_drives, not_expressed
from consistent_id.export.exported import Export
from consistent_id.export.pedigree import pedigree, require_usable
from consistent_id.export.shares import Part, shared
from consistent_id.inertia import InertialParameters
from consistent_id.model import Joint, RobotModel

_EXPRESSED = (
    "viscous",
    "coulomb",
    "coulomb_positive",
    "coulomb_negative",
    "rotor_inertia",
    "spring",
)


class Specified(NamedTuple):
    """A ``mujoco.MjSpec``, and what it cannot say of the estimate."""

    spec: Any
    notes: tuple[str, ...]


def to_mjcf(
    estimate: Estimate,
    source: str | Path | None = None,
    *,
    allow_refused: bool = False,
) -> Export:
    """Return MJCF with explicit inertials, armature, damping, friction loss, springs.

    Parameters
    ----------
    estimate : Estimate
    source : str or Path, optional
        The MJCF file that the model was loaded from; all else in it is kept, as MuJoCo
        writes it.  Without it the robot is built anew: bodies, joints and limits, links
        fixed to them as sites, no shapes.
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
    mujoco = _mujoco()
    spec, notes = mujoco_spec(estimate, source, allow_refused=allow_refused)
    try:
        text = exact_xml(spec)
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(f"MuJoCo refuses the estimate: {cause}") from None
    comment = pedigree(estimate).replace("--", "- -").encode("ascii", "replace")
    return Export("mjcf", b"<!-- " + comment + b" -->\n" + text, notes)


def mujoco_spec(
    estimate: Estimate,
    source: str | Path | None = None,
    *,
    allow_refused: bool = False,
) -> Specified:
    """Return the ``mujoco.MjSpec`` that `to_mjcf` writes, not compiled yet."""
    require_usable(estimate, allow_refused)
    mujoco = _mujoco()
    notes = not_expressed(estimate, "MuJoCo", _EXPRESSED, _preloads(estimate))
    if source is None:
        spec, more = _built(estimate, mujoco)
    else:
        spec, more = _edited(estimate, Path(source), mujoco)
    for drive in joint_drives(estimate):
        if drive.terms.names:
            _set_drive(spec, spec.joint(drive.joint), drive)
    return Specified(spec, (*notes, *more))


def _mujoco() -> Any:
    try:
        import mujoco
    except ImportError:
        raise ModelError(
            "MJCF needs MuJoCo; install it with: pip install 'consistent-id[mjcf]'"
        ) from None
    return mujoco


def _preloads(estimate: Estimate) -> set[tuple[str, str]]:
    """Return offsets that are those of springs: ``spring (q - springref)``."""
    drives = joint_drives(estimate)
    return {(d.joint, "offset") for d in drives if d.values.get("spring")}


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
        notes += _set_body(body, InertialParameters(vector))
        for frame in link.merged:
            where = {"pos": frame.translation, "quat": quaternion(frame.rotation)}
            body.add_site(name=frame.name, **where)
        bodies.append(body)
    return spec, notes


def _add_joint(body: Any, joint: Joint, mujoco: Any) -> None:
    slides = joint.kind == "prismatic"
    kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
    made = body.add_joint(name=joint.name, type=kind, axis=joint.axis)
    limits = joint.limits
    if joint.kind != "continuous" and np.isfinite([limits.lower, limits.upper]).all():
        made.range = [limits.lower, limits.upper]
    if np.isfinite(limits.effort) and limits.effort > 0.0:
        made.actfrcrange = [-limits.effort, limits.effort]


def _edited(estimate: Estimate, path: Path, mujoco: Any) -> tuple[Any, list[str]]:
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(f"{path}: MuJoCo refuses it: {cause}") from None
    _name(spec)
    robot = estimate.model.robot
    always = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    if spec.compiler.inertiafromgeom == always:
        for body in spec.bodies[1:]:
            _set_body(body, _compiled_body(model, body.id), moves=False)
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    if not np.array_equal(spec.option.gravity, robot.gravity):
        spec.option.gravity = robot.gravity
    notes = [f"meshes and textures are looked for as from {path.name}'s own folder"]
    for k, vector in enumerate(estimate.links):
        notes += _set_link(spec, model, robot, k, InertialParameters(vector), path)
    return spec, notes


def _name(spec: Any) -> None:
    """Name what has no name, as `load_mjcf` does."""
    for kind, items in (("body", spec.bodies), ("joint", spec.joints)):
        for item in items:
            item.name = item.name or f"{kind}{item.id}"


def _set_link(
    spec: Any,
    model: Any,
    robot: RobotModel,
    k: int,
    whole: InertialParameters,
    path: Path,
) -> list[str]:
    link, joint = robot.links[k], spec.joint(robot.joints[k].name)
    body = spec.body(link.name)
    if body is None and not whole.vector.any():
        return []  # between two joints of one body nothing stands
    if joint is None or body is None or spec.joint(joint.name).parent.name != body.name:
        raise ModelError(
            f"{path}: no body {link.name!r} that joint {robot.joints[k].name!r} alone "
            "moves. Give the file that the model was loaded from; if that body has "
            "several joints, export without source"
        )
    # The link's origin lies on the joint's axis.
    slides = robot.joints[k].kind == "prismatic"
    anchor = np.zeros(3) if slides else np.asarray(joint.pos)
    parts = [Part(link.name, _compiled_body(model, body.id), np.eye(3), -anchor)]
    for frame in link.merged:
        merged = spec.body(frame.name)
        if merged is None:
            continue  # a part of a body with several joints
        stated = _compiled_body(model, merged.id)
        parts.append(Part(frame.name, stated, frame.rotation, frame.translation))
    shares = shared(whole, parts)
    notes = [shares.note] if shares.note else []
    notes += _set_body(body, shares.bodies[0])
    for part, share in zip(parts[1:], shares.bodies[1:], strict=True):
        _set_body(spec.body(part.name), share, moves=False)
    return notes


def _compiled_body(model: Any, b: int) -> InertialParameters:
    turn = np.zeros(9)
    _mujoco().mju_quat2Mat(turn, model.body_iquat[b])
    axes = turn.reshape(3, 3)
    inertia = axes @ np.diag(model.body_inertia[b]) @ axes.T
    mass = float(model.body_mass[b])
    return InertialParameters.from_central(mass, model.body_ipos[b], inertia)


def _set_body(body: Any, what: InertialParameters, *, moves: bool = True) -> list[str]:
    """Give a body an explicit inertial; say so if it had to be thickened."""
    found = principal_body(what, moves)
    body.explicitinertial = True
    body.mass, body.ipos, body.inertia = found.mass, found.com, found.moments
    body.iquat = found.quaternion
    body.fullinertia = [np.nan, *np.zeros(5)]
    if found.raised == 0.0 and found.mass == what.mass:
        return []
    return [
        f"{body.name} is thinner than MuJoCo takes: second moments raised by up to "
        f"{found.raised:.1g} kg m^2, mass {found.mass - what.mass:.1g} kg"
    ]


def _set_drive(spec: Any, joint: Any, drive: JointDrive) -> None:
    """Set damping, Coulomb friction, armature and spring of a joint."""
    turns = joint.type == _mujoco().mjtJoint.mjJNT_HINGE
    angle = 180.0 / np.pi if turns and spec.compiler.degree else 1.0
    spring = drive.values.get("spring", 0.0)
    _set(joint, "damping", drive.values.get("viscous", 0.0))
    _set(joint, "frictionloss", drive.friction_level or 0.0)
    _set(joint, "armature", drive.values.get("rotor_inertia", 0.0))
    _set(joint, "stiffness", spring)
    if spring:
        joint.springref = -angle * drive.values.get("offset", 0.0) / spring


def _set(joint: Any, name: str, value: float) -> None:
    """Set a number that newer versions of MuJoCo have as a polynomial's first."""
    terms = np.atleast_1d(getattr(joint, name))
    whole = [value, *np.zeros(len(terms) - 1)]
    setattr(joint, name, whole if np.ndim(getattr(joint, name)) else value)
