"""A scene in which no pose is clear is refused, with two bodies and a pose."""

import re

import numpy as np
import pytest

from consistent_id import InfeasibleError
from consistent_id.excitation import clear_poses
from consistent_id.excitation.clear_poses import (
    cleared,
    poses_apart,
    worst_excess,
)
from consistent_id.excitation.verification import demands
from consistent_id.excitation.work import Meter
from consistent_id.motion import Body, Box, Sphere, build_scene, motion_limits
from consistent_id.motion.collisions.separation import nearest
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.loaders.dh import DHRow, from_modified_dh
from consistent_id.robot.model import JointLimits

WITHIN = JointLimits(-1.0, 1.0, 2.0, 50.0)
ARM = from_modified_dh(
    "arm", [DHRow(0, 0, limits=WITHIN), DHRow(0, 0.5, limits=WITHIN)]
)
UPPER = Body("upper", Box((0.4, 0.05, 0.05)), "link1", None, [0.25, 0.0, 0.0])
FORE = Body("forearm", Box((0.4, 0.05, 0.05)), "link2", None, [0.25, 0.0, 0.0])


def _demands(*obstacles):
    scene = build_scene(ARM, [UPPER, FORE, *obstacles], clearance=0.02)
    limits = motion_limits(ARM, acceleration=5.0)
    return demands(TorqueModel(ARM), limits, scene=scene)


def _post(angle, far, radius, name="post"):
    at = [far * np.cos(angle), far * np.sin(angle), 0.0]
    return Body(name, Sphere(radius), None, None, at)


def _ring(gap):
    """Posts around the shoulder, all but in a gap of so many rad about -0.7."""
    angles = np.arange(-1.2, 1.3, 0.12)
    return [
        Body(
            f"post{k}", Sphere(0.03), None, None, [0.3 * np.cos(a), 0.3 * np.sin(a), 0]
        )
        for k, a in enumerate(angles)
        if abs(a + 0.7) > gap
    ]


@pytest.mark.slow
def test_no_clear_pose_is_refused_with_the_bodies_and_the_pose():
    required = _demands(*_ring(0.0))
    with pytest.raises(InfeasibleError, match="no pose was found") as caught:
        clear_poses.clear_poses(required)
    said = str(caught.value)
    assert "'upper'" in said and "'post" in said and "20.0 mm" in said
    pose = [float(found) for found in re.findall(r"joint\d = (-?[\d.]+)", said)]
    near = nearest(required.scene, [pose])
    found = {frozenset(required.scene.names(p)): k for k, p in enumerate(near.pairs)}
    two = re.search(
        r"bodies '(\w+)' and '(\w+)' penetrate each other by ([\d.]+)", said
    )
    depth = -1e3 * near.distance[0, found[frozenset(two.groups()[:2])]]
    assert depth == pytest.approx(float(two[3]), abs=0.3)  # the pose has three digits
    assert near.distance.min() == pytest.approx(-1e-3 * depth, abs=1e-3)


@pytest.mark.slow
def test_a_pose_is_found_in_a_narrow_gap():
    """Only where the upper arm points into the gap: 4 % of the shoulder's range."""
    required = _demands(*_ring(0.28))
    found = poses_apart(required, required.scene)
    assert nearest(required.scene, found).slack.min() >= 0.0
    guards = [guard for guard in required.guards if guard.keeps_apart]
    low, high = required.limits.lower, required.limits.upper
    rng = np.random.default_rng(3)
    poses = np.column_stack([rng.uniform(-0.6, -0.5, 30), rng.uniform(-1, 1, 30)])
    worst = worst_excess(poses, guards)
    assert (worst > 0.0).all()
    best = cleared(poses, worst, guards, low, high)[0]
    assert nearest(required.scene, best[None]).slack.min() >= 0.0
    assert abs(best[0] + 0.7) < 0.1


def test_one_post_beside_the_arm_is_no_obstacle():
    required = _demands(_post(0.0, 0.6, 0.05))
    assert len(poses_apart(required, required.scene)) > 50


def test_a_pose_that_no_step_betters_is_given_up(monkeypatch):
    """Between two limits that contradict each other, steps go to and fro."""
    looked = []

    def between(pose, guards):
        looked.append(float(pose[0]))
        return np.array([0.5 - pose[0], 0.5 + pose[0]]), np.array([[-1.0], [1.0]])

    monkeypatch.setattr(clear_poses, "_violations", between)
    low, high = -np.ones(1), np.ones(1)
    pose = clear_poses._moved(np.zeros(1), (), low, high, None)
    assert pose == 0.0 and len(looked) == 1 + clear_poses._STALLED < clear_poses._STEPS


@pytest.mark.parametrize("obstacles", [[], [_post(0.0, 0.6, 0.05)]])
def test_bodies_alone_are_not_searched_for_where_clear_poses_are_known(
    obstacles, monkeypatch
):
    monkeypatch.setattr(clear_poses, "poses_apart", None)
    required = _demands(*obstacles)
    poses = clear_poses.clear_poses(required)
    assert (poses is None) == (not obstacles)
    if poses is not None:
        assert worst_excess(poses, required.guards).max() <= 0.0


@pytest.mark.slow
def test_a_scene_is_refused_before_its_torque_is_searched(monkeypatch):
    required, moved = _demands(*_ring(0.0)), []

    def seen(poses, worst, guards, *others):
        moved.append([guard.keeps_apart for guard in guards])
        return cleared(poses, worst, guards, *others)

    monkeypatch.setattr(clear_poses, "cleared", seen)
    with pytest.raises(InfeasibleError, match="no pose was found"):
        clear_poses.clear_poses(required)
    assert moved == [[True]]


def test_the_work_of_poses_is_counted():
    guards, meter = _demands(_post(0.0, 0.6, 0.05)).guards, Meter()
    one = sum(guard.seconds for guard in guards)
    worst = worst_excess(np.zeros((7, 2)), guards, meter)
    assert meter.spent == pytest.approx(7 * one)
    low, high = -np.ones(2), np.ones(2)
    cleared(np.zeros((1, 2)), worst[:1], guards, low, high, meter)
    assert meter.spent >= 9 * one
