"""Intervals of a servo's parameters: a jackknife, and copies of the logs."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import t as student

from consistent_id.rollout.servo_intervals import (
    Copies,
    half_intervals,
    sample_weights,
)
from consistent_id.rollout.servo_log import encoded

EXACT = Copies(np.zeros((4, 1)), 0.0)
"""Copies whose fits have no error."""


def test_they_are_those_of_a_mean_if_the_fit_is_one():
    """Fits without one of n values are means; the jackknife is then the t interval."""
    values = np.random.default_rng(0).normal(size=8)
    parts = np.array([[np.delete(values, k).mean()] for k in range(8)])
    (half,) = half_intervals(np.array([values.mean()]), parts, 1.0, EXACT)
    # Student's 97.5 % for 7 degrees of freedom is 2.3646 in tables.
    assert half == pytest.approx(2.3646 * values.std(ddof=1) / np.sqrt(8), rel=1e-4)


def test_a_fit_beside_the_mean_of_its_parts_widens_them():
    parts = np.array([[1.0], [1.0], [1.0]])
    (half,) = half_intervals(np.array([1.5]), parts, 1.0, EXACT)
    # The variance is 2/3 of 3 times 0.5^2; Student's 97.5 % is 4.3027.
    assert half == pytest.approx(4.3027 * np.sqrt(0.5), rel=1e-4)


def test_of_the_jackknife_the_share_counts_that_copies_do_not_explain():
    parts = np.array([[1.0], [1.0], [1.0]])
    whole, part = (
        half_intervals(np.array([1.5]), parts, 2.0, Copies(np.zeros((4, 1)), misfit))[0]
        for misfit in (0.0, 1.0)
    )
    assert part == pytest.approx(np.sqrt(0.75) * whole, rel=1e-4)


def test_if_copies_fit_no_better_than_the_logs_they_alone_count():
    parts = np.array([[1.0], [1.0], [1.0]])
    off = np.array([[0.1], [-0.1], [0.2], [-0.2]])
    (half,) = half_intervals(np.array([1.5]), parts, 1.0, Copies(off, 1.1))
    # Student's 97.5 % for 3 degrees of freedom is 3.1824; a copy less the mean of four.
    assert half == pytest.approx(3.1824 * np.sqrt(1.25) * off.std(ddof=1), rel=1e-4)


def test_two_variances_have_the_degrees_of_freedom_of_welch_and_satterthwaite():
    off = np.array([[0.1], [-0.1], [0.2], [-0.2]])
    spread = np.array([[1.1], [0.9], [1.0]])
    one, other = 1.25 * off.var(ddof=1), 2.0 / 3.0 * 0.02
    freedom = (one + other) ** 2 / (one**2 / 3 + other**2 / 2)
    (half,) = half_intervals(np.array([1.0]), spread, 1.0, Copies(off, 0.0))
    expected = student.ppf(0.975, freedom) * np.sqrt(one + other)
    assert half == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("bias", [0.05, -0.3, 3.0])
def test_they_contain_95_of_100_errors_that_have_a_bias(bias):
    off = bias + np.array([[0.1], [-0.1], [0.2], [-0.2]])
    (half,) = half_intervals(np.ones(1), np.ones((3, 1)), 1.0, Copies(off, 1.0))
    deviation = np.sqrt(1.25) * off.std(ddof=1)
    low, high = student.cdf((np.array([-half, half]) - bias) / deviation, 3)
    assert high - low == pytest.approx(0.95, abs=1e-4)


def test_a_sample_weighs_as_its_piece_and_its_piece_as_one_of_all():
    pieces = SimpleNamespace(times=(np.zeros(2), np.zeros(6)))
    values = np.array([1.0, 3.0, *np.full(6, 7.0)])
    assert sample_weights(pieces) @ values == pytest.approx((2.0 + 7.0) / 2.0)


def test_an_encoder_reads_multiples_of_its_step_from_a_random_place():
    step = 2 * np.pi / 4096
    motion = np.sin(np.linspace(0.0, 3.0, 500))
    like = step * np.round(0.3 * motion / step)
    rng = np.random.default_rng(0)
    read = encoded(motion, like, rng)
    assert abs(read - motion).max() <= 0.5001 * step
    assert np.allclose(np.diff(read) / step, np.round(np.diff(read) / step), atol=1e-3)
    assert not np.allclose(read, encoded(motion, like, rng))
    assert np.allclose(encoded(motion, np.ones(3), rng), motion)
