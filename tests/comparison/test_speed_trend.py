"""Parameters that go with speed: lines known beforehand, and intervals that hold."""

import numpy as np
import pytest

from consistent_id import NotExcitedError, Recording
from consistent_id.comparison.speed_trend import (
    SpeedTrend,
    TrendAt,
    joint_speeds,
    speed_of,
    speed_trend,
)
from consistent_id.estimation.uncertainties.block_scatter import BlockScatter

SPEEDS = np.array([0.85, 0.9, 0.95, 1.0, 1.1, 1.25])
NAMES = ("hip.viscous", "hip.rotor_inertia")


def blocks(values, noise):
    zero = np.zeros(len(NAMES))
    return [
        BlockScatter(NAMES, row, np.full(len(NAMES), noise), zero, 1, zero + np.inf)
        for row in values
    ]


def drawn(rng, speeds, between, noise):
    """Values of a line in the logarithm of speed, each block with a shift."""
    line = np.array([2.0, -1.0]) + np.log(speeds)[:, None] * [0.5, 1.5]
    scatter = np.hypot(between, noise)
    return blocks(line + scatter * rng.standard_normal(line.shape), noise)


def test_of_noise_alone_a_trend_is_the_line_of_least_squares():
    rng = np.random.default_rng(0)
    # Noise that is stated larger than what is there: nothing is left beyond it.
    values = np.array([b.values for b in drawn(rng, SPEEDS, 0.0, 0.01)])
    trend = speed_trend(blocks(values, 0.05), SPEEDS)
    assert trend.between.tolist() == [0.0, 0.0]
    for k, column in enumerate(values.T):
        slope, level = np.polyfit(np.log(SPEEDS), column, 1)
        assert trend.at(2.0)[k] == pytest.approx(level + slope * np.log(2.0))
    # The error of a line at x: s^2 (1/n + (x - mean)^2 / sum of squares).
    x = np.log(SPEEDS)
    away = (np.log(2.0) - x.mean()) ** 2 / ((x - x.mean()) ** 2).sum()
    error = 0.05 * np.sqrt(1.0 / len(x) + away)
    assert trend.standard_errors(2.0) == pytest.approx(error)


def test_scatter_beyond_noise_is_found_by_its_expectation():
    rng = np.random.default_rng(1)
    values = np.array([b.values for b in drawn(rng, SPEEDS, 0.3, 0.0)])
    noise = 0.02
    trend = speed_trend(blocks(values, noise), SPEEDS)
    x = np.log(SPEEDS)
    for k, column in enumerate(values.T):
        left = column - np.polyval(np.polyfit(x, column, 1), x)
        expected = np.sqrt((left**2).sum() / (len(x) - 2) - noise**2)
        assert trend.between[k] == pytest.approx(expected)  # noise alike: closed form


def test_intervals_are_of_students_t_with_scatter_and_both_noises():
    """Errors of 3, 4 and 12 are 13 together; of six blocks 2.776 of them are 95 %."""
    lines, covariances = np.zeros((2, 2)), np.zeros((2, 2, 2))
    covariances[:, 0, 0] = 3.0**2
    trend = SpeedTrend(NAMES, SPEEDS, lines, covariances, np.full(2, 4.0))
    for away, held in ((2.77 * 13.0, True), (2.78 * 13.0, False)):
        (other,) = blocks([[away, -away]], 12.0)
        assert trend.holds(other, 1.3).tolist() == [held, held]


@pytest.mark.slow
@pytest.mark.parametrize(("between", "noise"), [(0.0, 0.05), (0.1, 0.03)])
@pytest.mark.parametrize("speed", [1.0, 2.3])
def test_intervals_hold_blocks_of_their_speed(between, noise, speed):
    held = []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        trend = speed_trend(drawn(rng, SPEEDS, between, noise), SPEEDS)
        (other,) = drawn(rng, np.array([speed]), between, noise)
        held.append(trend.holds(other, speed))
    # 600 values: 95 % less three standard errors of a share is 92 %; where there is
    # no scatter, what is left of noise is taken for some, on the safe side.
    assert 0.92 <= np.mean(held) <= 1.0
    if between:
        assert np.mean(held) <= 0.98


def test_speeds_are_each_joint_s_over_its_own():
    time = np.arange(100) / 100.0
    dq = np.column_stack([np.full(100, 2.0), np.full(100, 0.1), np.zeros(100)])
    log = Recording(("a", "b", "c"), time, dq, dq)
    twice = Recording(("a", "b", "c"), time, dq, dq * [3.0, 1.0, 1.0])
    scale = joint_speeds([log])
    assert scale == pytest.approx([2.0, 0.1, 0.0])
    assert speed_of([twice], scale) == pytest.approx(2.0)  # the mean of 3 and 1
    assert speed_of([log]) == pytest.approx(1.0)


def test_blocks_of_one_speed_show_no_trend():
    rng = np.random.default_rng(0)
    with pytest.raises(NotExcitedError, match="different speeds"):
        speed_trend(drawn(rng, np.ones(6), 0.0, 0.1), np.ones(6))
    with pytest.raises(NotExcitedError, match="3 blocks"):
        speed_trend(drawn(rng, SPEEDS[:3], 0.0, 0.1), SPEEDS[:3])
    resting = np.append(0.0, SPEEDS[1:])
    with pytest.raises(NotExcitedError, match="from 0 to"):
        speed_trend(drawn(rng, SPEEDS, 0.0, 0.1), resting)


def test_what_is_expected_says_at_which_speed():
    trend = speed_trend(drawn(np.random.default_rng(0), SPEEDS, 0.0, 0.1), SPEEDS)
    text = TrendAt(trend, 1.9).table().text()
    assert "1.90 times as fast" in text and "beyond its blocks" in text
    assert "within its blocks" in TrendAt(trend, 1.0).table().text()
    record = TrendAt(trend, 1.9).to_dict()
    width = record["parameters"]["hip.viscous"]["half_width"]
    expected = trend.quantile * trend.standard_errors(1.9)[0]
    assert width == pytest.approx(expected)


@pytest.mark.parametrize("count", [3, 4])
def test_four_blocks_are_the_fewest_for_a_trend(count):
    speeds = np.array([0.5, 0.8, 1.1, 1.6])[:count]
    few = drawn(np.random.default_rng(0), speeds, 0.0, 0.01)
    if count == 4:
        assert speed_trend(few, speeds).at(1.0) == pytest.approx([2.0, -1.0], abs=0.1)
    else:
        with pytest.raises(NotExcitedError, match="expected four or more"):
            speed_trend(few, speeds)
