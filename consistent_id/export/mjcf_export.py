"""An identified robot for MuJoCo: built anew, or put into its own MJCF file.

Tendons express friction that varies with position, and coupled gears.
A tendon between a point of the link and one of its parent, both at the radius ``r``
from the joint's axis and opposite to each other at ``q = e``, has the moment arm
``r sin((q - e) / 2)``.  Friction of the tendon is a torque that grows with it, nearly
linearly up to a few radians.

For coupled gears, the tendon's length is the sum of both positions.  What two joints
share of viscous friction, ``[[d1, b], [b, d2]]``, is a damper ``b`` on the sum of both
rates and dampers ``d1 - b`` and ``d2 - b`` on each; rotor inertias likewise, and
Coulomb friction of the sum is the tendon's own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.given_values import require_type
from consistent_id.errors import ModelError
from consistent_id.estimation.estimate import Estimate
from consistent_id.export.export_formats import (
    Export,
    comment_text,
    exporter,
    provenance,
    require_exportable,
    without_doubtful,
)
from consistent_id.export.file_values import (
    JointDrive,
    can_slope,
    coupling_values,
    follower_drives,
    in_leader,
    joint_drives,
    not_expressed,
)
from consistent_id.export.mjcf_bodies import (
    MjcfSource,
    put_into,
    quaternion,
    read_spec,
    require_mujoco,
    set_body,
    spec_tree,
)
from consistent_id.export.mjcf_drives import delayed_drives, drives_file
from consistent_id.export.mjcf_in_place import (
    compiled_content,
    exact_xml,
    put_in_place,
)
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders.mjcf import quaternion_matrix
from consistent_id.robot.model import Joint, Mimic

RADIUS = 0.05
"""Distance of the tendon's ends from the joint [m]; the torque does not depend on it.
"""

SIZE = 1e-3
"""Size of the sites that are its ends [m]; only for display."""

_GRID = 65  # positions between the limits at which the levels are made alike

_ROUNDING = 1e-8  # relative; so much less than the shared value may a joint's own be
_SHARED = {
    "coupling_viscous": "damping",
    "coupling_coulomb": "frictionloss",
    "coupling_rotor_inertia": "armature",
}


class _Level(NamedTuple):
    """Friction ``joint + tendon r |sin((q - rest) / 2)|``, and how far off it is."""

    joint: float  # N m
    tendon: float  # N
    rest: float  # rad
    error: float  # N m


def add_slopes(
    spec: Any, joints: Mapping[str, Any], estimate: Estimate
) -> tuple[set[tuple[str, str]], list[str]]:
    """Add a tendon for each joint whose friction varies with position.

    Returns
    -------
    set of (str, str)
        Joints and terms that are expressed.
    list of str
        Notes on how well.
    """
    sloped = [
        (drive, joint)
        for drive, joint in zip(
            joint_drives(estimate), estimate.model.robot.driven, strict=True
        )
        if drive.values.get("friction_slope") and can_slope(joint)
    ]
    if not sloped:
        return set(), []
    expressed, worst = set(), 0.0
    compiled = spec.compile()
    for drive, joint in sloped:
        level = _level(drive, joint)
        set_number(joints[joint.name], "frictionloss", level.joint)
        _add_tendon(spec, joints[joint.name], compiled, level)
        expressed.add((joint.name, "friction_slope"))
        worst = max(worst, level.error)
    names = ", ".join(drive.joint for drive, _ in sloped)
    note = (
        f"friction of {names} varies with position: tendons with friction do so, with "
        f"an error of at most {worst:.2g} N m between the limits"
    )
    return expressed, [note]


def add_gears(
    spec: Any, joints: Mapping[str, Any], estimate: Estimate
) -> set[tuple[str, str]]:
    """Add a tendon for each coupling, to joints that have their drives already.

    Returns
    -------
    set of (str, str)
        Couplings and terms that are expressed: those whose dampers and inertias all
        come out positive.
    """
    expressed = set()
    for coupling, values in coupling_values(estimate):
        ends = (joints[coupling.first], joints[coupling.second])
        tendon = spec.add_tendon(name=coupling.label)
        shared = {
            term: value
            for term, value in values.items()
            # Older versions have no inertia of tendons.
            if hasattr(tendon, _SHARED[term]) and _fits(term, value, ends)
        }
        for name, end in zip((coupling.first, coupling.second), ends, strict=True):
            tendon.wrap_joint(name, 1.0)
            for term, value in shared.items():
                if term != "coupling_coulomb":
                    rest = max(_number(end, _SHARED[term]) - value, 0.0)
                    set_number(end, _SHARED[term], rest)
        for term, value in shared.items():
            set_number(tendon, _SHARED[term], value)
            expressed.add((coupling.label, term))
    return expressed


def set_number(item: Any, name: str, value: float) -> None:
    """Set a number that newer versions of MuJoCo have as a polynomial's first."""
    stated = getattr(item, name)
    if np.ndim(stated):
        setattr(item, name, [value, *np.zeros(len(stated) - 1)])
    else:
        setattr(item, name, value)


