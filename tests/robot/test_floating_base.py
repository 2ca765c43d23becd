"""Robots whose base floats, against Pinocchio's free flyer."""

import numpy as np
import pinocchio as pin
import pytest
from published_robots import FILES, leaderless
from some_fast import some_fast

from consistent_id import ModelError, TorqueModel
from consistent_id.recordings import BaseMotion
from consistent_id.robot import chains, load_urdf
from consistent_id.robot.loaders import urdf

PATHS = pytest.mark.parametrize(
    "path", some_fast(FILES, len(FILES) // 6), ids=lambda path: path.stem
)

pytestmark = pytest.mark.skipif(not FILES, reason="example-robot-data is missing")


def of_both(path):
    """The robot, Pinocchio's model of it, and the rates of its joints by those of ours.

    Joints that follow none are at zero in both.
    """
    lost = leaderless(path)
    robot = load_urdf(path, base="floating", locked=dict.fromkeys(lost, 0.0))
    model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    places = [model.getJointId(name) for name in lost]
    if lost:
        model = pin.buildReducedModel(model, places, pin.neutral(model))
    return robot, model


def pinocchios_regressor(robot, model, base_twist, base_acceleration, state):
    """Pinocchio's joint torque regressor at a level base, followers' rows added up."""
    G = robot.joint_rates[1:]
    q, dq, ddq = state
    positions = robot.joint_positions(q[None])[0, 1:]
    parts = [
        [np.cos(x), np.sin(x)] if joint.nq == 2 else [x]
        for x, joint in zip(positions, list(model.joints)[2:], strict=True)
    ]
    whole = np.concatenate([np.zeros(6), [1.0], *parts])
    v = np.concatenate([base_twist, G @ dq])
    a = np.concatenate([base_acceleration, G @ ddq])
    Y = pin.computeJointTorqueRegressor(model, model.createData(), whole, v, a)
    return np.vstack([Y[:6], G.T @ Y[6:]])


@pytest.mark.slow
@PATHS
def test_its_regressor_is_pinocchios_with_a_free_flyer(path, monkeypatch):
    # As loaded, rotations within 1e-10 of a right angle are taken for right angles.
    for module in (urdf, chains):
        monkeypatch.setattr(module, "snapped", np.asarray)
    try:
        robot, model = of_both(path)
    except ModelError as error:
        assert "no <link>" in str(error)
        return
    rng = np.random.default_rng(0)
    n = len(robot)
    for _ in range(2):
        twist, push = rng.uniform(-2.0, 2.0, (2, 6))
        state = rng.uniform(-1.5, 1.5, (3, n))
        expected = pinocchios_regressor(robot, model, twist, push, state)
        # Pinocchio's is the spatial acceleration; that of a point adds w x v.
        v, w = twist[:3], twist[3:]
        felt = push[:3] + np.cross(w, v) - robot.gravity
        base = BaseMotion(w[None], push[None, 3:], felt[None])
        found = TorqueModel(robot).regressor(*state[:, None], base=base)[:, :, 0]
        worst = abs(found - expected).max() / abs(expected).max()
        assert worst < 1e-10


@PATHS
def test_its_nominal_bodies_are_pinocchios(path):
    try:
        robot, model = of_both(path)
    except ModelError:
        return
    expected = np.concatenate(
        [b.toDynamicParameters() for b in list(model.inertias)[1:]]
    )
    assert np.allclose(robot.nominal, expected, rtol=0, atol=1e-12)
