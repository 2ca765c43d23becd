"""Torques that no drive of the model gives: one channel, or all, in another unit."""

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.diagnosis.findings import Finding
from consistent_id.recordings.recording import Recording
from consistent_id.robot.model import RobotModel

_USUAL = 0.95  # quantile of the torque's size, which a few leaps do not move
_BEYOND = 10.0  # times the effort limit: more than a careless limit
# Times the share of any other joint: limits may be placeholders, all alike, of joints
# that carry from 1 to 1000 N m; a joint in N mm has a thousand times its share.
_ALONE = 100.0
_EVERY = 3.0  # times every limit, of limits that differ and so are no placeholders


def effort_findings(robot: RobotModel, torque: Recording) -> list[Finding]:
    """Find torque far beyond effort limits, of all joints or of one alone.

    Parameters
    ----------
    robot : RobotModel
    torque : Recording
        Of the joints whose torque is looked at.
    """
    limits = {joint.name: joint.limits.effort for joint in robot.driven}
    known = [name for name in torque.joints if 0.0 < limits[name] < np.inf]
    if len(known) < 2:
        return []
    usual = np.quantile(abs(np.asarray(torque.of(known).torque)), _USUAL, axis=0)
    most = np.array([limits[name] for name in known])
    shares = usual / most
    if np.ptp(most) > 0.0 and shares.min() > _EVERY and np.median(shares) > _BEYOND:
        return [_of_all(shares)]
    j = int(np.argmax(shares))
    share, others = float(shares[j]), float(np.delete(shares, j).max())
    if share <= _BEYOND or share <= _ALONE * others:
        return []
    return [
        Finding(
            "torque unit",
            "fault",
            known[j],
            f"{known[j]}: the torque is up to {share:.3g} times the effort limit, that "
            f"of other joints {others:.2g} times at the most: it is in another unit, "
            f"{share / 1e3:.2g} times the limit if in N mm",
            f"check the unit and the gain of {known[j]}, or correct its effort limit",
            share / _BEYOND,
        )
    ]


def _of_all(shares: Vector) -> Finding:
    typical = float(np.median(shares))
    return Finding(
        "torque unit",
        "fault",
        "all joints",
        f"torques are {shares.min():.3g} to {shares.max():.3g} times the effort "
        "limits: they are in another unit, a gain is missing, or the limits are wrong",
        f"check unit and gain (times {1.0 / typical:.1g}?), or correct the limits",
        typical / _BEYOND,
    )
