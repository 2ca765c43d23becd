"""Scenes that no pose keeps are refused, with the pose in which bodies are farthest."""

import re

import numpy as np
import pytest

from consistent_id import DHRow, ProblemError, from_modified_dh
from consistent_id.motion import Body, Sphere, build_scene, plane
from consistent_id.motion.collisions.farthest import farthest_pose, random_poses
from consistent_id.motion.collisions.separation import nearest
from consistent_id.robot import JointLimits

WITHIN = JointLimits(-2.0, 2.0)
PLANAR = from_modified_dh(
    "planar", [DHRow(0, 0, limits=WITHIN), *[DHRow(0, 0.5, limits=WITHIN)] * 2]
)
UPRIGHT = from_modified_dh(
    "upright", [DHRow(0, 0, limits=WITHIN), DHRow(np.pi / 2, 0.0, limits=WITHIN)]
)


def _ball(link, radius=0.01, far=0.2, name=None):
    return Body(name or f"ball on {link}", Sphere(radius), link, None, [far, 0.0, 0.0])


def _numbers(pattern, said):
    return [float(found) for found in re.findall(pattern, said)]


@pytest.mark.slow
def test_the_farthest_pose_of_two_links_is_the_stretched_arm():
    scene = build_scene(PLANAR, [_ball("link1"), _ball("link3")])
    poses = random_poses(PLANAR, 20, 0)
    (pair,) = scene.pairs
    found = farthest_pose(scene, pair, poses, nearest(scene, poses).distance[:, 0])
    # Links of 0.5 m; the balls' centres are at 0.2 m, their radii are 0.01 m.
    assert found.distance == pytest.approx(0.3 + 0.5 + 0.2 - 0.02, abs=1e-6)
    assert found.pose[1:] == pytest.approx([0.0, 0.0], abs=1e-2)


@pytest.mark.slow
def test_a_stated_distance_that_no_pose_keeps_is_refused_with_the_largest_one():
    bodies = [_ball("link1"), _ball("link3")]
    with pytest.raises(ProblemError) as caught:
        build_scene(PLANAR, bodies, clearance=1.5, relax=False)
    said = str(caught.value)
    assert "a clearance of 1500 mm is stated" in said
    assert "'ball on link1' and 'ball on link3'" in said
    assert "largest distance found is 980.0 mm" in said
    # Only the joints between the bodies are named.
    assert "joint1" not in said
    pose = _numbers(r"joint[23] = (-?[\d.]+)", said)
    assert pose == pytest.approx([0.0, 0.0], abs=1e-2)
    (most,) = _numbers(r"State ([\d.]+) m or less", said)
    (pair,) = build_scene(PLANAR, bodies, clearance=most, relax=False).pairs
    assert pair.wanted == most == pytest.approx(0.975, abs=2e-3)


@pytest.mark.slow
def test_the_pair_that_lacks_most_is_named_and_others_are_counted():
    near = _ball("link3", far=-0.3, name="near")
    bodies = [_ball("link1"), _ball("link3"), near]
    with pytest.raises(ProblemError, match=r"'near' .*nor ball on link1 and ball on"):
        build_scene(PLANAR, bodies, clearance=1.5, relax=False)


def test_without_a_statement_a_distance_is_relaxed_and_noted():
    bodies = [_ball("link1"), _ball("link3")]
    scene = build_scene(PLANAR, bodies, clearance=1.5)
    assert scene.pairs[0].wanted == 0.0 and scene.notes[0].watched


def test_an_obstacle_keeps_a_stated_distance_or_is_refused():
    bodies = [plane(-0.1), _ball("link1")]
    (pair,) = build_scene(UPRIGHT, bodies, clearance=0.2).pairs
    assert pair.wanted == 0.0
    with pytest.raises(ProblemError, match=r"distance found is 90\.0 mm"):
        build_scene(UPRIGHT, bodies, clearance=0.2, relax=False)


def test_a_floor_that_always_touches_is_refused_with_a_height_that_does_not():
    """The shoulder's ball of 0.01 m at height zero, a floor at 0.6 m."""
    bodies = [_ball("link1"), _ball("link2")]
    with pytest.raises(ProblemError) as caught:
        build_scene(UPRIGHT, [plane(0.6), *bodies], clearance=0.02)
    said = str(caught.value)
    assert "'ground' and 'ball on link1' apart (nor ground and ball on link2)" in said
    assert "penetrate each other by 610.0 mm" in said and "joint1 = " in said
    (height,) = _numbers(r"--ground (-?[\d.]+) or less", said)
    assert height == pytest.approx(-0.034, abs=1e-9)  # 10, 20 and 4 mm
    scene = build_scene(UPRIGHT, [plane(height), *bodies], clearance=0.02)
    assert {pair.wanted for pair in scene.pairs} == {0.02}


def test_an_obstacle_that_a_few_poses_avoid_is_no_reason_to_refuse():
    """Only within 0.002 rad of one direction does the ball stay clear of the wall."""
    wall = plane(0.2 * np.cos(0.002) - 0.01, (0.8, 0.6, 0.0), "wall")
    bodies = [wall, _ball("link1")]
    scene = build_scene(UPRIGHT, bodies)
    assert (nearest(scene, random_poses(UPRIGHT, 200, 0)).distance <= 0.0).all()
    assert [scene.names(pair) for pair in scene.pairs] == [("wall", "ball on link1")]
