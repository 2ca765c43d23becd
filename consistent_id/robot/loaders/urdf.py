"""Robots from URDF: our own lint first, then Pinocchio as the loader."""

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.files import LARGEST_TREE, require_count
from consistent_id.errors import ModelError
from consistent_id.robot.chains import Selection, selected
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.kinematics import snapped
from consistent_id.robot.loaders.urdf_lint import (
    Finding,
    followers_of,
    joints_between,
    read_bytes,
    urdf_findings,
)
from consistent_id.robot.loaders.xml import XmlFault, parse
from consistent_id.robot.model import (
    STANDARD_GRAVITY,
    Datasheet,
    FixedFrame,
    Joint,
    JointKind,
    JointLimits,
    Link,
    Mimic,
    RobotModel,
)

_log = logging.getLogger(__name__)
_LIMIT = re.compile(r"<limit\b([^>]*?)(\s*/?)>")
_JOINT = re.compile(r"(<joint\b[^>]*[^>/]>)(.*?)</joint>", re.DOTALL)
_ENDS = re.compile(r"\btype\s*=\s*[\"'](?:revolute|prismatic)[\"']")
_ENCODING = re.compile(rb"(?:\xef\xbb\xbf)?<\?xml[^>]*?encoding\s*=\s*[\"']([\w.-]+)")


def load_urdf(
    path: str | Path,
    *,
    gravity: ArrayLike = STANDARD_GRAVITY,
    base: str | None = None,
    tip: str | None = None,
    joints: Sequence[str] | None = None,
    locked: Mapping[str, float] | None = None,
) -> RobotModel:
    """Load a robot from a URDF file; fixed joints are merged into their parents.

    Masses and centres of mass of the file become nominal values and datasheet values.
    `Link.merged` and `RobotModel.carrier` say where a fixed link is.  Joints with
    ``<mimic>`` follow their leader (`Joint.mimic`).  Warnings of `lint_urdf` are
    logged.

    Parameters
    ----------
    path : str or Path
    gravity : array_like, shape (3,), [m/s^2]
        In the frame of the file's root link.
    base : str, optional
        Keep only the links beyond this one.  It and all that carry it stand still,
        their joints at zero or at their `locked` positions.  ``"floating"``: the root
        link moves freely, as that of a robot that walks, flies or hangs on a rope; it
        is then the first link, with ten parameters of its own.
    tip : str, optional
        Keep only the links that carry this one, and itself.  Links that are fixed to
        them, or hang on a locked joint, stay part of them; other links that they carry
        are dropped, so lock a gripper that was mounted.
    joints : sequence of str, optional
        Keep only these joints, and those that follow them; all others are locked, at
        zero or at their `locked` positions.
    locked : mapping of str to float, optional, [rad or m]
        Positions of joints that do not move.  The links behind a locked joint are
        merged into the link that carries the joint; its followers are locked, too.

    Returns
    -------
    RobotModel

    Raises
    ------
    ModelError
        If the file cannot be read or describes no robot; with file and line.
    """
    import pinocchio as pin

    path, selection = Path(path), Selection(base, tip, joints, locked)
    text = read_bytes(path)
    try:
        root = parse(text)
    except XmlFault as fault:
        raise ModelError(f"{path}, {fault}") from None
    floating = selection.floating(link.name for link in root.all("link"))
    base = None if floating else base
    count = sum(1 for _ in root.all("joint"))
    require_count(path, count, LARGEST_TREE, "joints", ModelError)
    chosen = joints_between(root, base, tip)
    moving = {name for name in chosen if selection.moves(name)}
    _report(path, urdf_findings(root, moving.__contains__))
    free = (pin.JointModelFreeFlyer(),) if floating else ()
    try:
        model = pin.buildModelFromXML(_with_limits(_decoded(text, path)), *free)
    except (ValueError, RuntimeError) as cause:
        raise ModelError(f"{path}: Pinocchio refuses it: {cause}") from None
    followers = followers_of(root)
    model = _without_loose(model, moving | {model.names[1]} if floating else moving)
    robot = from_pinocchio(model, gravity=gravity, mimics=followers.mimics)
    chosen_base = replace(selection, base=base).with_locked(followers.still)
    return selected(robot, chosen_base)


def _report(path: Path, findings: tuple[Finding, ...]) -> None:
    """Raise the first error, or log the first warning."""
    more = (
        f" ({len(findings) - 1} more: see consistent-id lint)" if findings[1:] else ""
    )
    for finding in findings:
        if finding.severity == "error":
            raise ModelError(f"{path}, {finding}{more}")
    if findings:
        _log.warning("%s, %s%s", path, findings[0], more)


def _decoded(text: bytes, path: Path) -> str:
    declared = _ENCODING.match(text)
    encoding = declared[1].decode() if declared else "utf-8"
    if encoding.lower() in ("utf-8", "utf8"):
        encoding = "utf-8-sig"
    try:
        return text.decode(encoding)
    except UnicodeDecodeError as cause:
        raise ModelError(
            f"{path}: byte {cause.start} is not UTF-8; save the file as UTF-8"
        ) from None


