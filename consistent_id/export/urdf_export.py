"""An identified robot in its own URDF: only numbers that changed are other bytes."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from consistent_id.errors import ModelError, ProblemError
from consistent_id.estimation.estimate import Estimate
from consistent_id.export.drive_values import (
    JointDrive,
    follower_drives,
    in_leader,
    joint_drives,
    not_expressed,
)
from consistent_id.export.exported_file import Export, SideFile
from consistent_id.export.inertia_split import Part, split_inertia
from consistent_id.export.json_record import drive_record, json_text
from consistent_id.export.new_urdf import urdf_text
from consistent_id.export.provenance import comment_edit, provenance, require_usable
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders.splice import Document, Edit, joined
from consistent_id.robot.loaders.urdf_inertial import (
    body_of,
    number,
    set_body,
    set_numbers,
)
from consistent_id.robot.loaders.urdf_lint import urdf_findings
from consistent_id.robot.loaders.xml import Element
from consistent_id.robot.model import STANDARD_GRAVITY, JointLimits, RobotModel
from consistent_id.robot.parameters import did_you_mean

_SUFFIX = ".drives.json"
_EXPRESSED = ("damping", "friction")


def to_urdf(
    estimate: Estimate,
    source: str | Path | None = None,
    *,
    limits: Mapping[str, JointLimits] | None = None,
    comment: bool = True,
    allow_refused: bool = False,
) -> Export:
    """Return the URDF that a model was loaded from, with what was identified.

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
    """
    require_usable(estimate, allow_refused)
    lacking = not_expressed(estimate, "URDF", _EXPRESSED)
    notes = [*lacking, *_gravity(estimate)]
    side, line = None, provenance(estimate)
    if lacking:
        side = SideFile(_SUFFIX, json_text(drive_record(estimate)))
        line += f"; what URDF lacks is in the {_SUFFIX} file beside this one"
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
    document: Document
    links: Mapping[str, Element]
    joints: Mapping[str, Element]

    @classmethod
    def read(cls, path: Path) -> "_File":
        document = Document.read(path)
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
    parts = [Part(link.name, body_of(file.link(link.name)), np.eye(3), np.zeros(3))]
    for frame in link.merged:
        body = body_of(file.link(frame.name))
        parts.append(Part(frame.name, body, frame.rotation, frame.translation))
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
    """Return edits of a joint's friction: what it has, and zero for what it has not."""
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
    """Name links with mass that the model knows nothing of."""
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
