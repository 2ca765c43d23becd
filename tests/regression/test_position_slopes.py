"""Slopes of the torque over positions: Pinocchio's derivatives, finite differences."""

import numpy as np
import pinocchio as pin
import pytest
from robots import random_robot, random_states, with_followers

from consistent_id import DriveTerms, TorqueModel
from consistent_id.regression.position_slopes import _rigid, position_slopes
from consistent_id.robot import Mimic


def derivatives(reference, q, dq, ddq):
    """Return the slopes by Pinocchio, shape (joints, joints)."""
    data = reference.createData()
    pin.computeRNEADerivatives(reference, data, q, dq, ddq)
    return data.dtau_dq.copy()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("tree", [False, True])
def test_slopes_are_pinocchio_s(seed, tree):
    reference, robot = random_robot(np.random.default_rng(seed), 6, tree)
    model, states = TorqueModel(robot), random_states(np.random.default_rng(9), 6, 3)
    found = position_slopes(model, robot.nominal, states, range(6))
    for s, state in enumerate(zip(*states, strict=True)):
        expected = derivatives(reference, *state)
        size = abs(expected).max()
        assert np.allclose(found[:, :, s], expected, rtol=0, atol=1e-11 * size)


def test_followers_add_up_in_what_leads_them():
    reference, robot = random_robot(np.random.default_rng(1), 4, True)
    robot = with_followers(robot, {"j3": Mimic("j1", -0.5)})
    G = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -0.5, 0]])
    states = random_states(np.random.default_rng(2), 3, 1)
    found = position_slopes(TorqueModel(robot), robot.nominal, states, [1, 2])
    expected = G.T @ derivatives(reference, *(G @ x[0] for x in states)) @ G
    assert np.allclose(
        found[:, :, 0], expected[:, 1:], atol=1e-11 * abs(expected).max()
    )


def test_drives_that_depend_on_position_and_load_have_slopes_too():
    _, robot = random_robot(np.random.default_rng(4), 4, False)
    drive = DriveTerms(
        coulomb="tanh", velocity_scale=0.1, spring=True, offset=True, load_friction=True
    )
    model = TorqueModel(robot, drive, load_reference=robot.nominal)
    x = np.append(robot.nominal, np.random.default_rng(5).uniform(1, 2, 4 * 4))
    q, dq, ddq = random_states(np.random.default_rng(6), 4, 5)
    found = position_slopes(model, x, (q, dq, ddq), [0, 3])
    for place, joint in enumerate((0, 3)):
        step = 1e-5 * (np.arange(4) == joint)
        ahead, behind = (model.predict(x, q + s, dq, ddq) for s in (step, -step))
        expected = (ahead - behind).T / 2e-5
        assert np.allclose(found[:, place], expected, atol=1e-6 * abs(expected).max())


def test_the_torque_of_rigid_bodies_beside_its_slopes_is_that_of_the_model():
    _, robot = random_robot(np.random.default_rng(8), 3)
    model = TorqueModel(robot)
    states = random_states(np.random.default_rng(9), 3, 4)
    torque, _ = _rigid(model, robot.nominal, [x.T for x in states], range(3))
    np.testing.assert_allclose(torque.T, model.predict(robot.nominal, *states))
