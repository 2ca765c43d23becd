"""Robots that are not like the others of their fleet: the statistic, and the names."""

import numpy as np
import pytest

from consistent_id.fleet.fleet_result import find_outliers


def _factor(rng, x, columns, noise=1.0):
    A = rng.normal(size=(200, columns)) * rng.uniform(0.1, 10, columns)
    R = np.linalg.qr(np.column_stack([A, A @ x + rng.normal(0, noise, 200)]), "r")
    return np.asarray(R)


@pytest.mark.slow
def test_the_statistic_of_equal_robots_is_chi_squared():
    rng = np.random.default_rng(5)
    x = rng.normal(size=6)
    found = find_outliers([_factor(rng, x, 6) for _ in range(300)])
    assert (found.freedom == 6).all() and not found.named.any()
    # Means of 300 draws of chi^2 with 6 degrees of freedom: 6 +- 0.2.
    assert found.statistic.mean() == pytest.approx(6.0, abs=0.8)
    assert np.var(found.statistic) == pytest.approx(12.0, rel=0.5)
    assert found.spread < 1.15
    assert np.mean(found.p_values < 0.1) == pytest.approx(0.1, abs=0.07)


def test_outliers_that_hide_each_other_are_named():
    rng = np.random.default_rng(6)
    x = rng.normal(size=6)
    factors = [_factor(rng, x, 6) for _ in range(20)]
    for k in (2, 5, 11):
        factors[k] = _factor(rng, x + 3.0 * (k == 5) + 0.5, 6)
    assert np.flatnonzero(find_outliers(factors).named).tolist() == [2, 5, 11]


def test_a_fleet_that_scatters_is_its_own_measure():
    rng = np.random.default_rng(7)
    x = rng.normal(size=6)
    factors = [_factor(rng, x + rng.normal(0, 0.2, 6), 6) for _ in range(60)]
    found = find_outliers(factors)
    assert found.spread > 20.0 and found.named.sum() <= 2
    factors[9] = _factor(rng, x + 20.0, 6)
    assert find_outliers(factors).named[9]


def test_of_a_few_robots_none_is_named():
    rng = np.random.default_rng(8)
    factors = [_factor(rng, np.full(4, float(k)), 4) for k in range(3)]
    assert not find_outliers(factors).named.any()


@pytest.mark.parametrize(
    ("robots", "far", "named"), [(24, 12, 11), (25, 12, 12), (26, 13, 12), (27, 13, 13)]
)
def test_most_robots_stay_by_which_the_others_are_judged(robots, far, named):
    """Robots in pairs on both sides, each pair twenty times as far as the next."""
    rng = np.random.default_rng(9)
    x, factors = rng.normal(size=6), []
    for k in range(robots):
        A = np.linalg.qr(rng.normal(size=(200, 6)))[0]  # all see all directions alike
        shift = (-1.0) ** k * 20.0 ** ((far - k + 1) // 2) * (k < far)
        rows = np.column_stack([A, A @ (x + shift) + rng.normal(size=200)])
        factors.append(np.asarray(np.linalg.qr(rows, "r")))
    found = find_outliers(factors).named
    assert found.sum() == named and not found[far:].any()
