"""Positions that no joint of the model reaches: they are in degrees."""

import numpy as np

from consistent_id.diagnosis.findings import Finding
from consistent_id.recordings.recording import Recording
from consistent_id.robot.model import RobotModel

_BEYOND = 2.0  # times the range of a joint's limits: more than a careless limit
_DEGREES = 180.0 / np.pi


def travel_findings(robot: RobotModel, log: Recording) -> list[Finding]:
    """Find travel far beyond the limits of most joints, that would fit in degrees.

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
    beyond = share > _BEYOND
    if beyond.sum() <= 0.5 * len(share) or share.max() > _DEGREES:
        return []
    return [
        Finding(
            "degrees",
            "fault",
            "all joints",
            f"joints travel up to {share.max():.3g} times the range of their limits, "
            f"and {share.max() / _DEGREES:.0%} of it if positions are in degrees",
            "multiply positions and velocities by pi / 180",
            float(np.median(share[beyond])) / _BEYOND,
        )
    ]
