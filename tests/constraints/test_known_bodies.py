"""Bodies that are known, motors of one type, friction that varies with position."""

import numpy as np
import pytest
from robots import random_robot

from consistent_id import DriveTerms, ProblemError, TorqueModel
from consistent_id.constraints import EqualMotors, FixedBodies, NonNegativeDrive
from consistent_id.robot import JointLimits

SLOPED = DriveTerms(
    viscous=True, coulomb="tanh", velocity_scale=0.1, friction_slope=True
)


def limited(robot, low=-2.0, high=-0.5):
    from dataclasses import replace

    joints = tuple(
        replace(j, kind="revolute", limits=JointLimits(low, high, 9.0, 9.0))
        for j in robot.joints
    )
    return replace(robot, joints=joints)


@pytest.fixture
def robot():
    return random_robot(np.random.default_rng(2), 3)[1]


def test_known_bodies_leave_the_drives_alone(robot):
    model = TorqueModel(robot, DriveTerms(viscous=True))
    known = FixedBodies().lower(model)
    drives = np.array([3.0, -7.0, 11.0])
    assert known.violation(np.append(robot.nominal, drives)) < 1e-15
    off = robot.nominal.copy()
    off[14] += 0.1
    assert known.violation(np.append(off, drives)) > 0.0


def test_motors_of_one_type_have_one_rotor_inertia(robot):
    model = TorqueModel(robot, DriveTerms(viscous=True, rotor_inertia=True))
    alike = EqualMotors(robot.joint_names).lower(model)
    x = np.append(robot.nominal, [1.0, 0.3, 2.0, 0.3, 3.0, 0.3])
    assert alike.violation(x) == 0.0
    x[-1] = 0.4
    assert alike.violation(x) > 0.0


@pytest.mark.parametrize(
    ("joints", "said"),
    [(("j0",), "two or more"), (("j0", "j9"), "'j9' has no drive term rotor_inertia")],
)
def test_motors_that_are_not_there_are_refused(robot, joints, said):
    model = TorqueModel(robot, DriveTerms(rotor_inertia=True))
    with pytest.raises(ProblemError, match=said):
        EqualMotors(joints).lower(model)


def test_friction_that_varies_dissipates_between_the_limits(robot):
    model = TorqueModel(limited(robot), SLOPED)
    signs = NonNegativeDrive().lower(model)
    zeros = np.zeros(model.layout.inertial_size)
    # viscous, coulomb, slope: at q = 0, outside of the limits, the level is negative.
    fine, rising = np.tile([0.1, -0.2, -0.5], 3), np.tile([0.1, 0.9, 0.5], 3)
    assert signs.violation(np.append(zeros, fine)) <= 0.0  # 0.05 to 0.8
    assert signs.violation(np.append(zeros, rising)) > 0.0  # -0.1 to 0.65
    states = np.linspace(-2.0, -0.5, 7)
    power = [
        np.dot(SLOPED.columns(q, dq, 0.0), fine[:3]) * dq
        for q in states
        for dq in (-1.0, 1.0)
    ]
    assert min(power) > 0.0


def test_friction_that_varies_without_end_is_refused(robot):
    model = TorqueModel(limited(robot, -np.inf, np.inf), SLOPED)
    with pytest.raises(ProblemError, match="no limits"):
        NonNegativeDrive().lower(model)


def test_the_slope_is_a_term_in_position_and_direction():
    q, dq = np.array([0.5, -2.0, 1.0]), np.array([0.3, -0.2, 0.0])
    column = SLOPED.columns(q, dq, 0 * q)[-1]
    np.testing.assert_allclose(column, np.tanh(dq / 0.1) * q)
    assert SLOPED.names[-1] == "friction_slope"
