"""Boxes for a point of the robot: exact, and of that point alone."""

import numpy as np
import pinocchio as pin
import pytest

from consistent_id import (
    DHRow,
    InfeasibleError,
    ModelError,
    ProblemError,
    from_modified_dh,
)
from consistent_id.motion import (
    Body,
    Capsule,
    Workspace,
    build_scene,
    prove_clearance,
    within_workspaces,
)
from consistent_id.motion.collisions.separation import nearest
from consistent_id.recordings import FourierTrajectory

ARM = from_modified_dh("arm", [DHRow(0, 0), DHRow(-np.pi / 2, 0), DHRow(0, 0.5)])
ROD = Body("rod", Capsule(0.05, 0.4), "link2", None, [0.25, 0.0, 0.0])
POINT = np.array([0.4, 0.1, -0.05])


def _tip(q):
    """Where the point is, by products of Denavit and Hartenberg's matrices."""
    place = pin.SE3.Identity()
    for angle, (alpha, a) in zip(q, [(0, 0), (-np.pi / 2, 0), (0, 0.5)], strict=True):
        turned = pin.SE3(pin.utils.rotate("x", alpha), np.zeros(3))
        moved = pin.SE3(np.eye(3), np.array([a, 0.0, 0.0]))
        joint = pin.SE3(pin.utils.rotate("z", angle), np.zeros(3))
        place = place * turned * moved * joint
    return place.act(POINT)


def _scene(low, high):
    return within_workspaces(
        build_scene(ARM, [ROD]), [Workspace("link3", low, high, POINT)]
    )


@pytest.mark.parametrize("seed", range(3))
def test_slack_is_the_distance_of_the_point_from_each_face(seed):
    rng = np.random.default_rng(seed)
    low, high = np.array([-0.5, -np.inf, 0.1]), np.array([0.9, 0.3, np.inf])
    scene = _scene(low, high)
    q = rng.uniform(-2.0, 2.0, (20, 3))
    tips = np.array([_tip(one) for one in q])
    found = nearest(scene, q)
    slack = {scene.names(p)[1]: found.slack[:, k] for k, p in enumerate(scene.pairs)}
    expected = {
        "low x of link3": tips[:, 0] + 0.5,
        "high x of link3": 0.9 - tips[:, 0],
        "high y of link3": 0.3 - tips[:, 1],
        "low z of link3": tips[:, 2] - 0.1,
    }
    assert set(slack) == set(expected)
    for name, distance in expected.items():
        np.testing.assert_allclose(slack[name], distance, atol=1e-9)


@pytest.mark.slow
def test_a_path_is_proven_to_stay_in_the_box_or_named_where_it_leaves():
    """All joints swing together; the box is that of the dense samples, and a bit."""
    swing = np.array([[0.5, 0.4, -0.6]])
    path = FourierTrajectory(
        ARM.joint_names, [0.5], [0.2, -0.3, 0.4], swing, 0.0 * swing, 2.0
    )
    time = np.linspace(0.0, 2.0, 4001)
    tips = np.array([_tip(q) for q in path.evaluate(time, 0)[0]])
    room = 2e-3
    kept = _scene(tips.min(axis=0) - room, tips.max(axis=0) + room)
    assert prove_clearance(kept, path).holds
    left = _scene(tips.min(axis=0) - room, tips.max(axis=0) - [room, -room, -room])
    report = prove_clearance(left, path)
    assert report.violated and report.second == "high x of link3"
    assert report.distance == pytest.approx(-room, abs=1e-5)
    with pytest.raises(InfeasibleError, match="high x of link3"):
        report.require()


def test_faults_are_named():
    with pytest.raises(ProblemError, match="is not below high"):
        Workspace("link3", [0, 0, 0], [1, 0, 1])
    scene = build_scene(ARM, [ROD])
    with pytest.raises(ModelError, match="no link named 'tool'"):
        within_workspaces(scene, [Workspace("tool", [0, 0, 0], [1, 1, 1])])
