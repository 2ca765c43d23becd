"""Rows of distances: each pose and pair once, with slopes by finite differences."""

import numpy as np
import pytest
from excited import arm, arm_limits

from consistent_id.excitation.basis import FourierBasis
from consistent_id.excitation.guards import (
    EVERY,
    ClearanceGuard,
    WatchedPlace,
    guard_rows,
)
from consistent_id.motion import Body, Box, Capsule, Sphere, build_scene
from consistent_id.motion.collisions import separation as separations
from consistent_id.motion.collisions.bodies import plane
from consistent_id.motion.collisions.separation import nearest


def guarded():
    robot = arm(3)
    bodies = [
        Body("upper", Capsule(0.04, 0.2), "link2", translation=[0.2, 0.0, 0.0]),
        Body("fore", Capsule(0.03, 0.2), "link3", translation=[0.2, 0.0, 0.0]),
        Body("post", Box((0.1, 0.1, 2.0)), translation=[0.7, 0.3, 0.0]),
        Body("lamp", Sphere(0.1), translation=[0.3, -0.2, 0.4]),
        plane(-0.4),
    ]
    return ClearanceGuard(build_scene(robot, bodies))


def moving(guard, times=9):
    limits = arm_limits(guard.scene.robot)
    basis = FourierBasis(limits, np.array([0.2, 0.4, 0.6]), 5.0, True)
    rng = np.random.default_rng(5)  # a path on which pairs come near
    variables = 0.3 * rng.normal(size=(basis.size, 3))
    return basis, np.linspace(0.0, 4.5, times), variables


def mixed(guard, times=9):
    """Every time as a whole, and some pairs at some of the times."""
    places = {WatchedPlace(t, EVERY) for t in range(times)}
    places |= {WatchedPlace(t, t % len(guard.scene.pairs)) for t in range(0, times, 2)}
    return sorted(places)


def test_rows_are_the_distances_of_the_pairs_and_their_smooth_maximum():
    guard = guarded()
    basis, time, variables = moving(guard)
    places = mixed(guard)
    values, _ = guard_rows(guard, places, basis, time, variables)
    motion = basis.motion(variables, time)
    slack = nearest(guard.scene, motion[0], within=0.1).slack
    near = (0.002 - slack) / 0.1  # 2 mm are kept to spare
    measured = guard.measure(motion)
    counts = near > -0.5  # five centimetres; of others the distance is only bounded
    assert counts.any() and not counts.all()
    assert np.allclose(measured[counts], near[counts], rtol=1e-12, atol=1e-12)
    assert np.all(measured[~counts] <= -0.5)
    smooth = np.log(np.exp(20.0 * near).sum(axis=1)) / 20.0
    for value, (t, item) in zip(values, places, strict=True):
        expected = smooth[t] if item == EVERY else near[t, item]
        assert np.isclose(value, expected, rtol=1e-9, atol=1e-9)


def test_slopes_of_rows_are_finite_differences():
    guard = guarded()
    basis, time, variables = moving(guard)
    places = mixed(guard)
    values, jacobian = guard_rows(guard, places, basis, time, variables)
    direction = np.random.default_rng(1).normal(size=variables.shape)
    step = 1e-6
    ahead, behind = (
        guard_rows(guard, places, basis, time, variables + s * direction)[0]
        for s in (step, -step)
    )
    change = (ahead - behind) / (2.0 * step)
    near = values > -1.0  # beyond, distances are only bounded, and so are their slopes
    assert near.sum() >= 5
    assert np.allclose((jacobian @ direction.ravel())[near], change[near], rtol=1e-5)


def test_a_pair_at_a_time_is_measured_once_however_many_rows_need_it(monkeypatch):
    guard = guarded()
    basis, time, variables = moving(guard)
    counts = []

    def counted(*given):
        counts.append(len(given[3]))
        return separations.separation(*given)

    monkeypatch.setattr("consistent_id.excitation.guards.separation", counted)
    guard_rows(guard, mixed(guard), basis, time, variables)
    assert counts == [len(time) * len(guard.scene.pairs)]


def test_distances_along_a_path_are_those_of_each_pose_where_bodies_are_near():
    """The bodies come near for a moment, between the poses that are computed first."""
    guard = guarded()
    basis, time, variables = moving(guard, 241)
    motion = basis.motion(variables, time)
    every = nearest(guard.scene, motion[0])
    within = np.full(len(every.pairs), 0.05)
    queries = []

    def counted(*given, **options):
        found = plain(*given, **options)
        queries.append(len(found.distance))
        return found

    plain = separations.separation
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(separations, "separation", counted)
        found = separations.distances_along(guard.scene, motion[0], within)
    near = every.distance < within
    assert near.any()
    assert np.allclose(found[near], every.distance[near], rtol=0.0, atol=1e-12)
    assert np.all(found <= every.distance + 1e-12)  # elsewhere they are lower bounds
    assert np.all(found[~near] >= 0.05)
    assert sum(queries) < 0.6 * every.distance.size  # and cost less


@pytest.mark.parametrize("poses", range(1, 10))
def test_distances_of_few_poses_are_those_of_each(poses):
    """Of fewer poses than the stride of those that are computed first, too."""
    guard = guarded()
    basis, time, variables = moving(guard, 241)
    every = nearest(guard.scene, basis.motion(variables, time)[0])
    worst = every.distance.min(axis=1).argsort()[:poses][::-1]  # the nearest comes last
    q = basis.motion(variables, time[worst])[0]
    within = np.full(len(every.pairs), 0.05)
    found = separations.distances_along(guard.scene, q, within)
    near = every.distance[worst] < within
    assert near[-1].any()
    assert np.allclose(found[near], every.distance[worst][near], rtol=0.0, atol=1e-12)
    least = np.full(len(every.pairs), every.distance.min() + 1e-3)
    assert separations.distances_along(guard.scene, q, least, least=least) is None


def test_a_path_on_which_no_bodies_come_near_is_clear():
    scene = build_scene(
        arm(3),
        [
            Body("fore", Sphere(0.05), "link3", translation=[0.2, 0.0, 0.0]),
            Body("post", Sphere(0.1), translation=[9.0, 0.0, 0.0]),
        ],
    )
    guard = ClearanceGuard(scene)
    basis, time, variables = moving(guard, 31)
    assert guard.kept(basis.motion(variables, time))


@pytest.mark.slow
def test_a_path_is_clear_if_no_pose_of_it_is_too_near():
    guard = guarded()
    basis, time, variables = moving(guard, 241)
    for share in np.linspace(0.0, 1.0, 9):
        motion = basis.motion(share * variables, time)
        assert guard.kept(motion) == bool(guard.measure(motion).max() <= 0.0)
