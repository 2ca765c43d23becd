"""Distances to nominal, scales and origins of parameters, by direct computation."""

from typing import get_args

import numpy as np
import pytest
from robots import random_body, random_robot

from consistent_id import (
    DHRow,
    DriveTerms,
    InertialParameters,
    ProblemError,
    TorqueModel,
    from_modified_dh,
)
from consistent_id.constraints import PointToSet
from consistent_id.constraints.priors import (
    Distance,
    nominal_distance,
    pullback_distance,
)
from consistent_id.regression.base import parameter_origins
from consistent_id.robot import Datasheet
from consistent_id.robot.scaling import link_scales, reference_bodies


def test_the_pullback_distance_is_the_whitened_frobenius_norm():
    rng = np.random.default_rng(0)
    body, other = random_body(rng), random_body(rng)
    values, vectors = np.linalg.eigh(body.pseudo_inertia)
    root = vectors @ np.diag(values**-0.5) @ vectors.T
    change = root @ (other.pseudo_inertia - body.pseudo_inertia) @ root
    expected = np.linalg.norm(change, "fro")
    assert pullback_distance(other.vector, body.vector) == pytest.approx(expected)


def test_it_is_the_second_order_of_the_log_det_divergence():
    rng = np.random.default_rng(1)
    body, other = random_body(rng), random_body(rng)
    step = 1e-4
    near = body.vector + step * (other.vector - body.vector)
    J0, J = body.pseudo_inertia, InertialParameters(near).pseudo_inertia
    M = J @ np.linalg.inv(J0)
    divergence = np.trace(M) - np.log(np.linalg.det(M)) - 4.0
    # The next order is a step of 1e-4 smaller, times a condition number of some 10.
    assert divergence == pytest.approx(
        pullback_distance(near, body.vector) ** 2 / 2, rel=1e-2
    )


def test_it_does_not_depend_on_frame_or_units():
    rng = np.random.default_rng(2)
    body, other = random_body(rng), random_body(rng)
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    Q *= np.sign(np.linalg.det(Q))
    move = (100.0 * Q, rng.normal(size=3))  # centimetres, and another frame
    moved = [b.transformed(*move).vector for b in (other, body)]
    assert pullback_distance(*moved) == pytest.approx(
        pullback_distance(other.vector, body.vector), rel=1e-8
    )


@pytest.mark.parametrize("distance", get_args(Distance))
def test_the_nominal_robot_is_at_no_distance(distance):
    _, robot = random_robot(np.random.default_rng(3), 3)
    unit = link_scales(robot).units
    mine = nominal_distance(TorqueModel(robot), distance, unit)
    assert mine.nominal * unit == pytest.approx(robot.nominal, rel=1e-9, abs=1e-12)
    assert mine.squared(mine.nominal) == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.matrix_rank(mine.local(mine.nominal).G) == 30


def test_the_entropic_distance_is_twice_the_log_det_divergence():
    rng = np.random.default_rng(5)
    _, robot = random_robot(rng, 3)
    unit = link_scales(robot).units
    mine = nominal_distance(TorqueModel(robot), "entropic", unit)
    bodies = [random_body(rng) for _ in range(3)]
    expected = 0.0
    for body, link in zip(bodies, robot.links, strict=True):
        ratio = body.pseudo_inertia @ np.linalg.inv(link.nominal.pseudo_inertia)
        expected += 2 * (np.trace(ratio) - np.log(np.linalg.det(ratio)) - 4)
    u = np.concatenate([body.vector for body in bodies]) / unit
    assert mine.squared(u) == pytest.approx(expected, rel=1e-9)
    assert mine.squared(-u) == np.inf


@pytest.mark.parametrize("distance", get_args(Distance))
def test_rows_have_the_distances_gradient_and_curvature(distance):
    rng = np.random.default_rng(6)
    _, robot = random_robot(rng, 2)
    model = TorqueModel(robot, DriveTerms(viscous=True))
    unit = np.append(link_scales(robot).units, [0.5, 2.0])
    mine = nominal_distance(model, distance, unit)
    bodies = [random_body(rng).vector for _ in range(2)]
    u = np.append(np.concatenate(bodies), [0.3, 0.7]) / unit
    G, g = mine.local(u)
    step = 1e-4
    for direction in np.eye(len(u)):
        ahead, here, behind = (
            mine.squared(u + s * direction) for s in (step, 0, -step)
        )
        slope, curve = (
            (ahead - behind) / (2 * step),
            (ahead - 2 * here + behind) / step**2,
        )
        # Truncation is of the order of the step squared, relative to the curvature.
        size = np.sum((G @ direction) ** 2)
        assert 2 * (G @ direction) @ (G @ u - g) == pytest.approx(
            slope, abs=1e-5 * size
        )
        assert 2 * size == pytest.approx(curve, rel=1e-3, abs=1e-5)


