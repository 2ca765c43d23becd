"""Channels that are slower than the log they are in."""

import numpy as np
import pytest

from consistent_id.recordings.signals.masks import held_samples

TIME = np.arange(4000) / 1000.0
SMOOTH = np.sin(3.0 * TIME) + 0.4 * np.sin(11.0 * TIME)


def held_for(runs):
    """Readings of which each is held for as many samples as a run is long."""
    new = np.cumsum(runs)
    return SMOOTH[np.r_[0, new][np.searchsorted(new, np.arange(new[-2]), "right")]]


@pytest.mark.parametrize("samples", [2, 5, 100])
def test_a_channel_that_is_held_says_for_how_long(samples):
    held = SMOOTH[np.arange(len(TIME)) // samples * samples]
    assert held_samples(held) == samples


@pytest.mark.parametrize("samples", [20, 5])
def test_a_clock_that_jitters_holds_about_as_long(samples):
    rng = np.random.default_rng(0)
    assert held_samples(held_for(samples + rng.integers(-1, 2, 150))) == samples


def test_a_few_readings_may_be_missing():
    """One in seven is a few; three in ten are too many for a clock."""
    assert held_samples(held_for([5, 5, 5, 5, 5, 5, 15] * 20)) == 5
    assert held_samples(held_for([5, 5, 5, 5, 5, 5, 5, 15, 15, 15] * 20)) == 1


def test_readings_that_are_rounded_clipped_at_rest_or_of_one_value_are_not_held():
    rest = np.where(TIME < 2.0, SMOOTH, SMOOTH[2000])
    for values in (
        SMOOTH,
        np.round(SMOOTH / 0.1) * 0.1,
        np.round(SMOOTH / 0.01) * 0.01,
        np.clip(SMOOTH, -0.3, 0.3),
        rest,
        np.ones(100),
        np.ones(1),
    ):
        assert held_samples(values) == 1
