"""A load's quantities in a frame, with intervals by propagation of the covariance."""

from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from carrying import LOAD

from consistent_id.robot import FixedFrame, InertialParameters
from consistent_id.service.load_quantities import (
    inertia_is_open,
    inertia_width,
    load_quantities,
)

FRAME = FixedFrame("tcp", pin.exp3(np.array([0.4, -0.7, 0.2])), [0.1, -0.2, 0.3])
LINK = FixedFrame("link", np.eye(3), np.zeros(3))


def payload(scale=1e-3, seed=0):
    root = scale * np.random.default_rng(seed).normal(size=(10, 10))
    return SimpleNamespace(body=LOAD, free=LOAD, covariance=root @ root.T, quantile=2.0)


def test_a_body_in_another_frame_is_pinocchio_s():
    place = pin.SE3(FRAME.rotation, FRAME.translation)
    body = pin.Inertia(LOAD.mass, LOAD.com, LOAD.central_inertia)
    expected = place.actInv(body)
    found = load_quantities(payload(), FRAME)
    np.testing.assert_allclose(found.body.com, expected.lever, atol=1e-13)
    np.testing.assert_allclose(found.body.central_inertia, expected.inertia, atol=1e-13)
    assert found.values[0] == pytest.approx(LOAD.mass)


@pytest.mark.slow
def test_intervals_are_those_of_many_draws():
    small = payload(scale=2e-4)
    rng = np.random.default_rng(1)
    draws = rng.multivariate_normal(LOAD.vector, small.covariance, size=20_000)
    turned = FRAME.rotation.T
    back = -turned @ FRAME.translation
    values = []
    for vector in draws:
        body = InertialParameters(vector).transformed(turned, back)
        central = body.central_inertia
        entries = [central[i, j] for i, j in zip(*np.triu_indices(3), strict=True)]
        values.append([body.mass, *body.com, *np.array(entries)[[0, 1, 3, 2, 4, 5]]])
    found = load_quantities(small, FRAME)
    half = 0.5 * (found.high - found.low)
    # A standard deviation of 20 000 draws is known to 0.5 %: 2 % is four of these.
    np.testing.assert_allclose(half, 2.0 * np.std(values, axis=0), rtol=0.02)
    middle = 0.5 * (found.high + found.low)
    np.testing.assert_allclose(middle, found.values, atol=1e-12)


def test_what_is_open_makes_open_what_depends_on_it():
    blind = payload()
    covariance = blind.covariance.copy()
    covariance[4:, :] = covariance[:, 4:] = 0.0
    covariance[range(4, 10), range(4, 10)] = np.inf
    blind.covariance = covariance
    found = load_quantities(blind, FRAME)
    assert np.isfinite(found.high[:4]).all()
    assert np.isinf(found.high[4:]).all()
    assert inertia_is_open(blind)
    assert found.to_dict()["Ixx"]["low"] is None
    covariance[1, :] = covariance[:, 1] = 0.0
    covariance[1, 1] = np.inf  # h_x in the link: all of c where axes are turned
    assert np.isinf(load_quantities(blind, FRAME).high[1:4]).all()
    assert np.isfinite(load_quantities(blind, LINK).high[2:4]).all()


def test_inertia_is_open_if_its_trace_is_not_known_to_a_half():
    # Only the trace is uncertain: Ixx, Iyy and Izz move together.
    trace = np.trace(LOAD.central_inertia)
    move = np.zeros(10)
    move[[4, 6, 9]] = 1.0 / 3.0
    for share, is_open in ((0.49, False), (0.51, True)):
        one = payload()  # half an interval is twice the error
        one.covariance = np.outer(move, move) * (0.5 * share * trace) ** 2
        assert inertia_is_open(one) == is_open
        assert inertia_width(one) == pytest.approx(2.0 * share)


def test_the_table_has_no_number_where_nothing_is_identified():
    open_one = payload()
    open_one.covariance[4:, :] = open_one.covariance[:, 4:] = 0.0
    open_one.covariance[range(4, 10), range(4, 10)] = np.inf
    rows = {row[0]: row[1:] for row in load_quantities(open_one, LINK).table().rows}
    assert rows["Ixx"] == ("-", "-", "-", "kg m^2")
    assert rows["m"][0] == "3"
