"""Bodies from unconstrained variables: derivatives, round trips, what has none."""

import numpy as np
import pytest
from body_variables import log_cholesky_curvature
from differences import central_differences
from robots import random_body

from consistent_id import InertialParameters, ModelError
from consistent_id.robot.log_cholesky import (
    body_from_log_cholesky,
    log_cholesky_from_body,
    log_cholesky_jacobian,
)


@pytest.mark.parametrize("seed", range(10))
def test_any_ten_numbers_give_a_body_of_that_mass_and_centre(seed):
    theta = np.random.default_rng(seed).normal(size=10)
    body = InertialParameters(body_from_log_cholesky(theta))
    assert body.is_consistent()
    assert body.mass == pytest.approx(np.exp(theta[0]), rel=1e-14)
    assert np.allclose(body.com, theta[1:4], rtol=1e-13)


def test_second_moments_are_those_of_the_factor():
    theta = np.random.default_rng(0).normal(size=10)
    L = np.diag(np.exp(theta[4:7]))
    L[1, 0], L[2, 0], L[2, 1] = theta[7:]
    body = InertialParameters(body_from_log_cholesky(theta))
    sigma = np.trace(body.central_inertia) / 2 * np.eye(3) - body.central_inertia
    assert np.allclose(sigma, body.mass * L @ L.T, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("seed", range(10))
def test_a_body_is_found_again_through_its_variables(seed):
    body = random_body(np.random.default_rng(seed)).vector
    again = body_from_log_cholesky(log_cholesky_from_body(body))
    assert np.allclose(again, body, rtol=1e-12, atol=1e-13 * abs(body).max())


def test_variables_are_found_again_through_their_body():
    theta = np.random.default_rng(1).normal(size=10)
    again = log_cholesky_from_body(body_from_log_cholesky(theta))
    assert np.allclose(again, theta, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("seed", range(5))
def test_the_jacobian_is_that_of_finite_differences(seed):
    theta = np.random.default_rng(seed).normal(size=10)
    numeric = central_differences(body_from_log_cholesky, theta)
    exact = log_cholesky_jacobian(theta)
    # Differences of step 1e-6 leave 1e-10 of rounding and 1e-12 of truncation.
    assert np.allclose(exact, numeric, rtol=1e-8, atol=1e-8 * abs(exact).max())


@pytest.mark.parametrize("seed", range(5))
def test_the_curvature_is_the_slope_of_the_jacobian(seed):
    rng = np.random.default_rng(seed)
    theta, g = rng.normal(size=(2, 10))
    numeric = central_differences(lambda t: log_cholesky_jacobian(t).T @ g, theta)
    exact = log_cholesky_curvature(theta, g)
    assert np.allclose(exact, numeric, rtol=1e-8, atol=1e-8 * abs(exact).max())


def test_many_bodies_at_once_are_each_by_itself():
    rng = np.random.default_rng(2)
    theta, g = rng.normal(size=(2, 3, 10))
    together = (
        body_from_log_cholesky(theta),
        log_cholesky_jacobian(theta),
        log_cholesky_curvature(theta, g),
    )
    for k in range(3):
        apart = (
            body_from_log_cholesky(theta[k]),
            log_cholesky_jacobian(theta[k]),
            log_cholesky_curvature(theta[k], g[k]),
        )
        for whole, single in zip(together, apart, strict=True):
            assert np.allclose(whole[k], single, rtol=1e-14)


def test_units_may_be_any():
    # With masses in units of m and lengths in units of d, variables shift and scale.
    theta, m, d = np.random.default_rng(3).normal(size=10), 3.0, 0.2
    units = np.array([m, *[m * d] * 3, *[m * d**2] * 6])
    scaled = np.concatenate(
        [[theta[0] + np.log(m)], theta[1:4] * d, theta[4:7] + np.log(d), theta[7:] * d]
    )
    assert np.allclose(
        body_from_log_cholesky(scaled), units * body_from_log_cholesky(theta)
    )


def test_flat_and_massless_bodies_have_no_variables():
    plate = InertialParameters.from_central(1.0, [0, 0, 0], np.diag([1.0, 1.0, 2.0]))
    with pytest.raises(ModelError, match="flat"):
        log_cholesky_from_body(plate.vector)
    with pytest.raises(ModelError, match="mass is 0 kg"):
        log_cholesky_from_body(np.zeros(10))
