"""An identified robot as a record that needs no other file: JSON, and so YAML."""

import json
from dataclasses import asdict
from typing import Any

import numpy as np

from consistent_id.estimation.estimate import Estimate
from consistent_id.export.export_formats import Export, exporter
from consistent_id.export.file_values import central, coupling_values, joint_drives
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.model import FixedFrame, Joint

FORMAT = "consistent_id robot 1"
DRIVES_FORMAT = "consistent_id drives 1"


@exporter("json")
def robot_record(estimate: Estimate, *, allow_refused: bool = False) -> dict[str, Any]:
    """Return robot, bodies and drives as plain numbers and text.

    SI units.  A joint's frame is placed in its parent link's; a link's frame is that of
    its joint; inertias are about the centre of mass, in the link's axes.  Infinite
    limits are null.  A joint that follows another has ``mimic``, and no drive.

    Parameters
    ----------
    estimate : Estimate
    allow_refused : bool
        Export what is refused, too.

    Raises
    ------
    ProblemError
        If the estimate is refused and `allow_refused` is false.
    """
    model = estimate.model
    robot = model.robot
    return {
        "format": FORMAT,
        **_origin(estimate),
        "gravity": robot.gravity.tolist(),
        "joints": [_joint(joint, robot.link_names) for joint in robot.joints],
        "links": [
            {
                "name": link.name,
                "joint": joint.name,
                **_body(InertialParameters(vector)),
                "fixed": [_frame(frame) for frame in link.merged],
            }
            for joint, link, vector in zip(
                robot.joints, robot.links, estimate.links, strict=True
            )
        ],
        **_drive_part(estimate),
        "without_torque": [
            name for name in robot.joint_names if name not in model.torque_joints
        ],
    }


def drive_record(estimate: Estimate) -> dict[str, Any]:
    """Return only the drives, for formats that cannot express all of them."""
    return {"format": DRIVES_FORMAT, **_origin(estimate), **_drive_part(estimate)}


def json_text(record: dict[str, Any]) -> bytes:
    """Return a record as the bytes of a file."""
    return (json.dumps(record, indent=1, allow_nan=False) + "\n").encode()


def to_json(estimate: Estimate, *, allow_refused: bool = False) -> Export:
    """Return `robot_record` as JSON, which YAML readers read too.

    Parameters
    ----------
    estimate : Estimate
    allow_refused : bool
        Export what is refused, too.
    """
    record = robot_record(estimate, allow_refused=allow_refused)
    return Export("json", json_text(record))


def _origin(estimate: Estimate) -> dict[str, Any]:
    verdict = estimate.verdict
    return {
        "robot": estimate.model.robot.name,
        "method": estimate.method,
        "verdict": verdict.word,
        "reason": "; ".join(reason.statement for reason in verdict.grounds),
        "accepted": list(verdict.accepted),
        "optimum": estimate.certificate.verdict,
    }


def _drive_part(estimate: Estimate) -> dict[str, Any]:
    reference = estimate.model.load_reference
    return {
        "drives": _drives(estimate),
        "couplings": [
            {"joints": [c.first, c.second], "shapes": c.shapes, **values}
            for c, values in coupling_values(estimate)
        ],
        "load_reference": None if reference is None else reference.tolist(),
    }


def _joint(joint: Joint, links: tuple[str, ...]) -> dict[str, Any]:
    limits = joint.limits
    return {
        "name": joint.name,
        "kind": joint.kind,
        "parent": None if joint.parent < 0 else links[joint.parent],
        "rotation": joint.rotation.tolist(),
        "translation": joint.translation.tolist(),
        "axis": joint.axis.tolist(),
        **({} if joint.mimic is None else {"mimic": asdict(joint.mimic)}),
        "limits": {
            name: float(value) if np.isfinite(value) else None
            for name in ("lower", "upper", "velocity", "effort")
            for value in [getattr(limits, name)]
        },
    }


def _body(body: InertialParameters) -> dict[str, Any]:
    mass, com, inertia = central(body)
    return {"mass": mass, "com": com.tolist(), "inertia": inertia.tolist()}


def _frame(frame: FixedFrame) -> dict[str, Any]:
    return {
        "name": frame.name,
        "rotation": frame.rotation.tolist(),
        "translation": frame.translation.tolist(),
    }


def _drives(estimate: Estimate) -> dict[str, Any]:
    slides = {j.name: j.kind == "prismatic" for j in estimate.model.robot.driven}
    return {
        drive.joint: {
            "coulomb_shape": drive.terms.coulomb,
            "shapes": drive.terms.shapes,
            "terms": {
                name: {"value": drive.values[name], "unit": unit[slides[drive.joint]]}
                for unit, names in ((t.unit, t.names) for t in drive.terms.terms)
                for name in names
            },
        }
        for drive in joint_drives(estimate)
    }
