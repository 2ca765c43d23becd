"""An identified robot as a URDF: its own, or a new one for robots that have none.

In its own only numbers that changed are other bytes; a new one has bodies and joints,
but no shapes.
"""

from collections.abc import Iterator, Mapping
from dataclasses import astuple, dataclass
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import ModelError, ProblemError
from consistent_id.estimation.estimate import Estimate
from consistent_id.export.export_formats import (
    Export,
    SideFile,
    comment_edit,
    comment_text,
    exporter,
    provenance,
)
from consistent_id.export.file_values import (
    FileLink,
    JointDrive,
    central,
    follower_drives,
    in_leader,
    joint_drives,
    not_expressed,
    split_inertia,
)
from consistent_id.export.json_record import drive_record, json_text
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders.urdf_in_place import (
    Edit,
    XmlText,
    body_of,
    inertia_attributes,
    joined,
    number,
    set_body,
    set_numbers,
)
from consistent_id.robot.loaders.urdf_lint import urdf_findings
from consistent_id.robot.loaders.xml import Element
from consistent_id.robot.model import (
    STANDARD_GRAVITY,
    FixedFrame,
    Joint,
    JointLimits,
    RobotModel,
)
from consistent_id.robot.parameters import did_you_mean

_SUFFIX = ".drives.json"
_EXPRESSED = ("damping", "friction")

_UNLIMITED = 1e9  # URDF needs numbers, and has no infinity


@exporter("urdf")
def to_urdf(
    estimate: Estimate,
    source: str | Path | None = None,
    *,
    limits: Mapping[str, JointLimits] | None = None,
    comment: bool = True,
    allow_refused: bool = False,
) -> Export:
    """Return the URDF that a model was loaded from, with the identified parameters.

    Masses, centres of mass and inertias of the model's links; ``<dynamics>`` of joints
    that have drive terms, and zeros in that of joints that follow them.  All else keeps
    its bytes: comments, CDATA, white space, encoding, elements of other programs.

    A moving link and the links fixed to it are identified as one body.  The fixed ones
    keep their inertials, and the moving one gets what remains, if that is physically
    consistent; else all get shares of the whole, by mass.

    Parameters
    ----------
    estimate : Estimate
    source : str or Path, optional
        The file, expanded if it is a xacro.  Without it a plain URDF is written from
        nothing, of bodies and joints, for robots that have none.
    limits : mapping of str to JointLimits, optional
        New limits of joints by name; what is infinite stays as it is, and so do limits
        of joints that are not named.
    comment : bool
        Whether to put a line with method and verdict after ``<robot>``.
    allow_refused : bool
        Export what is refused, too.

    Returns
    -------
    Export
        Its notes say what URDF cannot express, such as rotor inertia and offsets.
        These are in a file beside it, which ends in ``.drives.json``.

    Raises
    ------
    ModelError
        If the file is not that of the model.
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
    >>> "<inertial>" in str(ci.to_urdf(found, allow_refused=True))
    True
    """
    lacking = not_expressed(estimate, "URDF", _EXPRESSED)
    notes = [*lacking, *_gravity(estimate)]
    side, line = None, provenance(estimate)
    if lacking:
        side = SideFile(_SUFFIX, json_text(drive_record(estimate)))
        line += f"; terms that URDF lacks are in the {_SUFFIX} file beside this one"
    if source is None:
        if limits:
            raise ProblemError("limits are for a source; give the model its own ones")
        text = urdf_text(estimate, line).encode()
        return Export("urdf", text, tuple(notes), side=side)
    file, edits = _File.read(Path(source)), []
    for k, vector in enumerate(estimate.links):
        of_link, note = _link_edits(
            file, estimate.model.robot, k, InertialParameters(vector)
        )
        edits += of_link
        notes += [note] if note else []
    for drive in joint_drives(estimate):
        if drive.terms.names:  # else it keeps its own
            edits += _dynamics_edits(file, drive)
    for drive in follower_drives(estimate):
        of_follower = _dynamics_edits(file, drive)
        edits += of_follower
        notes += [in_leader(drive.joint)] if of_follower else []
    for name, limit in (limits or {}).items():
        edits += _limit_edits(file, name, limit)
    notes += _left_out(file, estimate.model.robot)
    if comment:
        edits.append(comment_edit(file.document, line))
    content = file.document.spliced(joined(edits))
    return Export("urdf", content, tuple(notes), side=side)


@dataclass(frozen=True, slots=True, eq=False)
class _File:
    path: Path
    document: XmlText
    links: Mapping[str, Element]
    joints: Mapping[str, Element]

    @classmethod
    def read(cls, path: Path) -> "_File":
        document = XmlText.read(path)
        for finding in urdf_findings(document.root, lambda joint: False):
            if finding.severity == "error":
                raise ModelError(f"{path}, {finding}")
        links = {link.name: link for link in document.root.all("link")}
        joints = {joint.name: joint for joint in document.root.all("joint")}
        return cls(path, document, links, joints)

    def link(self, name: str) -> Element:
        return self._found("link", name, self.links)

    def joint(self, name: str) -> Element:
        return self._found("joint", name, self.joints)

    def _found(self, what: str, name: str, among: Mapping[str, Element]) -> Element:
        if name not in among:
            near = did_you_mean(name, among)
            raise ModelError(
                f"{self.path}: no {what} named {name!r}; {near}. Give the file that "
                "the model was loaded from"
            )
        return among[name]


