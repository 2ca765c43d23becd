"""Placements are Pinocchio's."""

import numpy as np
import pinocchio as pin
import pytest
from robots import URDF, random_robot

from consistent_id import ModelError
from consistent_id.robot import load_urdf
from consistent_id.robot.kinematics import fixed_place, frame_places, link_places


@pytest.mark.parametrize("tree", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_links_are_where_pinocchio_has_them(seed, tree):
    rng = np.random.default_rng(seed)
    model, robot = random_robot(rng, 6, tree)
    data, q = model.createData(), rng.uniform(-3.0, 3.0, (5, 6))
    places = link_places(robot, q)
    for i, pose in enumerate(q):
        pin.forwardKinematics(model, data, pose)
        for k in range(6):
            expected = data.oMi[k + 1]
            assert np.allclose(places.rotation[i, k], expected.rotation, atol=1e-12)
            assert np.allclose(
                places.translation[i, k], expected.translation, atol=1e-12
            )


def test_a_tool_is_where_pinocchio_has_its_frame(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(URDF)
    robot, model = load_urdf(path), pin.buildModelFromXML(URDF)
    data, q = model.createData(), np.array([0.3, 0.2, -1.1])
    pin.framesForwardKinematics(
        model, data, np.array([*q[:2], np.cos(q[2]), np.sin(q[2])])
    )
    for name in ("base", "one", "two", "tool", "three"):
        found = frame_places(robot, name, [q])
        expected = data.oMf[model.getFrameId(name)]
        assert np.allclose(found.rotation[0], expected.rotation, atol=1e-12)
        assert np.allclose(found.translation[0], expected.translation, atol=1e-12)


def test_an_unknown_frame_is_named(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(URDF)
    with pytest.raises(ModelError, match="no link named 'tol'"):
        fixed_place(load_urdf(path), "tol")