def _level(drive: JointDrive, joint: Joint) -> _Level:
    """Return the friction of joint and tendon nearest to ``coulomb + slope q``."""
    slope = drive.values["friction_slope"]
    coulomb = (drive.simulated("friction") or 0.0) - slope * drive.middle
    return _nearest_level(coulomb, slope, joint.limits.lower, joint.limits.upper)


@lru_cache(maxsize=256)  # of models for derivatives, most joints are alike
def _nearest_level(coulomb: float, slope: float, low: float, high: float) -> _Level:
    rest = low if slope > 0.0 else high
    q = np.linspace(low, high, _GRID)
    wanted = coulomb + slope * q
    arm = RADIUS * abs(np.sin((q - rest) / 2.0))
    shapes = np.column_stack([np.ones_like(q), arm / RADIUS])
    constant, growing = _nonnegative(shapes, wanted)
    error = abs(shapes @ [constant, growing] - wanted).max()
    return _Level(float(constant), float(growing) / RADIUS, rest, float(error))


def _nonnegative(shapes: Matrix, wanted: Vector) -> Vector:
    """Return the least squares of two columns with weights that are not negative.

    The import of scipy.optimize takes longer than a hundred of these models.
    """
    both, *_ = np.linalg.lstsq(shapes, wanted)
    if (both >= 0.0).all():
        return np.asarray(both)
    squares = np.maximum((shapes**2).sum(axis=0), 1e-300)
    one = np.diag(np.maximum(shapes.T @ wanted / squares, 0.0))  # a column alone, each
    errors = ((shapes @ one - wanted[:, None]) ** 2).sum(axis=0)
    return np.asarray(one[:, errors.argmin()])


def _add_tendon(spec: Any, joint: Any, compiled: Any, level: _Level) -> None:
    own, parents = _ends(compiled, compiled.joint(joint.name).id, level.rest)
    body = joint.parent
    names = [f"{joint.name} friction {end}" for end in ("link", "parent")]
    body.add_site(name=names[0], pos=own, size=[SIZE, 0.0, 0.0])
    body.parent.add_site(name=names[1], pos=parents, size=[SIZE, 0.0, 0.0])
    tendon = spec.add_tendon(name=f"{joint.name} friction")
    for name in names:
        tendon.wrap_site(name)
    set_number(tendon, "frictionloss", level.tendon)


def _ends(model: Any, j: int, rest: float) -> tuple[Vector, Vector]:
    """Return the ends of a tendon, in the frames of link and parent."""
    body = int(model.jnt_bodyid[j])
    axis, anchor = model.jnt_axis[j], model.jnt_pos[j]
    across = np.eye(3)[int(np.argmin(abs(axis)))]
    u = np.cross(axis, across)
    u /= np.linalg.norm(u)
    angle = rest - float(model.qpos0[model.jnt_qposadr[j]]) + np.pi
    turned = np.cos(angle) * u + np.sin(angle) * np.cross(axis, u)
    R = quaternion_matrix(model.body_quat[body])
    own = anchor + RADIUS * u
    return own, model.body_pos[body] + R @ (anchor + RADIUS * turned)


def _fits(term: str, value: float, ends: tuple[Any, Any]) -> bool:
    if value < 0.0:
        return False
    if term == "coupling_coulomb":
        return True
    least = (1.0 - _ROUNDING) * value
    return all(_number(end, _SHARED[term]) >= least for end in ends)


def _number(item: Any, name: str) -> float:
    return float(np.ravel(getattr(item, name))[0])


WEAK = 1e-4  # stiffness over offset, [1/rad] or [1/m], of a spring that is a preload
_EXPRESSED = ("damping", "friction", "armature", "stiffness")
_DRIVE = ("damping", "frictionloss", "armature", "stiffness")


class Specified(NamedTuple):
    """A ``mujoco.MjSpec``, and notes on parts of an estimate that it cannot express."""

    spec: Any
    notes: tuple[str, ...]


