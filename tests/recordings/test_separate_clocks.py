"""A channel of another clock: which clock is kept, and what is filtered before."""

from dataclasses import replace

import numpy as np
import pytest

from consistent_id import Recording, RecordingError
from consistent_id.recordings.signals.tracks import (
    Track,
    aligned,
    estimate_delay,
    track,
)

TIME = np.arange(401) / 100.0


def log(time=TIME, values=None):
    position = np.sin(2.0 * time)[:, None] if values is None else values[:, None]
    return Recording(("j",), time, position, name="log")


def beside(rate, duration=4.0, start=0.0):
    time = start + np.arange(int(duration * rate + 1e-9) + 1) / rate
    return Track("torque", ("j",), time, np.cos(2.0 * time)[:, None], name="drive")


@pytest.mark.parametrize(
    ("rate", "kept", "filtered"),
    [
        (94.0, 94.0, True),
        (96.0, 100.0, False),  # within 5 %
        (104.0, 100.0, False),
        (106.0, 100.0, True),
        (300.0, 100.0, True),
    ],
)
def test_the_slower_clock_is_kept_and_filters_only_where_one_is(rate, kept, filtered):
    found = aligned(log(), beside(rate))
    assert found.rate == pytest.approx(kept)
    middle = slice(50, -50)
    expected = np.cos(2.0 * found.time[middle])
    np.testing.assert_allclose(found.torque[middle, 0], expected, atol=1e-5)
    same = np.array_equal(found.position, np.sin(2.0 * found.time)[:, None])
    assert same is not filtered
    assert found.torque_filter is None


def test_what_the_slower_clock_cannot_carry_is_filtered_before():
    """To half its size, forth and back, at 0.8 of half the slower rate: 20 Hz."""
    for frequency, share in ((10.0, 1.0), (20.0, 0.5), (24.0, 0.0)):
        wave = np.sin(2.0 * np.pi * frequency * TIME)
        found = aligned(log(values=wave), beside(50.0))
        seen = found.position[50:150, 0]
        expected = share * np.sin(2.0 * np.pi * frequency * found.time[50:150])
        assert abs(seen - expected).max() < 0.12


def test_a_delay_moves_the_stamps_of_the_track():
    found = aligned(log(), beside(100.0, start=0.25), delay=0.25)
    shifted = np.cos(2.0 * (found.time + 0.25))
    np.testing.assert_allclose(found.torque[:, 0], shifted, atol=1e-6)
    assert found.time.tolist() == TIME.tolist()
    with pytest.raises(RecordingError, match="delay is nan"):
        aligned(log(), beside(100.0), delay=np.nan)


def test_a_track_whose_steps_differ_is_brought_to_even_ones():
    rng = np.random.default_rng(0)
    time = np.sort(np.arange(1201) / 300.0 + rng.uniform(-3e-4, 3e-4, 1201))
    wobbly = Track("torque", ("j",), time, np.cos(2.0 * time)[:, None])
    found = aligned(log(), wobbly)
    expected = np.cos(2.0 * found.time)
    assert abs(found.torque[30:-30, 0] - expected[30:-30]).max() < 1e-4


def test_two_samples_in_common_are_enough_to_align():
    assert len(aligned(log(), beside(100.0, start=3.99))) == 2
    with pytest.raises(RecordingError, match="no two samples in common"):
        aligned(log(), beside(100.0, start=4.0))


@pytest.mark.parametrize(("lost", "refused"), [(9, False), (10, True)])
def test_a_gap_of_more_than_ten_steps_is_not_bridged(lost, refused):
    """Where it is within both; in steps of 1/128 s, whose sums are exact."""
    time = np.arange(401) / 128.0
    gap = np.delete(time, slice(200, 200 + lost))
    for whole, cut in ((time, gap), (gap, time)):
        other = Track("torque", ("j",), cut, np.cos(cut)[:, None])
        if refused:
            with pytest.raises(
                RecordingError, match=r"a gap of 0\.08594 s at t = 1\.55"
            ):
                aligned(log(whole), other)
        else:
            aligned(log(whole), other)
    early = Track("torque", ("j",), time[:150], np.cos(time[:150])[:, None])
    aligned(log(gap), early)


def test_a_track_has_a_channel_that_recordings_have():
    with pytest.raises(RecordingError, match="channel is 'current', expected one of"):
        replace(beside(100.0), channel="current")
    with pytest.raises(RecordingError, match="has no torque"):
        track(log(), "torque")


@pytest.mark.slow
def test_a_delay_of_the_reference_is_a_negative_one_with_the_inverse_gain():
    time = np.arange(2000) / 100.0
    angle, rate = np.sin(3 * time + time**2 / 8), 3 + time / 4
    speed = rate * np.cos(3 * time + time**2 / 8)
    position = Track("position", ("j",), time, angle[:, None])
    velocity = Track("velocity", ("j",), time + 0.123, 4.0 * speed[:, None])
    late, early = estimate_delay(position, velocity), estimate_delay(velocity, position)
    assert late.gains[0] == pytest.approx(4.0, rel=1e-3)
    assert late.correlations[0] == pytest.approx(1.0, abs=1e-6)
    assert early.seconds == -late.seconds == pytest.approx(-0.123, abs=1e-4)
    assert early.gains[0] == pytest.approx(0.25, rel=1e-3)
    assert early.standard_error == late.standard_error
    for longest in (0.0, np.inf, -1.0):
        with pytest.raises(RecordingError, match="longest is"):
            estimate_delay(position, velocity, longest=longest)
    with pytest.raises(RecordingError, match="the longest that was tried"):
        estimate_delay(position, velocity, longest=0.1)
    assert estimate_delay(position, velocity, longest=0.1232).seconds < 0.1232


@pytest.mark.parametrize("gain", [0.4, 2.5])
def test_a_gain_against_the_lower_derivative_is_the_inverse_whatever_its_size(gain):
    time = np.arange(1200) / 100.0
    angle, rate = np.sin(3 * time + time**2 / 8), 3 + time / 4
    place = Track("position", ("j",), time, angle[:, None])
    speed = gain * (rate * np.cos(3 * time + time**2 / 8))[:, None]
    found = estimate_delay(Track("velocity", ("j",), time, speed), place, cutoff=5.0)
    assert found.gains == pytest.approx([1.0 / gain], rel=1e-3)
