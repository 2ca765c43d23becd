"""Channels that are slower than the log they are in."""

import numpy as np
import pytest

from consistent_id.recordings.signals.resolution import held_samples

TIME = np.arange(4000) / 1000.0
SMOOTH = np.sin(3.0 * TIME) + 0.4 * np.sin(11.0 * TIME)


@pytest.mark.parametrize("samples", [2, 5, 100])
def test_a_channel_that_is_held_says_for_how_long(samples):
    held = SMOOTH[np.arange(len(TIME)) // samples * samples]
    assert held_samples(held) == samples


def test_a_clock_that_jitters_holds_about_as_long():
    rng = np.random.default_rng(0)
    new = np.cumsum(20 + rng.integers(-1, 2, 150))
    held = SMOOTH[np.r_[0, new][np.searchsorted(new, np.arange(2900), "right")]]
    assert held_samples(held) == 20


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
