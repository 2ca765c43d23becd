"""Limits of motion: from the robot, over what is given, and what is refused."""

import numpy as np
import pytest

from consistent_id import DHRow, ProblemError, from_modified_dh
from consistent_id.motion.limits import MotionLimits, motion_limits
from consistent_id.robot import JointLimits


def arm(*limits: JointLimits, kind="revolute"):
    return from_modified_dh("arm", [DHRow(0, 0.1, kind=kind, limits=x) for x in limits])


def test_limits_come_from_the_robot():
    own = JointLimits(-1.0, 2.0, 3.0, 40.0)
    limits = motion_limits(arm(own, own), acceleration=[5.0, 6.0])
    assert limits.lower.tolist() == [-1.0, -1.0]
    assert limits.velocity.tolist() == [3.0, 3.0]
    assert limits.acceleration.tolist() == [5.0, 6.0]
    assert np.isinf(limits.jerk).all()
    assert limits.effort.tolist() == [40.0, 40.0]


def test_a_name_changes_its_joint_alone():
    own = JointLimits(-1.0, 2.0, 3.0)
    robot = arm(own, own)
    name = robot.joint_names[1]
    limits = motion_limits(robot, velocity={name: 0.5}, position={name: (0.0, 1.0)})
    assert limits.velocity.tolist() == [3.0, 0.5]
    assert limits.upper.tolist() == [2.0, 1.0]


def test_a_share_keeps_the_middle():
    limits = motion_limits(arm(JointLimits(-1.0, 3.0, 2.0))).within(0.5)
    assert (limits.lower[0], limits.upper[0], limits.velocity[0]) == (0.0, 2.0, 1.0)


def test_a_continuous_joint_gets_one_turn():
    limits = motion_limits(arm(JointLimits(), kind="continuous"), velocity=1.0)
    assert np.allclose([limits.lower[0], limits.upper[0]], [-np.pi, np.pi])


@pytest.mark.parametrize(
    ("own", "given", "says"),
    [
        (JointLimits(1.0, 1.0, 1.0), {}, "joint1.*cannot move"),
        (JointLimits(velocity=1.0), {}, "joint1.*-inf and inf.*give its range"),
        (JointLimits(-1.0, 1.0), {}, "joint1.*no limit bounds its speed"),
        (JointLimits(-1.0, 1.0, 0.0), {}, "joint1.*velocity is 0"),
        (JointLimits(-1.0, 1.0, 1.0), {"jerk": -1.0}, "joint1.*jerk is -1"),
        (JointLimits(-1.0, 1.0, 1.0), {"effort": np.nan}, "joint1.*effort is nan"),
        (JointLimits(-1.0, 1.0, 1.0), {"velocity": [1.0, 2.0]}, "expected one number"),
        (JointLimits(-1.0, 1.0, 1.0), {"jerk": {"elbow": 1.0}}, "no joint .elbow."),
        (JointLimits(-1.0, 1.0, 1.0), {"position": {"joint1": (2, 1)}}, "not below"),
    ],
)
def test_limits_that_leave_no_motion_or_any_name_joint_and_limit(own, given, says):
    with pytest.raises(ProblemError, match=says):
        motion_limits(arm(own), **given)


def test_all_joints_with_the_same_fault_are_named_at_once():
    known = {
        "joints": ("hip", "knee", "toe"),
        "lower": [-1.0, 0.0, 0.0],
        "upper": [1.0, 0.0, 0.0],
    }
    endless = [np.inf] * 3
    with pytest.raises(ProblemError, match=r"'knee' \(and likewise 'toe'\): lower"):
        MotionLimits(
            **known,
            velocity=[1.0] * 3,
            acceleration=endless,
            jerk=endless,
            effort=endless,
        )
