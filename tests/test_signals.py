"""Signals: closed forms of tones and polynomials are the truth."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from consistent_id import signals
from consistent_id.errors import RecordingError
from consistent_id.recording import Recording

CHANNELS = ("position", "velocity", "acceleration", "torque")
RATE = 500.0  # [Hz]
# Seeds explicit: hypothesis derives its examples from the test's own source.
REPEATABLE = settings(derandomize=True, deadline=None, max_examples=100)


def log(time, position, **channels):
    shaped = {name: values[:, None] for name, values in channels.items()}
    return Recording(("elbow",), time, position[:, None], **shaped, name="log 7")


def clock(samples, rate=RATE):
    return np.arange(samples) / rate


def tone(time, frequency, phase=0.3):
    return np.sin(2 * np.pi * frequency * time + phase)


def tones(frequency, samples=2000):
    """A recording of one tone, with another amplitude in each channel."""
    time = clock(samples)
    sine = tone(time, frequency)
    return log(time, sine, velocity=2 * sine, acceleration=3 * sine, torque=4 * sine)


def jittered(samples, duration, seed=0):
    """Increasing stamps from 0 to `duration`, off a uniform clock by up to a third."""
    step = duration / (samples - 1)
    jitter = np.random.default_rng(seed).uniform(-1 / 3, 1 / 3, samples) * step
    jitter[[0, -1]] = 0.0
    return np.arange(samples) * step + jitter


def butterworth_twice(frequency, cutoff, order, rate=RATE):
    """Gain of a bilinear Butterworth filter run forwards and backwards."""
    warped = np.tan(np.pi * frequency / rate) / np.tan(np.pi * cutoff / rate)
    return 1 / (1 + warped ** (2 * order))


def interior(values, share=0.25):
    """The middle, where what the filter assumed beyond the ends has died out."""
    edge = int(share * len(values))
    return values[edge:-edge]


def cubic(time):
    return 2.0 - time + 0.5 * time**2 - 0.25 * time**3


@REPEATABLE
@given(st.integers(4, 60), st.floats(0.5, 5.0), st.floats(2.0, 200.0))
def test_resampling_reproduces_a_cubic_on_a_clock_within_the_recording(
    samples, duration, rate
):
    time = 3.0 + jittered(samples, duration)
    recording = log(time, cubic(time), torque=7 * cubic(time))
    if duration * rate < 1.0:
        with pytest.raises(RecordingError, match="1 samples, expected 2"):
            signals.resampled(recording, rate)
        return
    even = signals.resampled(recording, rate)
    assert even.time[0] == time[0] and even.time[-1] <= time[-1]
    # Rounding of times near 8 s is 1e-15 s, of the number of steps 1e-12.
    assert time[-1] - even.time[-1] < 1 / rate + 1e-12
    np.testing.assert_allclose(np.diff(even.time), 1 / rate, rtol=0, atol=1e-11)
    # Values up to 150 and a spline on steps that differ fivefold: 1e-10 is rounding.
    np.testing.assert_allclose(even.position[:, 0], cubic(even.time), atol=1e-10)
    np.testing.assert_allclose(even.torque, 7 * even.position, atol=1e-9)
    assert even.velocity is None and even.acceleration is None


def test_resampling_a_band_limited_signal_converges_with_the_fourth_power():
    def error(samples):
        time = jittered(samples, 2.0)
        signal = tone(time, 1.5) + 0.5 * tone(time, 3.0)
        even = signals.resampled(log(time, signal), 300.0)
        truth = tone(even.time, 1.5) + 0.5 * tone(even.time, 3.0)
        bend = (2 * np.pi) ** 4 * (1.5**4 + 0.5 * 3.0**4)
        # Hall & Meyer 1976: a cubic spline is off by at most 5/384 h^4 max|f''''|.
        bound = 5 / 384 * np.diff(time).max() ** 4 * bend
        assert abs(interior(even.position[:, 0] - truth)).max() < bound
        return np.sqrt(np.mean((even.position[:, 0] - truth) ** 2))

    # 16 at each halving; jitter differs between the grids, so within a factor of two.
    assert 8.0 < error(201) / error(401) < 32.0


def test_resampling_a_uniform_recording_at_its_rate_changes_nothing():
    recording = tones(5.0, samples=1001)
    same = signals.resampled(recording, RATE)
    np.testing.assert_allclose(same.time, recording.time, rtol=0, atol=1e-15)
    for channel in CHANNELS:  # rounding of values up to 4
        before, after = getattr(recording, channel), getattr(same, channel)
        np.testing.assert_allclose(after, before, rtol=0, atol=1e-13)


def test_a_gap_is_refused_unless_it_is_allowed():
    time = np.delete(clock(200), range(80, 92))  # leaves one step of 13 periods
    recording = log(time, tone(time, 1.0))
    with pytest.raises(
        RecordingError, match=r"gap of 0\.026 s after sample 79 \(t = 0\.158 s\)"
    ):
        signals.resampled(recording, RATE)
    with pytest.raises(RecordingError, match=r"longer than 0\.02 s"):
        signals.resampled(recording, RATE, max_gap=0.02)
    assert len(signals.resampled(recording, RATE, max_gap=0.027)) == 200


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf])
def test_a_rate_that_is_not_positive_is_refused(rate):
    with pytest.raises(RecordingError, match="expected a positive number"):
        signals.resampled(tones(1.0), rate)


@pytest.mark.parametrize("start", [0.0, -3.0, 1.7e9])
def test_a_uniform_clock_is_recognised_whatever_its_origin(start):
    time = start + clock(1000)
    # 1000 steps: epoch stamps round to 2.4e-7 s, of 2 s in all.
    rate = signals.uniform_rate(log(time, time))
    assert rate == pytest.approx(RATE, rel=3e-7)


def test_steps_may_differ_by_a_thousandth_and_no_more():
    for late, uniform in ((0.9e-3, True), (1.1e-3, False)):
        time = clock(500)
        time[300:] += late / RATE
        if uniform:
            signals.uniform_rate(log(time, time))
            continue
        with pytest.raises(RecordingError, match=r"after sample 299 is .*resampled"):
            signals.uniform_rate(log(time, time))


@pytest.mark.parametrize(
    "function",
    [
        partial(signals.low_passed, motion_cutoff=5.0),
        signals.differentiated,
        partial(signals.decimated, factor=2),
    ],
)
def test_functions_that_need_a_uniform_clock_refuse_another(function):
    time = jittered(200, 2.0)
    with pytest.raises(RecordingError, match="clock is not uniform"):
        function(log(time, time))


@pytest.mark.parametrize("order", [1, 2, 4, 8])
@pytest.mark.parametrize("frequency", [5.0, 15.0, 20.0, 24.0, 60.0])
def test_the_filter_scales_a_tone_without_lag(order, frequency):
    cutoff = 20.0
    gain = butterworth_twice(frequency, cutoff, order)
    if frequency == cutoff:
        assert gain == 0.5  # 6 dB
    recording = tones(frequency)
    smooth = signals.low_passed(
        recording, motion_cutoff=cutoff, torque_cutoff=cutoff, order=order
    )
    for channel in CHANNELS:
        before, after = getattr(recording, channel), getattr(smooth, channel)
        # One second from the ends, order 8's slowest pole has decayed by 1e-10.
        np.testing.assert_allclose(
            interior(after), gain * interior(before), rtol=0, atol=1e-9
        )


def test_the_filter_leaves_a_straight_line_alone_up_to_its_ends():
    time = clock(1000)
    recording = log(time, 3.0 - 2.0 * time, torque=np.full(1000, 7.0))
    smooth = signals.low_passed(recording, motion_cutoff=10.0, torque_cutoff=10.0)
    # The odd extension continues a line; the padding starts at rest to 1e-6.
    np.testing.assert_allclose(smooth.torque, recording.torque, rtol=0, atol=1e-9)
    np.testing.assert_allclose(smooth.position, recording.position, rtol=0, atol=1e-6)


def test_each_cutoff_acts_on_its_own_channels():
    recording = tones(60.0)
    motion = signals.low_passed(recording, motion_cutoff=5.0)
    torque = signals.low_passed(recording, torque_cutoff=5.0)
    for channel in CHANNELS:
        kept, filtered = motion, torque
        if channel != "torque":
            kept, filtered = torque, motion
        before = getattr(recording, channel)
        np.testing.assert_array_equal(getattr(kept, channel), before)
        # (60 Hz / 5 Hz)^8 is 4e8.
        assert abs(interior(getattr(filtered, channel))).max() < 1e-7


@pytest.mark.parametrize("cutoff", [0.0, -1.0, RATE / 2, RATE, np.nan])
@pytest.mark.parametrize("which", ["motion_cutoff", "torque_cutoff"])
def test_a_cutoff_beyond_nyquist_is_refused(which, cutoff):
    with pytest.raises(RecordingError, match="half of the sampling rate, 250 Hz"):
        signals.low_passed(tones(5.0), **{which: cutoff})


def test_differences_are_exact_for_cubics_up_to_the_ends():
    time = clock(50, rate=20.0)
    recording = signals.differentiated(log(time, cubic(time)))
    # Second differences of values near 1 over (0.05 s)^2 round to 1e-12.
    np.testing.assert_allclose(
        recording.acceleration[:, 0], 1.0 - 1.5 * time, rtol=0, atol=1e-11
    )
    parabola = signals.differentiated(log(time, 3 * time**2 - time))
    np.testing.assert_allclose(
        parabola.velocity[:, 0], 6 * time - 1, rtol=0, atol=1e-11
    )


@pytest.mark.parametrize("measured", ["position", "velocity", "acceleration"])
def test_halving_the_step_quarters_the_error_of_derivatives(measured):
    def errors(samples):
        rate = (samples - 1) / 2.0
        w, time = 2 * np.pi * 1.5, clock(samples, rate)
        truth = tone(time, 1.5), w * tone(time, 1.5, 0.3 + np.pi / 2)
        known = {} if measured == "position" else {measured: truth[1]}
        if measured == "acceleration":
            known = {measured: -(w**2) * truth[0]}
        full = signals.differentiated(log(time, truth[0], **known))
        off = full.velocity[:, 0] - truth[1], full.acceleration[:, 0] + w**2 * truth[0]
        return np.array([[abs(e).max(), abs(interior(e)).max()] for e in off])

    coarse, fine = errors(401), errors(801)
    known = {"position": [], "velocity": [0], "acceleration": [1]}[measured]
    np.testing.assert_array_equal(coarse[known], 0.0)  # what was measured is kept
    missing = [row for row in (0, 1) if row not in known]
    # Next term of the series: (w h)^2 of 4, 2e-3; one-sided ends, w h, 5 per cent.
    np.testing.assert_allclose(coarse[missing, 1] / fine[missing, 1], 4.0, rtol=2e-3)
    np.testing.assert_allclose(coarse[missing] / fine[missing], 4.0, rtol=0.05)


def test_a_measured_velocity_is_kept_even_where_it_disagrees_with_position():
    time = clock(100)
    full = signals.differentiated(log(time, 0 * time, velocity=7 * time, torque=time))
    np.testing.assert_array_equal(full.velocity[:, 0], 7 * time)
    np.testing.assert_allclose(full.acceleration, 7.0, rtol=1e-11)  # rounding
    np.testing.assert_array_equal(full.torque[:, 0], time)
