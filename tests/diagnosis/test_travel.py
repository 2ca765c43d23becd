"""Positions in degrees, seen by the limits of the joints."""

from dataclasses import replace

import numpy as np
import pytest
from faulty_logs import arm

from consistent_id import Recording
from consistent_id.diagnosis.wrong_units import travel_findings
from consistent_id.robot.model import JointLimits


def _robot(limits):
    robot = arm().robot
    joints = tuple(replace(joint, limits=limits) for joint in robot.joints)
    return replace(robot, joints=joints)


def _swing(factor):
    """Return a log in which all joints travel 3 rad, times a factor."""
    time = np.linspace(0.0, 10.0, 500)
    q = 1.5 * factor * np.sin(time)[:, None] * np.ones(4)
    return Recording(arm().robot.joint_names, time, q)


@pytest.mark.parametrize(
    ("limits", "factor", "found"),
    [
        (JointLimits(-2.0, 2.0), 1.0, False),
        (JointLimits(-2.0, 2.0), 180.0 / np.pi, True),
        # Limits that were drawn too narrow, and none at all.
        (JointLimits(-1.0, 1.0), 1.0, False),
        (JointLimits(), 180.0 / np.pi, False),
        (JointLimits(0.0, 0.0), 1.0, False),
        # Counts of an encoder are no degrees.
        (JointLimits(-2.0, 2.0), 1e4, False),
    ],
)
def test_travel_in_degrees_is_far_beyond_the_limits(limits, factor, found):
    findings = travel_findings(_robot(limits), _swing(factor))
    assert [f.kind for f in findings] == (["degrees"] if found else [])


@pytest.mark.parametrize("factor", [180.0 / np.pi, 100.0, 1e4])
def test_one_joint_of_four_in_another_unit_is_not_all_of_them(factor):
    log = _swing(1.0)
    one = replace(log, position=log.position * [1.0, factor, 1.0, 1.0])
    (finding,) = travel_findings(_robot(JointLimits(-2.0, 2.0)), one)
    assert (finding.kind, finding.where) == ("encoder scale", log.joints[1])