def _gravity(estimate: Estimate) -> list[str]:
    """Say what gravity the torques are for, if it is not the usual one."""
    gravity = estimate.model.robot.gravity
    if np.array_equal(gravity, STANDARD_GRAVITY):
        return []
    size = float(np.linalg.norm(gravity))
    return [
        f"URDF has no gravity; that of the model is {size:g} m/s^2 along "
        f"{gravity.tolist()} of the base"
    ]


def _link_edits(
    file: _File, robot: RobotModel, k: int, whole: InertialParameters
) -> tuple[list[Edit], str]:
    link = robot.links[k]
    if robot.joints[k].kind != "free":  # the root of a file hangs on no joint
        _require_carried(file, file.joint(robot.joints[k].name), link.name)
    parts = [FileLink(link.name, body_of(file.link(link.name)), np.eye(3), np.zeros(3))]
    for frame in link.merged:
        body = body_of(file.link(frame.name))
        parts.append(FileLink(frame.name, body, frame.rotation, frame.translation))
    split = split_inertia(whole, parts)
    edits = []
    for part, body in zip(parts, split.bodies, strict=True):
        if body is not part.body:
            edits += set_body(file.document, file.link(part.name), body)
    return edits, split.note


def _require_carried(file: _File, joint: Element, link: str) -> None:
    child = joint.child("child")
    if child is None or child.attributes.get("link") != link:
        raise ModelError(
            f"{file.path}, line {joint.line}: joint {joint.name!r} does not carry link "
            f"{link!r}, as the model's does. Give the file that the model was "
            "loaded from"
        )


def _dynamics_edits(file: _File, drive: JointDrive) -> list[Edit]:
    """Return edits of a joint's friction: its own terms, and zero for missing ones."""
    joint = file.joint(drive.joint)
    stated = joint.child("dynamics")
    has = {} if stated is None else stated.attributes
    found = {name: drive.simulated(name) for name in _EXPRESSED}
    values = {
        name: (0.0 if value is None else value,)
        for name, value in found.items()
        if value is not None or name in has
    }
    return _set_or_insert(file, joint, "dynamics", values)


def _limit_edits(file: _File, name: str, limits: JointLimits) -> list[Edit]:
    joint = file.joint(name)
    names = ("lower", "upper", "velocity", "effort")
    values = {
        n: (getattr(limits, n),) for n in names if np.isfinite(getattr(limits, n))
    }
    element = joint.child("limit")
    has = {*values, *(() if element is None else element.attributes)}
    if values and not {"velocity", "effort"} <= has:
        raise ProblemError(
            f"limits of {name!r}: a URDF's <limit> must have velocity and effort; give "
            "both"
        )
    return _set_or_insert(file, joint, "limit", values)


def _set_or_insert(
    file: _File, joint: Element, tag: str, values: dict[str, tuple[float]]
) -> list[Edit]:
    element = joint.child(tag)
    if not values:
        return []
    if element is not None:
        return set_numbers(file.document, element, dict(values))
    pairs = " ".join(f'{name}="{number(value)}"' for name, (value,) in values.items())
    return [file.document.insert(joint, [[f"<{tag} {pairs}/>"]])]


def _left_out(file: _File, robot: RobotModel) -> list[str]:
    """Name links with mass that the model lacks."""
    known = {frame.name for frame in robot.ground}
    for link in robot.links:
        known |= {link.name, *(frame.name for frame in link.merged)}
    others = [
        name
        for name, link in file.links.items()
        if name not in known and body_of(link).vector.any()
    ]
    if not others:
        return []
    return [
        f"not part of the model, and left as they were: {', '.join(others)}. If they "
        "were mounted on what was identified, their mass now counts twice"
    ]