def _with_limits(text: str) -> str:
    """Put in the limits that Pinocchio needs: the largest."""
    largest = np.finfo(np.float64).max

    def limited(found: re.Match[str]) -> str:
        if not _ENDS.search(found[1]) or "<limit" in found[2]:
            return found[0]
        limit = f'<limit lower="{-largest}" upper="{largest}"/>'
        return f"{found[1]}{found[2]}{limit}</joint>"

    def filled(found: re.Match[str]) -> str:
        missing = (key for key in ("effort", "velocity") if key not in found[1])
        added = "".join(f' {key}="{largest}"' for key in missing)
        return f"<limit{found[1]}{added}{found[2]}>"

    return _LIMIT.sub(filled, _JOINT.sub(limited, text))


def _without_loose(model: Any, moving: set[str]) -> Any:
    """Fix joints of several degrees of freedom that do not move at their origin."""
    import pinocchio as pin

    loose = [
        k
        for k, (name, joint) in enumerate(zip(model.names, model.joints, strict=True))
        if k > 0 and joint.nv > 1 and name not in moving
    ]
    if not loose:
        return model
    return pin.buildReducedModel(model, loose, pin.neutral(model))


def from_pinocchio(
    model: Any,
    *,
    gravity: ArrayLike | None = None,
    mimics: Mapping[str, Mimic] | None = None,
) -> RobotModel:
    """Convert a ``pinocchio.Model`` of one-axis joints into a `RobotModel`.

    Its first joint may be a free flyer; the base then floats.  `mimics` says which
    joints follow others.

    Raises
    ------
    ModelError
        If another joint has more than one degree of freedom.
    """
    bodies = _bodies(model)
    joints, links = [], []
    for k in range(1, model.njoints):
        kind = _kind(model, k)
        twist = np.ravel(model.joints[k].createData().S)[-6:]
        placement = model.jointPlacements[k]
        joints.append(
            Joint(
                name=model.names[k],
                kind=kind,
                parent=model.parents[k] - 1,
                rotation=snapped(placement.rotation),
                translation=placement.translation,
                axis=snapped(twist[:3] if kind == "prismatic" else twist[3:]),
                limits=_limits(model, k, kind),
                mimic=(mimics or {}).get(model.names[k]),
            )
        )
        links.append(_link(model, k, bodies[k]))
    if gravity is None:
        gravity = model.gravity.linear
    ground = tuple(_frame(frame) for frame in bodies[0])
    return RobotModel(
        model.name, tuple(joints), tuple(links), np.asarray(gravity), ground
    )


def _kind(model: Any, k: int) -> JointKind:
    joint = model.joints[k]
    short = joint.shortname()
    if short == "JointModelFreeFlyer" and model.parents[k] == 0:
        return "free"
    if joint.nv != 1 or "Helical" in short or "Mimic" in short:
        raise ModelError(
            f"joint {model.names[k]!r} is a {short}; only revolute, continuous, "
            "prismatic and fixed joints, and a free one at the root, are supported"
        )
    if "Prismatic" in short or short.startswith("JointModelP"):
        return "prismatic"
    return "continuous" if joint.nq == 2 else "revolute"


def _limits(model: Any, k: int, kind: JointKind) -> JointLimits:
    """Limits as stated in the file; missing ones are infinite, not zero."""
    if kind == "free":
        return JointLimits()
    position, rate = model.joints[k].idx_q, model.joints[k].idx_v
    lower, upper = -np.inf, np.inf
    if kind != "continuous":
        lower = _stated(model.lowerPositionLimit[position])
        upper = _stated(model.upperPositionLimit[position])
    return JointLimits(
        lower,
        upper,
        abs(_stated(model.upperVelocityLimit[rate])) or np.inf,
        abs(_stated(model.upperEffortLimit[rate])) or np.inf,
    )


def _stated(limit: float) -> float:
    """Return a limit, infinite where Pinocchio has put the largest double for none."""
    largest = np.finfo(np.float64).max
    return float(limit) if abs(limit) < largest else float(np.copysign(np.inf, limit))


def _link(model: Any, k: int, frames: list[Any]) -> Link:
    body = model.inertias[k]
    nominal = InertialParameters.from_central(body.mass, body.lever, body.inertia)
    name = cast(str, frames[0].name) if frames else f"link_of_{model.names[k]}"
    com = body.lever if body.mass > 0.0 else None
    sheet = Datasheet(mass=body.mass if body.mass > 0.0 else None, com=com)
    return Link(name, nominal, sheet, tuple(_frame(frame) for frame in frames[1:]))


def _bodies(model: Any) -> list[list[Any]]:
    """Frames of the links that each joint moves, its own one first."""
    import pinocchio as pin

    found: list[list[Any]] = [[] for _ in range(model.njoints)]
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            found[frame.parentJoint].append(frame)
    return found


def _frame(frame: Any) -> FixedFrame:
    place = frame.placement
    return FixedFrame(frame.name, snapped(place.rotation), place.translation)
