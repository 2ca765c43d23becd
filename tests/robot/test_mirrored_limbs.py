"""Joints of limbs that mirror each other, by name and geometry."""

from dataclasses import replace

import numpy as np
import pytest

from consistent_id.robot.chains import mirrored_motors, without_side
from consistent_id.robot.model import Joint, Link, RobotModel


def legs(sides=("FL", "FR", "RL", "RR"), head=True):
    """Legs of a hip, a thigh and a calf each, and a head."""
    joints = []
    for k, side in enumerate(sides):
        left = 1.0 if k % 2 == 0 else -1.0
        at = len(joints)
        for name, parent, place, axis in (
            ("hip", -1, (0.2, 0.05 * left, 0.0), (left, 0.0, 0.0)),
            ("thigh", at, (0.0, 0.1 * left, 0.0), (0.0, 1.0, 0.0)),
            ("calf", at + 1, (0.0, 0.0, -0.2), (0.0, 1.0, 0.0)),
        ):
            joints.append(
                Joint(
                    f"{side}_{name}_joint", "revolute", parent, np.eye(3), place, axis
                )
            )
    if head:
        joints.append(
            Joint("head", "revolute", -1, np.eye(3), (0.3, 0.0, 0.1), (0.0, 0.0, 1.0))
        )
    links = tuple(Link(f"link of {joint.name}") for joint in joints)
    return RobotModel("legs", tuple(joints), links)


def test_joints_at_the_same_place_of_mirrored_legs_share_their_motors():
    groups = mirrored_motors(legs())
    sides = ("FL", "FR", "RL", "RR")
    assert groups == tuple(
        tuple(f"{side}_{name}_joint" for side in sides)
        for name in ("hip", "thigh", "calf")
    )


def test_a_leg_of_another_length_is_none_of_them():
    robot = legs()
    joints = list(robot.joints)
    joints[11] = replace(joints[11], translation=np.array([0.0, 0.0, -0.25]))
    groups = mirrored_motors(replace(robot, joints=tuple(joints)))
    assert all("RR" not in name for group in groups for name in group)
    assert [len(group) for group in groups] == [3, 3, 3]


def test_one_limb_and_limbs_of_other_names_share_nothing():
    assert mirrored_motors(legs(("FL",))) == ()
    robot = legs(("FL", "FR"), head=False)
    joints = list(robot.joints)
    joints[5] = replace(joints[5], name="FR_ankle")
    assert mirrored_motors(replace(robot, joints=tuple(joints))) == ()


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("left_shoulder_pitch", "shoulder_pitch"),
        ("rightKnee", "knee"),
        ("LF_HAA", "haa"),
        ("elbow_l", "elbow"),
        ("arm1_joint", "arm1_joint"),
    ],
)
def test_sides_are_left_out_of_names(name, kept):
    assert without_side(name) == kept