def urdf_text(estimate: Estimate, comment: str) -> str:
    """Return URDF text; gravity acts along ``-z`` of its root link."""
    robot = estimate.model.robot
    taken = (*robot.link_names, *(frame.name for frame in robot.ground))
    root, upright = _free("base", taken), _upright(robot.gravity)
    turned = not np.array_equal(upright, np.eye(3))
    world = _free("world", (root, *taken)) if turned else root
    lines = [
        '<?xml version="1.0"?>',
        f"<robot name={quoteattr(robot.name)}>",
        f"  <!-- {comment_text(comment)} -->",
    ]
    if not robot.floating:
        lines += [f"  <link name={quoteattr(world)}/>"]
        if turned:
            lines += _fixed(FixedFrame(root, upright, np.zeros(3)), world)
        for frame in robot.ground:
            lines += _fixed(frame, root)
    parents = {-1: root} | dict(enumerate(robot.link_names))
    drives = {drive.joint: drive for drive in joint_drives(estimate)}
    for joint, link, vector in zip(
        robot.joints, robot.links, estimate.links, strict=True
    ):
        drive = drives.get(joint.name)
        if joint.kind != "free":  # a base that floats is the root of the file
            lines += _joint(joint, parents[joint.parent], link.name, drive)
        lines += _link(link.name, InertialParameters(vector))
        for frame in link.merged:
            lines += _fixed(frame, link.name)
    return "\n".join([*lines, "</robot>", ""])


def rpy_of(rotation: Matrix) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of ``Rz(yaw) Ry(pitch) Rx(roll)``.

    Roll is what is left when yaw has been undone, which holds at a pitch of 90 degrees
    too.
    """
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    s, c = np.sin(yaw), np.cos(yaw)
    roll = np.arctan2(
        s * rotation[0, 2] - c * rotation[1, 2],
        c * rotation[1, 1] - s * rotation[0, 1],
    )
    return float(roll), float(pitch), float(yaw)


def _upright(gravity: Vector) -> Matrix:
    """Return a rotation that turns gravity into ``-z``."""
    size = float(np.linalg.norm(gravity))
    if size == 0.0:
        return np.eye(3)
    down = np.array([0.0, 0.0, -1.0])
    direction = gravity / size
    cosine = float(direction @ down)
    if cosine > 1.0 - 1e-15:
        return np.eye(3)
    if cosine < -1.0 + 1e-15:
        return np.diag([1.0, -1.0, -1.0])
    axis = np.cross(direction, down)
    K = np.cross(np.eye(3), axis)
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + cosine))


def _free(name: str, taken: tuple[str, ...]) -> str:
    return name if name not in taken else _free(f"{name}_", taken)


def _numbers(values: Vector | tuple[float, ...]) -> str:
    return '"' + " ".join(number(value) for value in values) + '"'


def _origin(rotation: Matrix, translation: Vector) -> str:
    return f"<origin xyz={_numbers(translation)} rpy={_numbers(rpy_of(rotation))}/>"


def _fixed(frame: FixedFrame, parent: str) -> Iterator[str]:
    yield f"  <link name={quoteattr(frame.name)}/>"
    yield f'  <joint name={quoteattr(f"{frame.name} mount")} type="fixed">'
    yield f"    <parent link={quoteattr(parent)}/>"
    yield f"    <child link={quoteattr(frame.name)}/>"
    yield f"    {_origin(frame.rotation, frame.translation)}"
    yield "  </joint>"


def _joint(
    joint: Joint, parent: str, child: str, drive: JointDrive | None
) -> Iterator[str]:
    limits = joint.limits
    bounded = bool(np.isfinite([limits.lower, limits.upper]).all())
    kind = joint.kind if bounded or joint.kind == "prismatic" else "continuous"
    yield f"  <joint name={quoteattr(joint.name)} type={quoteattr(kind)}>"
    yield f"    <parent link={quoteattr(parent)}/>"
    yield f"    <child link={quoteattr(child)}/>"
    yield f"    {_origin(joint.rotation, joint.translation)}"
    yield f"    <axis xyz={_numbers(joint.axis)}/>"
    values = {name: getattr(limits, name) for name in ("velocity", "effort")}
    if kind != "continuous":
        values |= {"lower": limits.lower, "upper": limits.upper}
    pairs = [
        f'{name}="{number(np.clip(value, -_UNLIMITED, _UNLIMITED))}"'
        for name, value in values.items()
    ]
    if kind != "continuous" or min(values.values()) < np.inf:
        yield f"    <limit {' '.join(pairs)}/>"
    if joint.mimic is not None:
        leader, ratio, offset = astuple(joint.mimic)
        yield (
            f"    <mimic joint={quoteattr(leader)} multiplier={_numbers((ratio,))} "
            f"offset={_numbers((offset,))}/>"
        )
    if drive is not None and drive.terms.names:
        damping = number(drive.simulated("damping") or 0.0)
        friction = number(drive.simulated("friction") or 0.0)
        yield f'    <dynamics damping="{damping}" friction="{friction}"/>'
    yield "  </joint>"


def _link(name: str, body: InertialParameters) -> Iterator[str]:
    mass, com, inertia = central(body)
    entries = inertia_attributes(inertia).items()
    moments = " ".join(f'{entry}="{number(value)}"' for entry, value in entries)
    yield f"  <link name={quoteattr(name)}>"
    yield "    <inertial>"
    yield f'      <origin xyz={_numbers(com)} rpy="0 0 0"/>'
    yield f'      <mass value="{number(mass)}"/>'
    yield f"      <inertia {moments}/>"
    yield "    </inertial>"
    yield "  </link>"
