"""Bodies of a MuJoCo specification: found by name, and given identified inertias."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.extras import needed
from consistent_id.errors import ModelError
from consistent_id.estimation.estimate import Estimate
from consistent_id.export.file_values import FileLink, central, split_inertia
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders import mjcf_spec
from consistent_id.robot.loaders.mjcf import compiled_body
from consistent_id.robot.model import FixedFrame, RobotModel

# MuJoCo requires a mass above 1e-15 kg, moments above 1e-14 kg m^2, and A + B >= C for
# the numbers in the file.
_MASS = 1e-12
_MOMENT = 2e-14
_ROUNDING = 1e-14  # of the sum of second moments


@dataclass(frozen=True, slots=True, eq=False)
class PrincipalBody:
    """Mass, centre of mass, principal moments and their axes as a quaternion.

    `raised` is by how much second moments were raised to be consistent, [kg m^2].
    """

    mass: float
    com: Vector
    moments: Vector
    quaternion: Vector
    raised: float


def principal_body(body: InertialParameters, moves: bool = True) -> PrincipalBody:
    """Return a body in its principal axes, no thinner than MuJoCo needs if it moves."""
    return _principal_body(body.vector.tobytes(), moves)


@lru_cache(maxsize=256)  # bodies that are known are the same in all models of a search
def _principal_body(vector: bytes, moves: bool) -> PrincipalBody:
    body = InertialParameters(np.frombuffer(vector))
    mass, com, inertia = central(body)
    moments, axes = np.linalg.eigh(inertia)
    if np.linalg.det(axes) < 0.0:
        axes = -axes
    second = moments.sum() / 2 - moments
    raised = 0.0
    if moves:
        least = max(_MOMENT, _ROUNDING * float(second.sum()))
        thick = np.maximum(second, least)
        raised = float((thick - second).max())
        moments = thick.sum() - thick if raised > 0.0 else moments
        mass = max(mass, _MASS)
    return PrincipalBody(mass, com, moments, quaternion(axes), raised)


def quaternion(rotation: Matrix) -> Array:
    """Return the unit quaternion (w, x, y, z) of a rotation.

    The eigenvector of the largest eigenvalue of a symmetric matrix, which loses no
    digits at any angle.
    """
    return _quaternion(np.asarray(rotation, dtype=np.float64).tobytes())


@lru_cache(maxsize=256)
def _quaternion(rotation: bytes) -> Array:
    entries = np.frombuffer(rotation).reshape(3, 3)
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = entries
    K = np.array(
        [
            [xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, yy - xx - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, zz - xx - yy],
        ]
    )
    _, vectors = np.linalg.eigh(K)
    q = vectors[:, -1]
    q = np.array(q if q[np.argmax(abs(q))] > 0.0 else -q)
    q.setflags(write=False)
    return q


def require_mujoco() -> Any:
    """Return the package, or say how to install it."""
    return needed("mujoco", "mjcf", "writing MJCF", ModelError)


def set_body(body: Any, what: InertialParameters, *, moves: bool = True) -> list[str]:
    """Give a body an explicit inertial; return a note if it had to be thickened."""
    found = principal_body(what, moves)
    body.explicitinertial = True
    body.mass, body.ipos, body.inertia = found.mass, found.com, found.moments
    body.iquat = found.quaternion
    body.fullinertia = [np.nan, *np.zeros(5)]
    # Stated angles would go before the quaternion.
    body.ialt.type = require_mujoco().mjtOrientation.mjORIENTATION_QUAT
    if found.raised == 0.0 and found.mass == what.mass:
        return []
    return [
        f"{body.name} is thinner than MuJoCo accepts: second moments raised by up to "
        f"{found.raised:.1g} kg m^2, mass {found.mass - what.mass:.1g} kg"
    ]


@dataclass(frozen=True, slots=True, eq=False)
class SpecTree:
    """Bodies and joints of a specification, by the names that `load_mjcf` gives them.

    `places` are the bodies' numbers in the compiled model, `carried` the names of the
    bodies that joints move.
    """

    bodies: dict[str, Any]
    places: dict[str, int]
    joints: dict[str, Any]
    carried: dict[str, str]


def spec_tree(spec: Any) -> SpecTree:
    """Return the tree of a specification; elements without a name get their number."""
    tree = SpecTree({}, {}, {}, {})
    for place, body in enumerate(_below(spec.worldbody)):
        body.name = body.name or f"body{place}"
        tree.bodies[body.name], tree.places[body.name] = body, place
        joint = body.first_joint()
        while joint is not None:
            joint.name = joint.name or f"joint{len(tree.joints)}"
            tree.joints[joint.name], tree.carried[joint.name] = joint, body.name
            joint = body.next_joint(joint)
    return tree


def _below(body: Any) -> Iterator[Any]:
    """Yield a body and all that it carries, depth first."""
    yield body
    child = body.first_body()
    while child is not None:
        yield from _below(child)
        child = body.next_body(child)


class MjcfSource(NamedTuple):
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
    spec = mjcf_spec.read_spec(path, mujoco)
    try:
        return spec, spec.compile()
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(f"{path}: MuJoCo refuses it: {cause}") from None


def inertia_settings(spec: Any) -> dict[str, str]:
    """Return settings by which MuJoCo would change stated inertials, switched off.

    By attribute of ``<compiler>``; only those that a file has switched on.
    """
    compiler, found = spec.compiler, dict[str, str]()
    from_geoms = require_mujoco().mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    if compiler.inertiafromgeom == from_geoms:
        found["inertiafromgeom"] = "auto"
    if compiler.settotalmass > 0.0:
        found["settotalmass"] = "-1"
    for name in ("boundmass", "boundinertia"):
        if getattr(compiler, name) > 0.0:
            found[name] = "0"
    return found


def kept_effects(spec: Any) -> list[str]:
    """Return notes on what else acts on joints in a file, and is left as it was."""
    notes, disabled = [], require_mujoco().mjtDisableBit
    weightless = [body.name for body in spec.bodies if body.gravcomp]
    if weightless:
        notes.append(
            f"the file compensates gravity of {', '.join(weightless)} (gravcomp), as "
            "before: in MuJoCo, joints do not need the torque of this weight"
        )
    if spec.option.density or spec.option.viscosity:
        notes.append(
            "the file has a medium (density, viscosity of <option>), as before: its "
            "drag adds to the identified friction; set both to 0"
        )
    off = [
        name
        for name in ("spring", "damper", "frictionloss")
        if spec.option.disableflags & getattr(disabled, f"mjDSBL_{name.upper()}", 0)
    ]
    if off:
        notes.append(
            f"the file disables {', '.join(off)} (<flag>), as before: MuJoCo ignores "
            "these identified values; remove the flags"
        )
    return notes


def put_into(source: MjcfSource, estimate: Estimate) -> list[str]:
    """Put the estimate's bodies into a file's; return notes."""
    mujoco = require_mujoco()
    robot, spec, tree = estimate.model.robot, source.spec, source.tree
    if changed := inertia_settings(spec):
        for name, body in list(tree.bodies.items())[1:]:
            set_body(body, source.body(name), moves=False)
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
        for name in changed.keys() - {"inertiafromgeom"}:
            setattr(spec.compiler, name, float(changed[name]))
    if not np.array_equal(spec.option.gravity, robot.gravity):
        spec.option.gravity = robot.gravity
    notes = kept_effects(spec)
    for k, vector in enumerate(estimate.links):
        link, joint = robot.links[k].name, robot.joints[k].name
        whole = InertialParameters(vector)
        if link not in tree.bodies and not whole.vector.any():
            continue  # between two joints of one body there is no body
        free = robot.joints[k].kind == "free"  # a body of the world, fixed or not
        if link not in tree.bodies or (not free and tree.carried.get(joint) != link):
            raise ModelError(
                f"{source.file}: no body {link!r} that joint {joint!r} alone moves. "
                "Give the file that the model was loaded from; if that body has "
                "several joints, export without source"
            )
        notes += _set_link(source, robot, k, whole)
    return notes


def _set_link(
    source: MjcfSource, robot: RobotModel, k: int, whole: InertialParameters
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


def _part(source: MjcfSource, frame: FixedFrame) -> FileLink:
    """Return a body where a link's frame is: its origin lies on the joint's axis."""
    hinge = require_mujoco().mjtJoint.mjJNT_HINGE
    anchor = np.zeros(3)
    for name, body in source.tree.carried.items():
        joint = source.tree.joints[name]
        if body == frame.name and joint.type == hinge:
            anchor = np.array(joint.pos)
    origin = frame.translation - frame.rotation @ anchor
    return FileLink(frame.name, source.body(frame.name), frame.rotation, origin)
