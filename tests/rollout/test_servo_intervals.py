"""Intervals of a servo's parameters: a jackknife over parts of the logs."""

import numpy as np
import pytest

from consistent_id.rollout.servo_bounds import half_intervals
from consistent_id.rollout.servo_motion import STEP


def test_they_are_those_of_a_mean_if_the_fit_is_one():
    """Fits without one of n values are means; the jackknife is then the t interval."""
    values = np.random.default_rng(0).normal(size=8)
    parts = np.array([[np.delete(values, k).mean()] for k in range(8)])
    (half,) = half_intervals(["stall"], np.array([values.mean()]), parts)
    # Student's 97.5 % for 7 degrees of freedom is 2.3646 in tables.
    assert half == pytest.approx(2.3646 * values.std(ddof=1) / np.sqrt(8), rel=1e-4)


def test_a_fit_beside_the_mean_of_its_parts_widens_them():
    parts = np.array([[1.0], [1.0], [1.0]])
    (half,) = half_intervals(["stall"], np.array([1.5]), parts)
    assert half == pytest.approx(0.5)


def test_a_delay_is_known_to_a_step_at_best():
    same = np.full((4, 2), 0.01)
    half = half_intervals(["stall", "delay"], np.array([0.01, 0.01]), same)
    assert half.tolist() == [0.0, STEP]
