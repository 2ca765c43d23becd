"""Torque of robots with followers: virtual power of Pinocchio's full tree."""

import numpy as np
import pinocchio as pin
import pytest
from paths import random_path
from robots import random_body, random_robot, random_states, with_followers

from consistent_id import DriveTerms, ProblemError, TorqueModel
from consistent_id.motion.proofs.torque_bounds import torque_bounds
from consistent_id.regression import (
    base_parameters,
    casadi_regressor,
    joint_torque_regressor,
)
from consistent_id.regression.mass_matrix import mass_matrices
from consistent_id.regression.newton_euler import JointMotion, _joint_motions
from consistent_id.robot import Mimic
from consistent_id.robot.model import Transmission

RULES = {"j2": Mimic("j0", -0.5, 0.3), "j3": Mimic("j1", 2.0), "j5": Mimic("j0", 1.0)}
G = np.zeros((6, 3))  # of the coordinates j0, j1, j4
G[[0, 1, 4], range(3)] = 1.0
G[[2, 3, 5], [0, 1, 0]] = -0.5, 2.0, 1.0
OFFSETS = np.array([0.0, 0.0, 0.3, 0.0, 0.0, 0.0])


def _robots(seed, tree):
    reference, robot = random_robot(np.random.default_rng(seed), 6, tree)
    return reference, with_followers(robot, RULES)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("tree", [False, True])
def test_a_leader_feels_its_followers(seed, tree):
    reference, robot = _robots(seed, tree)
    data, states = reference.createData(), random_states(np.random.default_rng(9), 3, 4)
    Y = joint_torque_regressor(robot, *states)
    function = casadi_regressor(robot)
    for s, (q, dq, ddq) in enumerate(zip(*states, strict=True)):
        state = G @ q + OFFSETS, G @ dq, G @ ddq
        expected = G.T @ pin.computeJointTorqueRegressor(reference, data, *state)
        size = abs(expected).max()
        assert np.allclose(Y[:, :, s], expected, rtol=0, atol=1e-12 * size)
        found = function(q, dq, ddq).full()
        assert np.allclose(found, expected, rtol=0, atol=1e-12 * size)


def test_the_mass_matrix_is_that_of_the_coordinates():
    reference, robot = _robots(1, tree=True)
    data, q = reference.createData(), random_states(np.random.default_rng(3), 3, 2)[0]
    found = mass_matrices(TorqueModel(robot), robot.nominal, q)
    for M, position in zip(found, q, strict=True):
        full = np.triu(pin.crba(reference, data, G @ position + OFFSETS))
        full = full + np.triu(full, 1).T
        assert np.allclose(M, G.T @ full @ G, rtol=0, atol=1e-10 * abs(M).max())


def test_drive_terms_are_of_the_coordinates():
    _, robot = _robots(0, tree=False)
    model = TorqueModel(robot, DriveTerms(viscous=True))
    assert model.layout.names[60:] == ("j0.viscous", "j1.viscous", "j4.viscous")
    with pytest.raises(ProblemError, match=r"for 6 joints, but .* has 3"):
        TorqueModel(robot, (DriveTerms(),) * 6)
    with pytest.raises(ProblemError, match="no joint 'j2'"):
        TorqueModel(robot, torque_joints=("j0", "j2"))


def test_followers_belong_to_the_fingerprint():
    _, robot = _robots(0, tree=False)
    other = with_followers(robot, RULES | {"j5": Mimic("j0", 1.5)})
    assert TorqueModel(robot).fingerprint != TorqueModel(other).fingerprint


def test_base_parameters_span_the_torque_of_a_robot_with_followers():
    _, robot = _robots(2, tree=False)
    model = TorqueModel(robot)
    base = base_parameters(model)
    states = random_states(np.random.default_rng(5), 3, 40)
    W = np.concatenate(list(model.regressor(*states)), axis=1).T
    assert len(base) == np.linalg.matrix_rank(W, tol=1e-9 * np.linalg.norm(W, 2))
    x = random_body(np.random.default_rng(0)).vector
    x = np.tile(x, 6)
    through = W[:, list(base.independent)] @ (base.projection @ x)
    assert np.allclose(through, W @ x, rtol=0, atol=1e-9 * abs(W @ x).max())


def test_proven_torque_bounds_hold_with_followers():
    _, robot = _robots(1, tree=False)
    model = TorqueModel(robot)
    path = random_path(0, robot.joint_names, amplitude=0.1)
    bounds = torque_bounds(path, model, robot.nominal)
    time = np.linspace(path.start, path.start + path.duration, 4001)
    torque = model.predict(robot.nominal, *path.evaluate(time, 2))
    assert (abs(torque).max(axis=0) <= bounds.size).all()
    assert (abs(torque).max(axis=0) >= 0.99 * bounds.size).all()


def test_a_joint_moves_by_its_ratio_and_offset():
    q, dq, ddq = np.array([0.3, -0.7]), np.array([2.0, 5.0]), np.array([-1.0, 4.0])
    moves = [
        Transmission(0, 2.0, 0.0),
        Transmission(1, 1.0, 0.5),
        Transmission(0, 1.0, 0.0),
        Transmission(1, -0.5, 0.2),
    ]
    found = _joint_motions(moves, (q, dq, ddq), lambda x: (np.sin(x), np.cos(x)))
    for (k, ratio, offset), one in zip(moves, found, strict=True):
        angle = ratio * q[k] + offset
        assert one == JointMotion(
            angle, np.sin(angle), np.cos(angle), ratio * dq[k], ratio * ddq[k], k, ratio
        )
