"""What is proven of clearance is true at every time."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import random_scene

from consistent_id import DHRow, InfeasibleError, ProblemError, from_modified_dh
from consistent_id.motion import Body, Box, Sphere, build_scene, plane, prove_clearance
from consistent_id.motion.collisions.scene import body_places, largest_change
from consistent_id.motion.collisions.separation import nearest
from consistent_id.recordings.joint_paths import FourierTrajectory
from consistent_id.robot.kinematics import link_places

PENDULUM = from_modified_dh("pendulum", [DHRow(0, 0)])
TIP = Body("tip", Sphere(0.1), "link1", translation=[1.0, 0.0, 0.0])
POST = Body("post", Sphere(0.2), translation=[0.0, 2.0, 0.0])


def _swing(amplitude, frequency=0.5):
    return FourierTrajectory(
        ("joint1",), [frequency], [0.0], [[amplitude]], [[0.0]], 1.0 / frequency
    )


@pytest.mark.parametrize("amplitude", [0.3, 1.0, 1.5])
def test_a_swing_towards_a_post_is_proven_to_within_the_tolerance(amplitude):
    scene = build_scene(PENDULUM, [TIP, POST])
    truth = np.hypot(np.cos(amplitude), 2.0 - np.sin(amplitude)) - 0.3
    for tolerance in (1e-2, 1e-4):
        report = prove_clearance(scene, _swing(amplitude), tolerance=tolerance)
        assert report.holds and (report.first, report.second) == ("tip", "post")
        assert truth - tolerance - 1e-8 <= report.proven <= truth
        assert truth - 1e-5 <= report.distance <= truth + tolerance
        assert abs(report.time - 0.5) < 0.1


def test_what_is_wanted_decides_down_to_a_tenth_of_a_millimetre():
    truth = np.hypot(np.cos(1.0), 2.0 - np.sin(1.0)) - 0.3
    for room, holds in ((1e-4, True), (-1e-4, False)):
        scene = build_scene(PENDULUM, [TIP, POST], clearance=truth - room)
        assert prove_clearance(scene, _swing(1.0)).holds is holds


def test_an_arm_that_passes_a_thin_box_between_samples_is_caught():
    robot = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.5)])
    fist = Body("fist", Sphere(0.03), "link2", translation=[0.4, 0.0, 0.0])
    sheet = Body("sheet", Box((0.3, 0.002, 0.3)), translation=[0.9, 0.0, 0.0])
    scene = build_scene(robot, [fist, sheet])
    # A turn in a second, sampled ten times: never near the sheet.
    path = FourierTrajectory(
        robot.joint_names, [1.0], [0.0, 0.0], [[0.0, 0.0]], [[1.5, 0.1]], 1.0
    )
    samples = path.evaluate(np.arange(11) / 10.0, 0)[0]
    assert nearest(scene, samples).distance.min() > 0.1
    report = prove_clearance(scene, path)
    assert report.violated and report.distance < -0.02
    at = path.evaluate([report.time], 0)[0]
    assert np.isclose(nearest(scene, at).distance[0, 0], report.distance)
    with pytest.raises(
        InfeasibleError,
        match=r"'fist' and 'sheet' at 0\.[27]\d+ s of path 0 penetrate each other "
        r"by 3\d\.\d\d mm, but at least 0\.00 mm are required",
    ):
        report.require()


def test_the_way_from_the_start_pose_counts():
    scene = build_scene(PENDULUM, [TIP, POST], clearance=0.8)
    ways = [_swing(1.0), _swing(1.5), _swing(0.5)]
    report = prove_clearance(scene, ways)
    assert not report.holds and report.path == 1
    assert prove_clearance(scene, ways[::2]).holds
    with pytest.raises(InfeasibleError, match=r"path 1 .*800\.00 mm are required"):
        report.require()


def test_the_ground_is_kept_away_from():
    robot = from_modified_dh("pendulum", [DHRow(-np.pi / 2, 0)])
    scene = build_scene(robot, [TIP, plane(-0.9)])
    report = prove_clearance(scene, _swing(0.7))
    truth = 0.9 - np.sin(0.7) - 0.1
    assert report.holds and truth - 1e-3 <= report.proven <= truth
    assert not prove_clearance(scene, _swing(1.2)).holds


def test_joints_are_matched_by_name():
    robot = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.5)])
    tip = Body("tip", Sphere(0.1), "link2", translation=[0.5, 0.0, 0.0])
    scene = build_scene(robot, [tip, POST])
    a, b = [[0.9, 0.2]], [[0.1, -0.3]]
    path = FourierTrajectory(robot.joint_names, [0.5], [0.3, 0.1], a, b, 2.0)
    turned = FourierTrajectory(
        robot.joint_names[::-1],
        [0.5],
        path.offset[::-1],
        path.sine[:, ::-1],
        path.cosine[:, ::-1],
        2.0,
    )
    assert prove_clearance(scene, turned) == prove_clearance(scene, path)
    with pytest.raises(ProblemError, match=r"moves joints \('joint1',\).*'joint2'"):
        prove_clearance(scene, _swing(1.0))


def test_without_pairs_there_is_nothing_to_touch():
    report = prove_clearance(build_scene(PENDULUM, [TIP]), _swing(1.0))
    assert report.holds and report.proven == np.inf


@dataclass(frozen=True)
class _Bounded:
    """A path whose stated bounds are so generous that no proof can be had of them."""

    path: FourierTrajectory
    joints: tuple[str, ...] = ("joint1",)
    start: float = 0.0
    duration: float = 2.0

    def evaluate(self, time, derivatives=2):
        return self.path.evaluate(time, derivatives)

    def derivative_bound(self, order):
        return np.array([1e12])


def test_what_cannot_be_proven_does_not_hold(monkeypatch):
    monkeypatch.setattr("consistent_id.motion.collisions.clearance._MOST", 1000)
    scene = build_scene(PENDULUM, [TIP, POST])
    report = prove_clearance(scene, _Bounded(_swing(1.0)))
    assert not report.violated and not report.holds
    with pytest.raises(InfeasibleError, match="could be proven for all time"):
        report.require()


@pytest.mark.slow
@given(st.integers(0, 10**6))
@settings(max_examples=15, deadline=None, derandomize=True)
def test_distances_change_no_more_than_the_bound(seed):
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, tree=bool(seed % 2))
    q = rng.uniform(-2.0, 2.0, (10, 4))
    steps = rng.uniform(0.0, 10.0 ** rng.uniform(-3.0, 0.0), (10, 4))
    moved = q + steps * rng.choice([-1.0, 1.0], (10, 4))
    places = body_places(scene, link_places(scene.robot, q))
    change = abs(nearest(scene, moved).distance - nearest(scene, q).distance)
    for k, pair in enumerate(scene.pairs):
        bound = largest_change(places, pair, np.arange(10), steps)
        assert (change[:, k] <= bound + 1e-5).all()  # coal's own tolerance is 1e-6


@pytest.mark.slow
@given(st.integers(0, 10**6))
@settings(max_examples=10, deadline=None, derandomize=True)
def test_no_dense_sample_is_below_what_is_proven(seed):
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, joints=3, tree=bool(seed % 2))
    names = scene.robot.joint_names
    a, b = rng.normal(scale=0.4, size=(2, 2, 3))
    path = FourierTrajectory(names, [0.5, 1.0], rng.normal(size=3), a, b, 2.0)
    report = prove_clearance(scene, path, tolerance=5e-3)
    dense = nearest(scene, path.evaluate(np.linspace(0.0, 2.0, 501), 0)[0]).slack
    assert report.margin <= dense.min() + 1e-5
    assert dense.min() - 6e-3 < report.margin + 1e-3
