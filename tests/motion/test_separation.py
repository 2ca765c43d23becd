"""Signed distances have closed forms, and gradients are those of differences."""

import numpy as np
import pytest
from scenes import random_scene

from consistent_id import DHRow, from_modified_dh
from consistent_id.motion import Body, Box, Capsule, Hull, Sphere, build_scene, plane
from consistent_id.motion.collisions.scene import Pair, Scene
from consistent_id.motion.collisions.separation import nearest

ARM = from_modified_dh("arm", [DHRow(0, 0)])  # turns about z


def _still(first, second):
    """Two bodies of which the second stands on the link, at angle zero."""
    scene = Scene(ARM, (first, second), (Pair(0, 1),))
    near = nearest(scene, [[0.0]])
    return near


def test_balls_are_as_far_apart_as_their_centres_less_their_radii():
    for x in (2.0, 0.5, 0.2):
        near = _still(
            Body("a", Sphere(0.3)),
            Body("b", Sphere(0.4), "link1", translation=[x, 0, 0]),
        )
        assert np.isclose(near.distance[0, 0], x - 0.7, atol=1e-6)
        assert np.allclose(near.normal[0, 0], [1, 0, 0], atol=1e-6)
        assert np.allclose(near.points[0, 0, :, 0], [0.3, x - 0.4], atol=1e-5)


def test_balls_about_one_point_are_in_one_another_by_both_radii():
    near = _still(Body("a", Sphere(0.3)), Body("b", Sphere(0.4), "link1"))
    assert np.isclose(near.distance[0, 0], -0.7, atol=1e-6)


def test_boxes_are_apart_by_their_gap_and_deep_by_the_least_way_out():
    for x, distance in ((1.7, 0.2), (1.4, -0.1)):
        near = _still(
            Body("a", Box((1, 5, 4))),
            Body("b", Box((2, 3, 3)), "link1", translation=[x, 0.4, 0.3]),
        )
        assert np.isclose(near.distance[0, 0], distance, atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_hulls_are_as_far_apart_as_a_quadratic_programme_says(seed):
    import cvxpy as cp

    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 15, 3)) + np.array([[[0, 0, 0]], [[4.0, 1.0, 2.0]]])
    near = _still(Body("a", Hull(a)), Body("b", Hull(b), "link1"))
    u, v = cp.Variable(15, nonneg=True), cp.Variable(15, nonneg=True)
    gap = cp.sum_squares(u @ a - v @ b)
    cp.Problem(cp.Minimize(gap), [cp.sum(u) == 1, cp.sum(v) == 1]).solve("CLARABEL")
    assert np.isclose(near.distance[0, 0], np.sqrt(gap.value), atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("rim", (254, 255, 1000))
def test_a_cone_of_a_fine_mesh_is_as_far_away_as_its_tip(rim):
    # Coal refuses corners with 255 neighbours or more, such as the tip.
    turn = np.linspace(0.0, 2.0 * np.pi, rim, endpoint=False)
    base = np.column_stack([0.0 * turn - 1.0, np.cos(turn), np.sin(turn)])
    cone = Hull([*base, [0.0, 0.0, 0.0]])
    near = _still(
        Body("cone", cone), Body("ball", Sphere(0.3), "link1", translation=[1, 0, 0])
    )
    assert np.isclose(near.distance[0, 0], 0.7, atol=1e-6)
    beside = Body("ball", Sphere(0.3), "link1", translation=[-1, 0, 1.5])
    distance = _still(Body("cone", cone), beside).distance[0, 0]
    assert 0.2 - 1e-3 < distance < 0.2 + 1e-3


def test_a_pendulum_is_above_the_ground_by_its_lowest_point():
    rows = [DHRow(-np.pi / 2, 0)]  # turns about a horizontal axis
    robot = from_modified_dh("pendulum", rows)
    rod = Body("rod", Capsule(0.05, 0.8), "link1", *_along_x(0.6))
    scene = build_scene(robot, [plane(-0.3), rod])
    angles = np.linspace(-3.0, 3.0, 40)
    near = nearest(scene, angles[:, None])
    up = -np.sin(angles)  # of the rod's direction
    lowest = np.minimum(0.2 * up, 1.0 * up) - 0.05
    assert np.allclose(near.distance[:, 0], lowest + 0.3, atol=1e-12)
    arm = np.where(up < 0.0, 1.0, 0.2)
    assert np.allclose(near.gradient[:, 0, 0], -arm * np.cos(angles), atol=1e-9)
    assert np.allclose(near.points[:, 0, 0, 2], -0.3)


def _along_x(x):
    """A capsule's z axis laid along x, its middle at `x`."""
    return np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), [x, 0.0, 0.0]


@pytest.mark.parametrize("seed", range(6))
def test_gradients_are_those_of_differences(seed):
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, round_only=True)
    q, step = rng.uniform(-2.0, 2.0, (8, 4)), 1e-5
    near = nearest(scene, q)
    differences = np.stack(
        [
            (
                nearest(scene, q + step * e).distance
                - nearest(scene, q - step * e).distance
            )
            / (2.0 * step)
            for e in np.eye(4)
        ],
        axis=-1,
    )
    # Round bodies have one nearest point each, as long as they are apart.
    apart = near.distance > 1e-3
    assert apart.sum() > 20
    assert np.allclose(near.gradient[apart], differences[apart], atol=3e-3)
    assert np.quantile(abs(near.gradient - differences)[apart], 0.9) < 1e-4


def test_slack_is_distance_less_what_is_wanted():
    scene = Scene(
        ARM,
        (Body("a", Sphere(0.1)), Body("b", Sphere(0.1), "link1")),
        (Pair(0, 1, 0.3),),
    )
    assert np.isclose(nearest(scene, [[0.0]]).slack[0, 0], -0.5, atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_beyond_what_matters_distances_are_bounded_from_below(seed):
    rng = np.random.default_rng(seed)
    scene, q = random_scene(rng), rng.uniform(-2.0, 2.0, (30, 4))
    exact, quick = nearest(scene, q).distance, nearest(scene, q, within=0.3).distance
    assert (quick <= exact + 1e-5).all()
    near = exact <= 0.3
    assert near.any() and np.allclose(quick[near], exact[near], atol=1e-12)
    assert (quick[~near] > 0.0).all()
