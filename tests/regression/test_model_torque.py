"""Torque of known parameters: Pinocchio's, and that of the regressor."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from published_robots import FILES
from robots import random_robot, random_states

from consistent_id import DriveTerms, TorqueModel
from consistent_id.recordings import BaseMotion
from consistent_id.regression import GearCoupling
from consistent_id.regression.row_names import BASE_ROWS
from consistent_id.robot import load_urdf

DRIVE = DriveTerms(
    viscous=True,
    coulomb="sign",
    offset=True,
    rotor_inertia=True,
    spring=True,
    load_friction=True,
)


@pytest.mark.parametrize("seed", range(4))
def test_torque_of_bodies_is_that_of_pinocchio(seed):
    rng = np.random.default_rng(seed)
    reference, robot = random_robot(rng, 6, tree=bool(seed % 2))
    states, data = random_states(rng, 6, 9), reference.createData()
    model = TorqueModel(robot)
    torque = model.rigid_torque(robot.nominal, states)
    at_rest = model.rigid_torque(robot.nominal, (states[0], None, None))
    for n, (q, dq, ddq) in enumerate(zip(*states, strict=True)):
        expected = pin.rnea(reference, data, q, dq, ddq)
        np.testing.assert_allclose(torque[n], expected, rtol=0, atol=1e-10)
        expected = pin.computeGeneralizedGravity(reference, data, q)
        np.testing.assert_allclose(at_rest[n], expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("samples", [0, 1, 5000])
def test_prediction_is_what_the_regressor_says(samples):
    rng = np.random.default_rng(0)
    _, robot = random_robot(rng, 5, tree=True)
    names = robot.joint_names
    model = TorqueModel(
        robot,
        DRIVE,
        (GearCoupling(names[3], names[4], rotor_inertia=True),)
        if robot.joints[3].kind == robot.joints[4].kind
        else (),
        torque_joints=names[1:],
    )
    x, states = rng.normal(size=len(model.layout)), random_states(rng, 5, samples)
    expected = np.einsum("jps,p->sj", model.regressor(*states), x)
    found = model.predict(x, *states)
    assert found.shape == (samples, 4)
    np.testing.assert_allclose(
        found, expected, rtol=0, atol=1e-12 * abs(expected).max(initial=1.0)
    )


@pytest.mark.skipif(not FILES, reason="example-robot-data is missing")
def test_prediction_of_a_floating_base_and_of_its_biased_sensor():
    path = next(path for path in FILES if path.stem == "go2")
    robot = load_urdf(path, base="floating")
    rows = (*BASE_ROWS, *robot.joint_names[::2])
    model = TorqueModel(robot, DRIVE, torque_joints=rows, wrench_bias=True)
    rng = np.random.default_rng(0)
    states, x = random_states(rng, len(robot), 30), rng.normal(size=len(model.layout))
    base = BaseMotion(*rng.normal(size=(3, 30, 3)))
    Y = model.regressor(*states, base=base)
    expected = np.einsum("jps,p->sj", Y, x)
    found = model.predict(x, *states, base=base)
    np.testing.assert_allclose(
        found, expected, rtol=0, atol=1e-11 * abs(expected).max()
    )


def test_gravity_torque_is_linear_in_gravity():
    rng = np.random.default_rng(1)
    _, robot = random_robot(rng, 4)
    q, whole = rng.normal(size=(7, 4)), 0.0
    for g, axis in zip((1.0, -2.0, 3.0), np.eye(3), strict=True):
        model = TorqueModel(replace(robot, gravity=axis))
        whole = whole + g * model.rigid_torque(robot.nominal, (q, None, None))
    turned = TorqueModel(replace(robot, gravity=np.array([1.0, -2.0, 3.0])))
    expected = turned.rigid_torque(robot.nominal, (q, None, None))
    np.testing.assert_allclose(whole, expected, rtol=0, atol=1e-12)
