"""Positions that no joint of the model reaches: they are in another unit."""

import numpy as np

from consistent_id._support.arrays import BoolArray, Vector
from consistent_id.diagnosis.findings import Finding
from consistent_id.recordings.recording import Recording
from consistent_id.robot.model import RobotModel

_BEYOND = 2.0  # times the range of a joint's limits: more than a careless limit
_ALONE = 5.0  # times: of a joint by itself, whose limits may be a guess
_DEGREES = 180.0 / np.pi


def travel_findings(robot: RobotModel, log: Recording) -> list[Finding]:
    """Find travel far beyond the limits of joints.

    Of most joints, it is in degrees if it would fit so; of few, each is in a unit of
    its own.

    Parameters
    ----------
    robot : RobotModel
    log : Recording
        Of the robot's joints, in their order.
    """
    limits = [joint.limits for joint in robot.driven]
    width = np.array([limit.upper - limit.lower for limit in limits])
    turning = np.array([joint.kind == "revolute" for joint in robot.driven])
    judged = turning & np.isfinite(width) & (width > 0.0)
    if not judged.any():
        return []
    share = np.ptp(log.position, axis=0)[judged] / width[judged]
    most = 0.5 * len(share)
    beyond = share > _BEYOND
    if beyond.sum() > most and share.max() <= _DEGREES:
        return [_in_degrees(share, beyond)]
    if (alone := share > _ALONE).sum() > most:
        return []
    names = np.array(robot.joint_names)[judged]
    return [_of_its_own(names[j], float(share[j])) for j in np.flatnonzero(alone)]


def _in_degrees(share: Vector, beyond: BoolArray) -> Finding:
    return Finding(
        "degrees",
        "fault",
        "all joints",
        f"joints travel up to {share.max():.3g} times the range of their limits, "
        f"and {share.max() / _DEGREES:.0%} of it if positions are in degrees",
        "read them as degrees (--units deg), or multiply positions and velocities by "
        "pi / 180",
        float(np.median(share[beyond])) / _BEYOND,
    )


def _of_its_own(joint: str, share: float) -> Finding:
    return Finding(
        "encoder scale",
        "fault",
        joint,
        f"{joint} travels {share:.3g} times the range of its limits, as most "
        f"joints do not: {share / _DEGREES:.2g} times if its position is in degrees",
        "check unit and gear ratio of its position and velocity, or correct its limits",
        share / _ALONE,
    )
