"""A URDF written from nothing, for robots that have none: bodies, joints, no shapes."""

from collections.abc import Iterator
from dataclasses import astuple
from xml.sax.saxutils import quoteattr

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.estimation.estimate import Estimate
from consistent_id.export.drive_values import JointDrive, joint_drives
from consistent_id.export.pinocchio_model import central
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders.urdf_inertial import inertia_attributes, number
from consistent_id.robot.model import FixedFrame, Joint

_UNLIMITED = 1e9  # URDF asks for numbers, and has no infinity


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
        f"  <!-- {comment.replace('--', '- -')} -->",
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
