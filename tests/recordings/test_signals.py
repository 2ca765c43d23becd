"""Signals: closed forms of tones and polynomials are the truth."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from consistent_id import signals
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording

CHANNELS = ("position", "velocity", "acceleration", "torque")
RATE = 500.0  # [Hz]
# Filtered tones, of amplitudes up to 4.  Motion: order 8's slowest pole has decayed by
# 1e-10 one second from the ends.  Torque: the kernel ends at 1e-6 of its peak.
EXACT = {"position": 1e-9, "velocity": 1e-9, "acceleration": 1e-9, "torque": 1e-5}
FUNCTIONS = [
    partial(signals.low_passed, motion_cutoff=5.0, torque_cutoff=5.0),
    partial(signals.decimated, factor=3),
    signals.differentiated,
    partial(signals.trimmed, start=0.1),
    partial(signals.resampled, rate=450.0),
]
# Seeds explicit: hypothesis derives its examples from the test's own source.
REPEATABLE = settings(derandomize=True, deadline=None, max_examples=40)


def clock(samples, rate=RATE):
    return np.arange(samples) / rate


def log(time, position, **channels):
    shaped = {name: values[:, None] for name, values in channels.items()}
    return Recording(("elbow",), time, position[:, None], **shaped, name="log 7")


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


def butterworth_twice(frequency, cutoff, order):
    """Gain of a bilinear Butterworth filter run forwards and backwards."""
    warped = np.tan(np.pi * frequency / RATE) / np.tan(np.pi * cutoff / RATE)
    return 1 / (1 + warped ** (2 * order))


def interior(values):
    """The middle half, where what was assumed beyond the ends has died out."""
    return values[len(values) // 4 : -(len(values) // 4)]


def cubic(time):
    return 2.0 - time + 0.5 * time**2 - 0.25 * time**3


@pytest.mark.slow
@REPEATABLE
@example(6, 1.7, 2.0)
@given(st.integers(4, 60), st.floats(0.5, 5.0), st.floats(0.81, 20.0))
def test_resampling_reproduces_a_cubic_on_a_clock_within_the_recording(
    samples, duration, ratio
):
    time = 3.0 + jittered(samples, duration)
    rate = ratio * (samples - 1) / (time[-1] - time[0])
    even = signals.resampled(
        log(time, cubic(time), torque=7 * cubic(time)), rate, upwards=True
    )
    assert even.time[0] == time[0] and even.time[-1] <= time[-1]
    # Rounding of times near 8 s is 1e-15 s, of the number of steps 1e-12.
    assert time[-1] - even.time[-1] < 1 / rate + 1e-12
    assert abs(np.diff(even.time) - 1 / rate).max() < 1e-11
    # Values up to 150 and a spline on steps that differ fivefold: 1e-10 is rounding.
    np.testing.assert_allclose(even.position[:, 0], cubic(even.time), atol=1e-10)
    np.testing.assert_allclose(even.torque, 7 * even.position, atol=1e-9)


def test_resampling_a_band_limited_signal_converges_with_the_fourth_power():
    def error(samples):
        time = jittered(samples, 2.0)
        even = signals.resampled(log(time, tone(time, 2.0)), 300.0, upwards=True)
        off = even.position[:, 0] - tone(even.time, 2.0)
        # Hall & Meyer 1976: a cubic spline is off by at most 5/384 h^4 max|f''''|.
        bound = 5 / 384 * (np.diff(time).max() * 2 * np.pi * 2.0) ** 4
        assert abs(interior(off)).max() < bound
        return np.sqrt(np.mean(off**2))

    # 16 at each halving; jitter differs between the grids, so within a factor of two.
    assert 8.0 < error(201) / error(401) < 32.0


def test_a_gap_is_refused_unless_it_is_allowed():
    time = np.delete(clock(200), range(80, 92))  # leaves one step of 13 periods
    recording = log(time, tone(time, 1.0))
    with pytest.raises(RecordingError, match=r"gap of 0\.026 s after sample 79 \(t ="):
        signals.resampled(recording, RATE)
    assert len(signals.resampled(recording, RATE, max_gap=0.027)) == 200


@pytest.mark.parametrize(
    ("name", "asked", "message"),
    [
        *(("resampled", {"rate": r}, "a positive number") for r in (0, -1, np.inf)),
        ("resampled", {"rate": 100.0}, "would be aliased"),
        ("resampled", {"rate": 630.0}, "samples would be invented"),
        *(("decimated", {"factor": f}, f"is {f}, expected 1, 2") for f in (0, -2, 1.5)),
        *(
            ("low_passed", {f"{which}_cutoff": cutoff}, "sampling rate, 250 Hz")
            for which in ("motion", "torque")
            for cutoff in (0.0, -1.0, RATE / 2, RATE, np.nan)
        ),
    ],
)
def test_what_a_sampled_signal_cannot_give_is_refused(name, asked, message):
    with pytest.raises(RecordingError, match=message):
        getattr(signals, name)(tones(5.0), **asked)


@pytest.mark.parametrize("start", [0.0, -3.0, 1.7e9])
def test_a_uniform_clock_is_recognised_whatever_its_origin(start):
    time = start + clock(1000)
    # Epoch stamps round to 2.4e-7 s, of 2 s in all.
    assert signals.uniform_rate(log(time, time)) == pytest.approx(RATE, rel=3e-7)


def test_steps_may_differ_by_a_thousandth_and_no_more():
    time = clock(500)
    late = np.where(time >= time[300], 1e-3 / RATE, 0.0)
    signals.uniform_rate(log(time + 0.9 * late, time))
    with pytest.raises(RecordingError, match=r"after sample 299 is .*resampled"):
        signals.uniform_rate(log(time + 1.1 * late, time))


def test_a_single_step_that_is_too_short_makes_a_clock_uneven():
    time = clock(2000)
    more = np.insert(time, 1200, time[1199] + 0.3 / RATE)
    with pytest.raises(RecordingError, match=r"after sample 1199 is"):
        signals.uniform_rate(log(more, more))


@pytest.mark.parametrize("function", FUNCTIONS[:3])
def test_functions_that_need_a_uniform_clock_refuse_another(function):
    time = jittered(200, 2.0)
    with pytest.raises(RecordingError, match="clock is not uniform"):
        function(log(time, time))


@pytest.mark.parametrize("order", [1, 2, 4, 8])
@pytest.mark.parametrize("frequency", [5.0, 15.0, 20.0, 24.0, 60.0])
def test_the_filter_scales_a_tone_without_lag_in_its_own_channels(order, frequency):
    recording, cutoff = tones(frequency), 20.0
    gain = butterworth_twice(frequency, cutoff, order)
    assert frequency != cutoff or gain == 0.5  # 6 dB
    motion = signals.low_passed(recording, motion_cutoff=cutoff, order=order)
    torque = signals.low_passed(recording, torque_cutoff=cutoff, order=order)
    for channel in CHANNELS:
        kept, filtered = (motion, torque) if channel == "torque" else (torque, motion)
        before = getattr(recording, channel)
        assert (getattr(kept, channel) == before).all()
        off = interior(getattr(filtered, channel) - gain * before)
        assert abs(off).max() < EXACT[channel]


def test_the_filter_leaves_a_straight_line_alone_up_to_its_ends():
    time = clock(1000)
    recording = log(time, 3.0 - 2.0 * time)
    smooth = signals.low_passed(recording, motion_cutoff=10.0)
    # The odd extension continues a line; the padding starts at rest to 1e-6.
    np.testing.assert_allclose(smooth.position, recording.position, rtol=0, atol=1e-6)


def test_differences_of_polynomials_are_exact_up_to_the_ends():
    time = clock(50, rate=20.0)
    bend = signals.differentiated(log(time, cubic(time))).acceleration[:, 0]
    # Second differences of values near 1 over (0.05 s)^2 round to 1e-12.
    np.testing.assert_allclose(bend, 1.0 - 1.5 * time, atol=1e-11)
    slope = signals.differentiated(log(time, 3 * time**2 - time)).velocity[:, 0]
    np.testing.assert_allclose(slope, 6 * time - 1, atol=1e-11)


@pytest.mark.parametrize("measured", [(), ("velocity",), ("acceleration",)])
def test_halving_the_step_quarters_the_error_of_derivatives(measured):
    def errors(samples):
        time, w = clock(samples, (samples - 1) / 2.0), 2 * np.pi * 1.5
        sine, cosine = tone(time, 1.5), tone(time, 1.5, 0.3 + np.pi / 2)
        truth = {"velocity": w * cosine, "acceleration": -w * w * sine}
        known = {k: truth[k] for k in measured}
        full = signals.differentiated(log(time, sine, **known))
        off = {k: getattr(full, k)[:, 0] - truth[k] for k in truth}
        assert all(not off.pop(k).any() for k in measured)  # what is known is kept
        return np.array([[abs(e).max(), abs(interior(e)).max()] for e in off.values()])

    ends, inside = (errors(401) / errors(801)).T
    # Next terms of the series: (w h)^2 = 2e-3 inside, some w h = 0.05 at the ends.
    np.testing.assert_allclose(inside, 4.0, rtol=2e-3)
    np.testing.assert_allclose(ends, 4.0, rtol=0.1)


def test_a_measured_velocity_is_kept_even_where_it_disagrees_with_position():
    time = clock(100)
    full = signals.differentiated(log(time, 0 * time, velocity=7 * time))
    assert (full.velocity[:, 0] == 7 * time).all()
    np.testing.assert_allclose(full.acceleration, 7.0, rtol=1e-11)  # rounding


def test_four_samples_are_differentiated_and_three_refused():
    assert signals.differentiated(tones(1.0, samples=4)).velocity.shape == (4, 1)
    with pytest.raises(RecordingError, match="3 samples, expected 4 or more"):
        signals.differentiated(tones(1.0, samples=3))


@REPEATABLE
@given(st.integers(-5, 35), st.integers(-5, 35))
def test_trimming_keeps_both_ends_of_the_interval(start, stop):
    recording = tones(50.0, samples=30)
    a, b = start / RATE, stop / RATE  # the very stamps, so that ends are met exactly
    inside = (recording.time >= a) & (recording.time <= b)
    if inside.sum() < 2:
        with pytest.raises(RecordingError, match=r"it runs from 0 s to 0\.058 s"):
            signals.trimmed(recording, a, b)
        return
    part = signals.trimmed(recording, a, b)
    for name in ("time", *CHANNELS):
        assert (getattr(part, name) == getattr(recording, name)[inside]).all()


@pytest.mark.parametrize("factor", [2, 5, 10])
def test_decimation_passes_low_tones_and_removes_those_that_would_alias(factor):
    nyquist = RATE / (2 * factor)
    for frequency in (0.3 * nyquist, 1.5 * nyquist, 1.9 * nyquist):
        full = tones(frequency, samples=8000)
        gain = butterworth_twice(frequency, 0.8 * nyquist, order=8)
        assert gain > 0.9999 if frequency < nyquist else gain < 1e-4
        for recording in (replace(full, torque=None), replace(full, acceleration=None)):
            few = signals.decimated(recording, factor)
            assert (few.time == recording.time[::factor]).all()
            for channel in recording.channels:
                before = getattr(recording, channel)[::factor]
                off = interior(getattr(few, channel) - gain * before)
                assert abs(off).max() < EXACT[channel]


def test_motion_that_has_been_differentiated_beside_a_torque_is_only_thinned():
    recording = tones(60.0, samples=8000)
    few = signals.decimated(recording, 5)
    for channel in CHANNELS[:3]:
        before = getattr(recording, channel)
        assert (getattr(few, channel) == before[::5]).all()
    gain = butterworth_twice(60.0, 40.0, order=8)
    off = interior(few.torque - gain * recording.torque[::5])
    assert abs(off).max() < EXACT["torque"] < gain * 4


@pytest.mark.parametrize("function", FUNCTIONS)
def test_functions_leave_their_input_as_it_was(function):
    recording = tones(5.0)
    before = {n: getattr(recording, n).copy() for n in ("time", *CHANNELS)}
    result = function(recording)
    assert result is not recording and result.name == "log 7"
    for name, values in before.items():
        assert (getattr(recording, name) == values).all()
        assert not np.shares_memory(getattr(recording, name), getattr(result, name))
