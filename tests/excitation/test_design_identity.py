"""Limits, scenes, paths and recordings of another robot are sorted out, or refused."""

from dataclasses import replace

import numpy as np
import pytest
from excited import FRICTION, arm, arm_limits
from paths import random_path

from consistent_id import ProblemError, TorqueModel, build_regression, simulate_torque
from consistent_id.excitation.accuracy import predicted_accuracy
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.search_problem import search_problem
from consistent_id.excitation.verification import demands
from consistent_id.motion.collisions.bodies import Body, Sphere, plane
from consistent_id.motion.collisions.scene_building import build_scene
from consistent_id.motion.limits import MotionLimits, motion_limits
from consistent_id.regression import base_parameters

MODEL = TorqueModel(arm(2))


def reversed_limits(robot):
    """The same limits of each joint, the last joint's first."""
    limits = motion_limits(
        robot,
        position={"joint1": (-1.5, 1.0), "joint2": (-0.2, 0.3)},
        velocity=[2.0, 1.0],
        acceleration=6.0,
    )
    values = (
        getattr(limits, name)[::-1]
        for name in ("lower", "upper", "velocity", "acceleration", "jerk", "effort")
    )
    return MotionLimits(limits.joints[::-1], *values)


def test_limits_are_taken_by_name_in_any_order():
    limits = reversed_limits(MODEL.robot)
    asked = demands(MODEL, limits)
    assert asked.limits.joints == MODEL.robot.joint_names
    assert asked.limits.upper.tolist() == [1.0, 0.3]
    base = base_parameters(MODEL)
    problem = search_problem(MODEL, base, PathForm(5.0, 3), Aim(), limits)
    assert problem.basis.limits.velocity.tolist() == [2.0, 1.0]


def test_limits_that_leave_a_joint_out_are_refused():
    limits = arm_limits(arm(1))
    base = base_parameters(MODEL)
    with pytest.raises(ProblemError, match="limits of joint 'joint2' are missing"):
        demands(MODEL, limits)
    with pytest.raises(ProblemError, match="limits of joint 'joint2' are missing"):
        search_problem(MODEL, base, PathForm(5.0, 3), Aim(), limits)
    with pytest.raises(ProblemError, match="expected MotionLimits"):
        demands(MODEL, {"joint1": 1.0})


def test_a_scene_of_another_robot_is_refused():
    other = arm(3)
    scene = build_scene(other, [Body("ball", Sphere(0.1), "link3"), plane(-1.0)])
    with pytest.raises(ProblemError, match="build the scene with the model's robot"):
        demands(MODEL, arm_limits(MODEL.robot), scene=scene)


def test_no_robots_at_all_are_no_parameters():
    nobody = np.zeros((0, len(MODEL.layout)))
    with pytest.raises(ProblemError, match="one member or more"):
        demands(MODEL, arm_limits(MODEL.robot), nobody)


@pytest.mark.parametrize("joints", [("joint2", "joint1"), ("joint1",), ("a", "b")])
def test_the_accuracy_of_a_path_of_other_joints_is_refused(joints):
    with pytest.raises(ProblemError, match="expected the same, in order"):
        predicted_accuracy(MODEL, base_parameters(MODEL), random_path(0, joints))


@pytest.mark.parametrize(
    "other",
    [
        TorqueModel(replace(arm(2), gravity=(0.0, 0.0, -3.0))),
        TorqueModel(arm(2), FRICTION),
        TorqueModel(arm(3)),
        TorqueModel(arm(2), torque_joints=("joint2",)),
    ],
    ids=["gravity", "friction", "joints", "rows"],
)
def test_an_earlier_recording_of_another_model_is_refused(other):
    motion = random_path(0, other.robot.joint_names).recording(20.0)
    x = np.zeros(len(other.layout))
    x[: len(other.robot.nominal)] = other.robot.nominal
    earlier = build_regression(
        other,
        simulate_torque(other, x, motion, noise=0.1, rng=np.random.default_rng(0)),
    )
    aim, base = Aim(earlier=earlier), base_parameters(MODEL)
    path = random_path(0, MODEL.robot.joint_names)
    limits = arm_limits(MODEL.robot)
    with pytest.raises(ProblemError, match=r"torque model|joints"):
        predicted_accuracy(MODEL, base, path, aim)
    with pytest.raises(ProblemError, match=r"torque model|joints"):
        search_problem(MODEL, base, PathForm(5.0, 3), aim, limits)