def to_mjcf(
    estimate: Estimate,
    source: str | Path | None = None,
    *,
    folder: str | Path | None = None,
    copy_files: bool = False,
    gains: PDGains | None = None,
    delay: float = 0.0,
    commands: tuple[str, ...] = (),
    logs: Sequence[Recording] = (),
    allow_refused: bool = False,
) -> Export:
    """Return MJCF with explicit inertials, armature, damping, friction loss, springs.

    Offsets and springs within their standard error are left out, if hardly felt.

    Parameters
    ----------
    estimate : Estimate
    source : str or Path, optional
        The MJCF file that the model was loaded from; all else in it keeps its bytes.
        Only a file that includes or repeats parts is written anew, by MuJoCo, and so is
        a URDF, with its shapes.  Without a source the robot is built anew: bodies,
        joints and limits, links fixed to them as sites, no shapes.
    folder : str or Path, optional
        Where the file will be written, from where the source's meshes and textures are
        to be found; the source's own by default.
    copy_files : bool
        Whether meshes and textures are to be copied there, too.
    gains : PDGains, optional
        Gains of PD-controlled joints.  With a delay, a second file beside the first has
        these drives as actuators whose commands are late.
    delay : float, [s]
        Delay of commands.
    commands : tuple of str
        ``velocity`` and ``torque``, if the joints take such commands beside those of
        position.
    logs : sequence of Recording
        Further motions that the drives can make: limits of torque that these exceed are
        left out, as those that the training data exceed.
    allow_refused : bool
        Export refused estimates, too; MuJoCo does not accept all of them.

    Raises
    ------
    ModelError
        If MuJoCo is not installed or refuses the result, `source` is not the model's,
        the delay is negative, or `commands` are unknown.
    ProblemError
        If the estimate is refused.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True))
    >>> q, dq, ddq = np.random.default_rng(0).normal(size=(3, 200, 1))
    >>> motion = ci.Recording(("joint1",), np.arange(200) / 100, q, dq, ddq)
    >>> body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]  # kg, kg m, kg m^2
    >>> log = ci.simulate_torque(model, [*body, 0.4], motion)
    >>> regression = ci.build_regression(model, log)
    >>> known = [ci.PhysicalConsistency(), ci.FixedMasses({"link1": 2.0})]
    >>> found = ci.constrained_least_squares(model, regression, constraints=known)
    >>> "<mujoco" in str(ci.to_mjcf(found, allow_refused=True))
    True
    """
    mujoco = require_mujoco()
    require_exportable(estimate, "mjcf", allow_refused=allow_refused)
    estimate, doubtful = without_doubtful(estimate)
    spec, notes = mujoco_spec(estimate, source, allow_refused=True)
    notes = (*notes, *doubtful)
    line = provenance(estimate)
    try:
        if source is not None:
            place = None if folder is None else Path(folder)
            done = put_in_place(spec, Path(source), line, place, copy_files)
            made = Export("mjcf", done.content, (*notes, *done.notes), done.files)
        else:
            comment = comment_text(line).encode("ascii", "replace")
            text = b"<!-- " + comment + b" -->\n" + exact_xml(spec)
            made = Export("mjcf", text, notes)
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(f"MuJoCo refuses the estimate: {cause}") from None
    if gains is None or delay == 0.0:
        return made
    require_type(gains, PDGains, "gains")
    drives = delayed_drives(estimate, gains, delay, commands, logs)
    place = None if source is None else Path(source)
    side, note = drives_file(
        made.content, lambda content: compiled_content(content, place), drives
    )
    return replace(made, side=side, notes=(*made.notes, *note))


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
    exempt |= _add_drag(tree.joints, estimate)
    sloped, of_slopes = add_slopes(spec, tree.joints, estimate)
    exempt |= sloped
    more = [*more, *of_slopes]
    notes = not_expressed(estimate, "MuJoCo", _EXPRESSED, exempt)
    return Specified(spec, (*notes, *_weak_springs(estimate), *more))


def _preloads(estimate: Estimate) -> set[tuple[str, str]]:
    """Return offsets, which are those of springs: ``spring (q - springref)``."""
    return {(drive.joint, "offset") for drive in joint_drives(estimate)}


def _add_drag(joints: Mapping[str, Any], estimate: Estimate) -> set[tuple[str, str]]:
    """Set the second number of dampings, which newer versions of MuJoCo have."""
    expressed = set()
    for drive in joint_drives(estimate):
        drag, damping = drive.values.get("drag", 0.0), joints[drive.joint].damping
        if drag and np.ndim(damping):
            joints[drive.joint].damping = [damping[0], drag, *damping[2:]]
            expressed.add((drive.joint, "drag"))
    return expressed


def _weak_springs(estimate: Estimate) -> list[str]:
    """Return the note on offsets that are springs which were not identified."""
    weak = [
        drive.joint
        for drive in joint_drives(estimate)
        if drive.values.get("offset") and not drive.simulated("stiffness")
    ]
    if not weak:
        return []
    return [
        f"MuJoCo has no torque offset; those of {', '.join(weak)} are weak springs "
        f"with preload, with an error of {100 * WEAK:g} % of the offset per rad or m"
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
    joint.springdamper = [0.0, 0.0]  # would go before damping and stiffness
    set_number(joint, "damping", drive.simulated("damping") or 0.0)
    set_number(joint, "frictionloss", drive.simulated("friction") or 0.0)
    set_number(joint, "armature", drive.simulated("armature") or 0.0)
    set_number(joint, "stiffness", spring)
    if spring:
        joint.springref = -angle * offset / spring
