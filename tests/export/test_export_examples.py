"""Robots of the package example-robot-data, if it is there, with other bodies."""

from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from estimates import FRICTION, estimate_of
from published_robots import FILES, NO_ROBOTS, leaderless
from robots import random_body
from urdf_torques import assert_same_torque

from consistent_id import TorqueModel, to_urdf
from consistent_id.motion.collisions import urdf_bodies
from consistent_id.repair import repair_urdf
from consistent_id.robot import load_urdf

SOME = [path for path in FILES[::5] if path.name not in NO_ROBOTS]

pytestmark = pytest.mark.skipif(not FILES, reason="example-robot-data is missing")


@pytest.fixture(autouse=True, scope="module")
def _meshes_read_once():
    """Several robots, and several links of one, have the same meshes."""
    with pytest.MonkeyPatch.context() as patch:
        read = lru_cache(maxsize=64)(urdf_bodies.mesh_triangles)
        patch.setattr(urdf_bodies, "mesh_triangles", read)
        yield


@pytest.mark.slow
@pytest.mark.parametrize("path", SOME, ids=lambda path: path.stem)
def test_its_urdf_takes_other_bodies(path):
    locked = dict.fromkeys(leaderless(path), 0.0)
    robot = load_urdf(path, locked=locked)
    more = random_body(np.random.default_rng(0))
    model = TorqueModel(robot, FRICTION)
    bodies = [link.nominal + more for link in robot.links]
    estimate = estimate_of(model, bodies, 1.5)
    content = to_urdf(estimate, path, allow_refused=True).content
    if len(robot) == len(robot.joints) and not locked:  # Pinocchio's all move
        # Rotations within 1e-10 of a right angle are taken for right angles.
        assert_same_torque(content, estimate, tolerance=1e-9)
    for element in (b"<visual>", b"<collision>", b"<!--", b"<transmission", b"<gazebo"):
        added = element == b"<!--"
        assert content.count(element) == path.read_bytes().count(element) + added


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_repaired_it_has_bodies_only(path):
    repair = repair_urdf(path)
    if repair.refused:  # several mistakes explain it; any of them will do here
        assert all(link.suggestions for link in repair.refused)
        choices = {link.link: 1 for link in repair.refused}
        repair = repair_urdf(path, choices=choices)
    assert not repair.refused
    assert (repair.content == repair.original) == (not repair.repaired)
    if repair.repaired:
        before, after = (
            pin.buildModelFromXML(text.decode())
            for text in (repair.original, repair.content)
        )
        assert before.names.tolist() == after.names.tolist()
        masses = [[body.mass for body in m.inertias] for m in (before, after)]
        assert np.allclose(*masses, rtol=1e-12)
