"""Every robot of the package example-robot-data, if it is there, against Pinocchio."""

from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from published_robots import FILES, NO_ROBOTS, leaderless
from some_fast import some_fast

from consistent_id import ModelError, TorqueModel
from consistent_id.robot import load_urdf

_DEFAULTS = {"multiplier": 1.0, "offset": 0.0}

pytestmark = pytest.mark.skipif(not FILES, reason="example-robot-data is missing")


def leaders_to_joints(path, model):
    """``G`` and ``b`` of ``q_joints = G q + b``, read from the text of the file."""
    rules = {}
    for joint in ElementTree.parse(path).iter("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            numbers = (float(mimic.get(k, d)) for k, d in _DEFAULTS.items())
            rules[joint.get("name")] = (mimic.get("joint"), *numbers)
    names = list(model.names)[1:]
    driven = [name for name in names if name not in rules]
    G, b = np.zeros((len(names), len(driven))), np.zeros(len(names))
    for row, name in enumerate(names):
        ratio = 1.0
        while name in rules:
            name, multiplier, offset = rules[name]
            b[row] += ratio * offset
            ratio *= multiplier
        G[row, driven.index(name)] = ratio
    return G, b


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", some_fast(FILES, len(FILES) // 6), ids=lambda path: path.stem
)
def test_its_torque_is_pinocchios(path):
    if path.name in NO_ROBOTS:
        with pytest.raises(ModelError, match=r"no moving joint|no <link>"):
            load_urdf(path)
        return
    lost = leaderless(path)
    robot = load_urdf(path, locked=dict.fromkeys(lost, 0.0))
    model = pin.buildModelFromUrdf(str(path))
    neutral, places = pin.neutral(model), [model.getJointId(name) for name in lost]
    model = pin.buildReducedModel(model, places, neutral) if lost else model
    assert tuple(joint.name for joint in robot.joints) == tuple(model.names)[1:]
    states = np.random.default_rng(0).uniform(-1.5, 1.5, (3, 3, len(robot)))
    torques = TorqueModel(robot).predict(robot.nominal, *states)
    data, (G, b) = model.createData(), leaders_to_joints(path, model)
    for torque, q, dq, ddq in zip(torques, *states, strict=True):
        parts = [
            [np.cos(x), np.sin(x)] if joint.nq == 2 else [x]
            for x, joint in zip(G @ q + b, list(model.joints)[1:], strict=True)
        ]
        # By virtual power a leader feels its followers' torques, times their ratios.
        expected = G.T @ pin.rnea(model, data, np.concatenate(parts), G @ dq, G @ ddq)
        # Rotations within 1e-10 of a right angle are taken for right angles.
        assert np.allclose(torque, expected, rtol=0, atol=2e-10 * abs(expected).max())
