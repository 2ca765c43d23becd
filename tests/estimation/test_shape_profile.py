"""Profiles of a quadratic misfit, whose intervals are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from consistent_id.estimation.shape_profile import (
    LeastMisfit,
    ShapeGroup,
    ShapeProfile,
    allowed_rise,
    profile,
)
from consistent_id.regression.friction_shapes import FrictionShape

H = np.array([[2.0, 1.2], [1.2, 3.0]])
BEST = np.array([0.3, -0.4])
GROUP = SimpleNamespace(name="shape", members=(), unit="rad/s")


def quadratic(u):
    """Half the logarithm of a sum of squares, and its slope."""
    away = np.asarray(u) - BEST
    return SimpleNamespace(half_log=0.5 * away @ H @ away, slope=H @ away)


def profiled(box, independent=50.0):
    allowed = allowed_rise(independent, confidence=0.95)
    return profile(LeastMisfit(quadratic, BEST, box, allowed), GROUP, 0)


def test_the_interval_of_a_quadratic_misfit_is_known_with_the_other_shape_free():
    found = profiled(np.array([[-5.0, 5.0], [-5.0, 5.0]]))
    # Of N samples it ends where N times the Schur complement's parabola is chi^2.
    schur = H[0, 0] - H[0, 1] ** 2 / H[1, 1]
    half = np.sqrt(3.841458820694124 / (50.0 * schur))
    assert np.log([found.low, found.high]) == pytest.approx(
        [BEST[0] - half, BEST[0] + half], abs=1e-5
    )
    assert found.determined
    place = np.log(found.curve[:, 0]) - BEST[0]
    assert np.log(found.curve[:, 1]) == pytest.approx(0.5 * schur * place**2, abs=1e-8)


def test_a_wide_interval_is_followed_to_its_ends():
    found = profiled(np.array([[-20.0, 20.0], [-20.0, 20.0]]), independent=0.05)
    half = np.sqrt(3.841458820694124 / (0.05 * (H[0, 0] - H[0, 1] ** 2 / H[1, 1])))
    assert half > 5.0 and found.determined
    assert np.log([found.low, found.high]) == pytest.approx(
        [BEST[0] - half, BEST[0] + half], abs=1e-5
    )


def test_an_interval_that_reaches_the_bounds_ends_there_and_says_so():
    found = profiled(np.array([[0.1, 5.0], [-5.0, 5.0]]))
    assert (found.low_found, found.high_found) == (False, True)
    assert np.log(found.low) == pytest.approx(0.1)
    found = profiled(np.array([[0.1, 0.5], [-5.0, 5.0]]), independent=1.0)
    assert (found.low_found, found.high_found) == (False, False)
    assert np.log([found.low, found.high]) == pytest.approx([0.1, 0.5])


def test_a_group_has_its_members_unit_and_their_geometric_mean():
    first, second = (
        FrictionShape(f"joint{n}", "velocity_scale", value, "rad/s", (1e-3, 1.0))
        for n, value in ((1, 0.02), (2, 0.08))
    )
    alone, both = ShapeGroup("one", (first,)), ShapeGroup("all", (first, second))
    assert (alone.kind, alone.unit) == (both.kind, both.unit)
    assert (both.kind, both.unit) == ("velocity_scale", "rad/s")
    assert [alone.value, both.value] == pytest.approx([0.02, 0.04])


@pytest.mark.parametrize(
    ("low_found", "high_found", "said"),
    [
        (True, True, "shape = 0.2 rad/s [0.1, 0.4]"),
        (True, False, "shape = 0.2 rad/s, by the data at least 0.1"),
        (False, True, "shape = 0.2 rad/s, by the data at most 0.4"),
        (False, False, "shape = 0.2 rad/s, which the data do not determine"),
    ],
)
def test_a_shape_is_said_with_the_ends_that_the_data_show(low_found, high_found, said):
    ends = {"low": 0.1, "high": 0.4, "low_found": low_found, "high_found": high_found}
    found = ShapeProfile(
        "shape", ("joint1",), 0.2, unit="rad/s", curve=np.ones((1, 2)), **ends
    )
    assert str(found) == said
    assert found.determined is (low_found and high_found)


@pytest.mark.parametrize(
    ("root", "steps"),
    [
        (lambda u: 2.0 * u, [0.05, 0.15, 0.35, 0.55, 0.75, 0.95, 1.15]),
        (lambda u: (u / 0.3) ** 2, [0.05, 0.15, 0.35, 0.45]),
    ],
)
def test_steps_double_where_little_changes_and_halve_where_much_does(root, steps):
    """Of the root of the rise: below 0.25, above 1, not beyond 2; alike both ways."""
    best, allowed = np.array([0.3]), 0.01

    def misfit(u):
        return SimpleNamespace(half_log=7.0 + allowed * root(abs(u[0] - 0.3)) ** 2)

    box = np.array([[-5.0, 5.0]])
    found = profile(LeastMisfit(misfit, best, box, allowed), GROUP, 0)
    places = np.log(found.curve[:, 0]) - 0.3
    expected = [-step for step in steps[::-1]] + [0.0, *steps]
    np.testing.assert_allclose(places, expected, atol=1e-12)
    # An end is interpolated in the root, between the points about one.
    away = np.interp(1.0, [root(step) for step in steps], steps)
    ends = np.log([found.low, found.high]) - 0.3
    np.testing.assert_allclose(ends, [-away, away], atol=1e-12)
