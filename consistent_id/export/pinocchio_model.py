"""An identified robot as a ``pinocchio.Model``."""

from typing import Any

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import ProblemError
from consistent_id.estimation.estimate import Estimate
from consistent_id.export.export_formats import Export, exporter
from consistent_id.export.file_values import central, joint_drives, not_expressed
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.model import Joint, RobotModel

_EXPRESSED = ("damping", "friction", "armature")

_CONTINUOUS = (
    '<robot name="r"><link name="a"/><link name="b"/>'
    '<joint name="j" type="continuous"><parent link="a"/><child link="b"/>'
    '<axis xyz="{!r} {!r} {!r}"/></joint></robot>'
)


@exporter("pin")
def to_pinocchio(estimate: Estimate, *, allow_refused: bool = False) -> Any:
    """Return a ``pinocchio.Model`` with the identified bodies and drives.

    Rotor inertias are its armature, which ``pin.rnea`` and ``pin.crba`` heed; viscous
    and Coulomb friction are its damping and dry-friction limits, which they do not: add
    ``model.damping * v + model.upperDryFrictionLimit * numpy.sign(v)``.  Continuous
    joints have (cos, sin) as configuration, as from Pinocchio's own URDF reader.

    Parameters
    ----------
    estimate : Estimate
    allow_refused : bool
        Export what is refused, too.

    Raises
    ------
    ProblemError
        If the estimate is refused and `allow_refused` is false, or a joint follows
        another.
    """
    import pinocchio as pin

    robot = estimate.model.robot
    _require_no_followers(robot)
    model = pin.Model()
    model.name = robot.name
    model.gravity.linear = robot.gravity
    for frame in robot.ground:
        place = pin.SE3(frame.rotation, frame.translation)
        model.addBodyFrame(frame.name, 0, place, 0)
    for joint, link, vector in zip(
        robot.joints, robot.links, estimate.links, strict=True
    ):
        k = _added(pin, model, joint)
        mass, com, inertia = central(InertialParameters(vector))
        # Not appended to nothing: that sum goes wrong for a mass below zero.
        model.inertias[k] = pin.Inertia(mass, com, inertia)
        frame = model.addJointFrame(k)
        model.addBodyFrame(link.name, k, pin.SE3.Identity(), frame)
        for fixed in link.merged:
            place = pin.SE3(fixed.rotation, fixed.translation)
            model.addBodyFrame(fixed.name, k, place, frame)
    first = 6 if robot.floating else 0
    for i, drive in enumerate(joint_drives(estimate), start=first):
        model.armature[i] = drive.simulated("armature") or 0.0
        model.damping[i] = drive.simulated("damping") or 0.0
        _set_friction(model, i, drive.simulated("friction") or 0.0)
    return model


def _require_no_followers(robot: RobotModel) -> None:
    """Refuse followers: Pinocchio's do not go through its own text format."""
    followers = [joint.name for joint in robot.joints if joint.mimic is not None]
    if followers:
        raise ProblemError(
            f"{', '.join(followers)} follow other joints, which this model cannot "
            "express. Export a URDF, and read it with "
            "pinocchio.buildModelFromUrdf(path, mimic=True)"
        )


def _set_friction(model: Any, i: int, level: float) -> None:
    """Set dry friction, which older versions of Pinocchio have as one number."""
    if hasattr(model, "upperDryFrictionLimit"):
        model.lowerDryFrictionLimit[i], model.upperDryFrictionLimit[i] = -level, level
    else:
        model.friction[i] = level


def pinocchio_file(estimate: Estimate, *, allow_refused: bool = False) -> Export:
    """Return the model as text that ``pin.Model().loadFromString`` reads."""
    model = to_pinocchio(estimate, allow_refused=allow_refused)
    notes = (
        *not_expressed(estimate, "pinocchio.Model", _EXPRESSED),
        "pin.rnea leaves damping and dry friction out: add them",
    )
    return Export("pin", model.saveToString().encode(), notes)


def _added(pin: Any, model: Any, joint: Joint) -> int:
    """Add a joint; along or about a coordinate axis it is Pinocchio's fast one."""
    if joint.kind == "free":
        place = pin.SE3(joint.rotation, joint.translation)
        return int(model.addJoint(0, pin.JointModelFreeFlyer(), place, joint.name))
    letter = "".join(
        axis
        for axis, unit in zip("XYZ", np.eye(3), strict=True)
        if np.array_equal(joint.axis, unit)
    )
    short = {"prismatic": "P", "revolute": "R", "continuous": "RUB"}[joint.kind]
    kind = (
        getattr(pin, f"JointModel{short}{letter}")()
        if letter
        else _about(pin, joint.kind, joint.axis)
    )
    limits = joint.limits
    turns = joint.kind == "continuous"
    lower = [-1.01, -1.01] if turns else [limits.lower]
    upper = [1.01, 1.01] if turns else [limits.upper]
    return int(
        model.addJoint(
            joint.parent + 1,
            kind,
            pin.SE3(joint.rotation, joint.translation),
            joint.name,
            np.array([limits.effort]),
            np.array([limits.velocity]),
            np.array(lower),
            np.array(upper),
        )
    )


def _about(pin: Any, kind: str, axis: Vector) -> Any:
    """Return a joint along or about any axis."""
    if kind == "prismatic":
        return pin.JointModelPrismaticUnaligned(axis)
    if kind == "revolute":
        return pin.JointModelRevoluteUnaligned(axis)
    # Python cannot give an axis to Pinocchio's joint without limits; its reader can.
    return pin.buildModelFromXML(_CONTINUOUS.format(*axis.tolist())).joints[1]
