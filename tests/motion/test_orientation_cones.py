"""Cones for a direction of the robot: exact, and proven for all times."""

import numpy as np
import pinocchio as pin
import pytest
from differences import central_differences
from some_fast import some_fast

from consistent_id import DHRow, ProblemError, from_modified_dh
from consistent_id.motion import (
    Body,
    Capsule,
    OrientationCone,
    build_scene,
    prove_clearance,
    within_cones,
)
from consistent_id.motion.collisions.separation import nearest
from consistent_id.recordings import FourierTrajectory

ROWS = [(0, 0, False), (-np.pi / 2, 0, False), (0.4, 0.5, True), (0.7, 0.3, False)]
KIND = {True: "prismatic", False: "revolute"}
ARM = from_modified_dh("arm", [DHRow(a, b, kind=KIND[p]) for a, b, p in ROWS])
ROD = Body("rod", Capsule(0.05, 0.4), "link2", None, [0.25, 0.0, 0.0])
DIRECTION, AXIS = np.array([0.4, -1.0, 2.0]), np.array([0.5, 0.2, -1.0])


def _angles(q):
    """Angles between direction and axis, by products of rotations."""
    angles = []
    for pose in q:
        turned = np.eye(3)
        for value, (alpha, _, slides) in zip(pose, ROWS, strict=True):
            turned = turned @ pin.utils.rotate("x", alpha)
            turned = turned if slides else turned @ pin.utils.rotate("z", value)
        along = (turned @ DIRECTION) @ AXIS
        sizes = np.linalg.norm(DIRECTION) * np.linalg.norm(AXIS)
        angles.append(np.arccos(along / sizes))
    return np.array(angles)


def _scene(angle):
    cone = OrientationCone("link4", angle, AXIS, DIRECTION)
    return within_cones(build_scene(ARM, [ROD]), [cone])


@pytest.mark.parametrize("angle", np.radians([5.0, 40.0, 90.0, 140.0]))
def test_slack_is_of_cosines_and_at_the_edge_the_angle_that_is_left(angle):
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (40, 4))
    scene, true = _scene(angle), _angles(q)
    slack = nearest(scene, q).slack[:, -1]
    expected = (np.cos(true) - np.cos(angle)) / np.sin(angle)
    np.testing.assert_allclose(slack, expected, atol=1e-9)
    edge = _scene(true[0] + 1e-4)
    assert nearest(edge, q[:1]).slack[0, -1] == pytest.approx(1e-4, rel=1e-3)


def test_slopes_are_those_of_finite_differences():
    scene = _scene(0.6)
    q = np.random.default_rng(1).uniform(-2.0, 2.0, 4)
    found = nearest(scene, [q]).gradient[0, -1]
    known = central_differences(lambda x: nearest(scene, [x]).distance[0, -1:], q)
    np.testing.assert_allclose(found, np.ravel(known), atol=1e-6)
    assert found[2] == 0.0  # it slides, which turns nothing


@pytest.mark.slow
@pytest.mark.parametrize("seed", some_fast(range(3), 2))
def test_a_path_is_proven_to_stay_in_the_cone_or_seen_to_leave(seed):
    rng = np.random.default_rng(seed)
    sine, cosine = rng.uniform(-0.3, 0.3, (2, 2, 4))
    path = FourierTrajectory(
        ARM.joint_names, [0.5, 1.0], rng.uniform(-1, 1, 4), sine, cosine, 2.0
    )
    q = path.evaluate(np.linspace(0.0, 2.0, 4001), 0)[0]
    widest = _angles(q).max()
    room = 2e-3
    kept = prove_clearance(_scene(widest + room), path)
    assert kept.holds
    # What is proven is no more than what dense samples show.
    slack = (np.cos(widest) - np.cos(widest + room)) / np.sin(widest + room)
    assert 0.0 <= kept.proven <= slack + 1e-9
    left = prove_clearance(_scene(widest - room), path)
    assert left.violated and left.first == "direction of link4"
    assert left.distance == pytest.approx(-room, rel=0.05)


def test_faults_are_named():
    with pytest.raises(ProblemError, match="axis is zero"):
        OrientationCone("link4", 1.0, [0, 0, 0])
    with pytest.raises(ProblemError, match="angle is 180 degrees, expected 1 to 179"):
        OrientationCone("link4", np.pi)
    place = Body("place", Capsule(0.1, 0.1), "link2")
    way = Body("way", Capsule(0.1, 0.1), turning=True)
    with pytest.raises(
        ProblemError, match="a direction and a position have no distance"
    ):
        build_scene(ARM, [place, way])
