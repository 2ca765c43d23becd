"""Every robot of the package example-robot-data, if it is there, against Pinocchio."""

import numpy as np
import pinocchio as pin
import pytest
from published_robots import FILES, NO_ROBOTS, mimics_of

from consistent_id import ModelError, TorqueModel, load_urdf

pytestmark = pytest.mark.skipif(not FILES, reason="example-robot-data is missing")


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_its_torque_is_pinocchios(path):
    if path.name in NO_ROBOTS:
        with pytest.raises(ModelError, match=r"no moving joint|no <link>"):
            load_urdf(path)
        return
    mimics = mimics_of(path)
    robot = load_urdf(path, locked=dict.fromkeys(mimics, 0.0))
    model = pin.buildModelFromUrdf(str(path))
    neutral, places = pin.neutral(model), [model.getJointId(name) for name in mimics]
    model = pin.buildReducedModel(model, places, neutral) if mimics else model
    assert robot.joint_names == tuple(model.names)[1:]
    q, dq, ddq = np.random.default_rng(0).uniform(-1.5, 1.5, (3, 3, model.nv))
    torques = TorqueModel(robot).predict(robot.nominal, q, dq, ddq)
    data = model.createData()
    for torque, *state in zip(torques, q, dq, ddq, strict=True):
        parts = [
            [np.cos(x), np.sin(x)] if joint.nq == 2 else [x]
            for x, joint in zip(state[0], list(model.joints)[1:], strict=True)
        ]
        expected = pin.rnea(model, data, np.concatenate(parts), *state[1:])
        # Rotations within 1e-10 of a right angle are taken for right angles.
        assert np.allclose(torque, expected, rtol=0, atol=2e-10 * abs(expected).max())