def test_reference_bodies_are_bodies_also_where_the_nominal_is_flat_or_unknown():
    table = [DHRow(0, 0, 0.3), DHRow(-np.pi / 2, 0.4)]
    robot = from_modified_dh("arm", table).with_datasheet(
        {"link2": Datasheet(mass=2.0, com=[0.1, 0.0, 0.0])}
    )
    for body in reference_bodies(robot):
        assert InertialParameters(body).is_consistent()
    assert reference_bodies(robot)[1][:2] == pytest.approx([2.0, 0.2])
    assert link_scales(robot).mass.tolist() == [2.0, 2.0]  # the mean of those known


def test_slack_is_what_one_standard_error_costs_and_is_between_zero_and_one():
    # One unit more of a squared misfit of a hundred.
    assert PointToSet().relative_slack(1.0, 100.0) == pytest.approx(np.sqrt(1.01) - 1)
    assert PointToSet(slack=0.2).relative_slack(1.0, 100.0) == 0.2
    for slack in (0.0, 1.0, -0.1, np.nan):
        with pytest.raises(ProblemError, match="slack"):
            PointToSet(slack=slack)
    with pytest.raises(ProblemError, match="distance"):
        PointToSet(distance="manhattan")


def test_origins_tell_data_combinations_constraints_and_the_rest_apart():
    data = np.array([[1.0, 0, 0, 0, 0], [0, 1, 1, 0, 0]])
    known = np.array([[0.0, 0, 0, 2.0, 0]])
    assert parameter_origins(data, known, elsewhere="prior") == (
        "data",
        "combination",
        "combination",
        "constraint",
        "prior",
    )
    # Knowing one of a sum makes the other known by data.
    known = np.array([[0.0, 0, 3.0, 0, 0]])
    assert parameter_origins(data, known, elsewhere="prior")[1:3] == (
        "data",
        "constraint",
    )


def test_the_slope_along_a_step_is_that_of_the_distance():
    rng = np.random.default_rng(7)
    _, robot = random_robot(rng, 2)
    model = TorqueModel(robot, DriveTerms(viscous=True))
    unit = np.append(link_scales(robot).units, [0.5, 2.0])
    mine = nominal_distance(model, "entropic", unit)
    start, end = (
        np.append(np.concatenate([random_body(rng).vector for _ in range(2)]), drive)
        / unit
        for drive in ([0.3, 0.7], [1.2, -0.4])
    )
    along = mine.along(start, end - start)  # bodies are convex: all of it is inside
    for t in (0.0, 0.3, 0.9):
        ahead, behind = (
            mine.squared(start + (t + s) * (end - start)) for s in (1e-5, -1e-5)
        )
        assert along.slope(t) == pytest.approx((ahead - behind) / 2e-5, rel=1e-5)


@pytest.mark.parametrize("kept", [0.1, 0.9])
def test_the_furthest_step_leaves_bodies_a_share_of_their_eigenvalues(kept):
    rng = np.random.default_rng(8)
    _, robot = random_robot(rng, 2)
    unit = link_scales(robot).units
    mine = nominal_distance(TorqueModel(robot), "entropic", unit)
    u = np.concatenate([random_body(rng).vector for _ in range(2)]) / unit
    # Towards nothing, every eigenvalue falls alike: a share of 1 - kept is left of it.
    assert mine.along(u, -u).furthest(kept) == pytest.approx(1.0 - kept)
    assert mine.along(u, -5.0 * u).furthest(kept) == pytest.approx((1.0 - kept) / 5.0)
    # Away from it, and by little, all of the step may be taken.
    assert mine.along(u, u).furthest(kept) == 1.0
    assert mine.along(u, -0.05 * u).furthest(kept) == 1.0


def test_a_euclidean_distance_of_one_is_a_typical_size_of_one_parameter():
    _, robot = random_robot(np.random.default_rng(4), 2)
    model = TorqueModel(robot)
    sizes = link_scales(robot).units
    unit = 7.0 * sizes
    distance = nominal_distance(model, "euclidean", unit)
    nominal = np.concatenate([link.nominal.vector for link in robot.links])
    for k in (0, 5, 13):
        x = nominal.copy()
        x[k] += 3.0 * sizes[k]
        assert distance.squared(x / unit) == pytest.approx(9.0)
