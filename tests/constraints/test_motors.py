"""Rotor inertias that datasheets state, and the bands about them."""

import numpy as np
import pytest
from robots import random_robot

from consistent_id.constraints.parameter_constraints import (
    EqualMotors,
    Motor,
    ParameterBounds,
    RotorInertias,
)
from consistent_id.errors import ProblemError
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.regressor import TorqueModel


@pytest.fixture
def model():
    robot = random_robot(np.random.default_rng(2), 2)[1]
    return TorqueModel(robot, DriveTerms(viscous=True, rotor_inertia=True))


def violation(constraint, model, **values):
    """How far parameters are outside, all zero but those of joint 1 and 2 given."""
    x = np.zeros(len(model.layout))
    for name, value in values.items():
        joint = model.robot.joint_names[int(name[-1]) - 1]
        x[model.layout.index(f"{joint}.{name[:-2]}")] = value
    return constraint.lower(model).violation(x)


MOTOR = Motor(inertia=2e-4, gear_ratio=-50.0)  # 0.5 kg m^2 seen from the link


@pytest.mark.parametrize(
    ("tolerance", "value", "inside"),
    [
        (0.0, 0.5, True),
        (0.0, 0.4999, False),
        (0.0, 0.5001, False),
        (0.1, 0.4501, True),
        (0.1, 0.4499, False),
        (0.1, 0.5499, True),
        (0.1, 0.5501, False),
        # No rotor has an inertia below zero, however wide the band.
        (3.0, 0.0001, True),
        (3.0, -0.0001, False),
        (3.0, 1.9999, True),
        (3.0, 2.0001, False),
    ],
)
def test_a_rotor_is_within_its_tolerance_of_the_datasheet(
    model, tolerance, value, inside
):
    joint = model.robot.joint_names[0]
    stated = RotorInertias({joint: MOTOR}, tolerance)
    # The other joint's is free, and other terms of this one are.
    found = violation(
        stated, model, rotor_inertia_1=value, rotor_inertia_2=7.0, viscous_1=-3.0
    )
    assert (found <= 0.0) == inside
    if not inside:
        assert found > 1e-5


def test_a_motor_counts_with_the_square_of_its_gear():
    assert MOTOR.reflected == pytest.approx(0.5)
    assert Motor(0.0, 1.0).reflected == 0.0


@pytest.mark.parametrize("inertia", [-1e-9, np.inf, np.nan])
def test_a_motor_whose_inertia_is_none_is_refused(inertia):
    with pytest.raises(ProblemError, match="motor inertia"):
        Motor(inertia, 1.0)


@pytest.mark.parametrize("ratio", [0.0, np.inf, np.nan, -np.inf])
def test_a_gear_that_does_not_turn_is_refused(ratio):
    with pytest.raises(ProblemError, match="gear ratio"):
        Motor(1e-4, ratio)


@pytest.mark.parametrize("tolerance", [-1e-9, np.inf, np.nan])
def test_a_tolerance_is_a_share_of_zero_or_more(tolerance):
    with pytest.raises(ProblemError, match="tolerance"):
        RotorInertias({"joint": MOTOR}, tolerance)


def test_motors_need_joints_with_a_rotor(model):
    with pytest.raises(ProblemError, match="no motor"):
        RotorInertias({})
    with pytest.raises(ProblemError, match="'elbow': no joint of that name"):
        RotorInertias({"elbow": MOTOR}).lower(model)


def test_equal_motors_are_equal_in_each_term_that_is_named(model):
    joints = model.robot.joint_names
    both = EqualMotors(joints, ("rotor_inertia", "viscous"))
    alike = {"rotor_inertia_1": 0.3, "rotor_inertia_2": 0.3}
    assert violation(both, model, **alike, viscous_1=2.0, viscous_2=2.0) == 0.0
    assert violation(both, model, **alike, viscous_1=2.0, viscous_2=2.1) > 0.0
    assert violation(EqualMotors(joints), model, **alike, viscous_1=2.0) == 0.0
    for wrong in (joints[:1], (joints[0], joints[0], joints[1])):
        with pytest.raises(ProblemError, match="two or more distinct"):
            EqualMotors(wrong).lower(model)


def test_bounds_hold_at_both_ends_and_an_infinite_one_is_none(model):
    name = f"{model.robot.joint_names[0]}.viscous"
    between = ParameterBounds({name: (-1.0, 2.0)})
    for value, inside in ((-1.01, False), (-0.99, True), (1.99, True), (2.01, False)):
        assert (violation(between, model, viscous_1=value) <= 0.0) == inside
    above = ParameterBounds({name: (1.0, np.inf)})
    assert violation(above, model, viscous_1=1e9) <= 0.0
    assert violation(above, model, viscous_1=0.9) > 0.0
    one = ParameterBounds({name: (1.0, 1.0)})  # a value is a band without width
    assert violation(one, model, viscous_1=1.0) <= 0.0
    with pytest.raises(ProblemError, match="not below"):
        ParameterBounds({name: (1.0, 0.9)}).lower(model)
