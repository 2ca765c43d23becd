"""Delays, clocks, gaps, masks and encoder steps: what is known must be found."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import norm, t
from some_fast import some_fast
from swinging_logs import NAMES, log, tones

from consistent_id import signals
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers import Columns, read_recording
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.tracks import (
    _filtered_late,
    _filtered_pair,
    _FilteredSignals,
    _with_error,
)

ORDER = {"position": 0, "velocity": 1, "acceleration": 2, "torque": 0}
DATA = os.environ.get("CONSISTENT_ID_DATASETS", "")


def pair(seed, first, second, rates, noise, seconds=12.0):
    """Two noisy tracks of one motion, the second late by a random delay."""
    rng = np.random.default_rng(seed)
    motion, delay = tones(rng), rng.uniform(-0.2, 0.2)
    tracks = []
    for channel, rate, size, late in zip(
        (first, second), rates, noise, (0.0, delay), strict=True
    ):
        time = np.arange(int(seconds * rate)) / rate
        values = motion(time - late, ORDER[channel])
        values = values + size * rng.normal(size=values.shape)
        tracks.append(signals.Track(channel, NAMES, time, values))
    return (*tracks, delay)


CASES = [
    ("position", "velocity", (500, 500), (1e-4, 0.02)),
    ("position", "acceleration", (1000, 300), (1e-4, 1.0)),
    ("acceleration", "position", (300, 1000), (0.5, 1e-4)),
    ("velocity", "acceleration", (500, 300), (0.01, 0.5)),
    ("position", "position", (100, 125), (1e-3, 1e-3)),
    ("torque", "torque", (500, 500), (0.02, 0.02)),
]


@pytest.mark.slow
@pytest.mark.parametrize(("first", "second", "rates", "noise"), some_fast(CASES, 2))
def test_a_delay_is_found_within_a_tenth_of_a_sample(first, second, rates, noise):
    scores = []
    for seed in range(3):
        a, b, delay = pair(seed, first, second, rates, noise)
        found = signals.estimate_delay(a, b)
        assert abs(found.seconds - delay) < 0.1 / max(rates)
        np.testing.assert_allclose(found.gains, 1.0, rtol=0.02)
        scores.append((found.seconds - delay) / found.standard_error)
    # The cut-off with the least standard error is chosen, so it is somewhat too small.
    assert 0.3 < np.sqrt(np.mean(np.square(scores))) < 3.0


def error_by_leaving_out_blocks(tracks, found):
    """A jackknife over blocks of 2.5 periods of the cut-off, each delay found anew."""
    first, late = (x.recording() for x in tracks)
    late = signals.low_passed(late, motion_cutoff=found.cutoff)
    both = _filtered_pair(first, late, 0, found.cutoff, 0.5, found.cutoff)
    y, samples = both.values[:, 0], np.arange(len(both.time))
    n = int((both.time[-1] - both.time[0]) * found.cutoff / 2.5)

    def without(block):
        kept = np.setdiff1d(samples, block)

        def misfit(shift):
            late = both.reference(both.time[kept] - shift)
            A = np.column_stack([np.ones(len(kept)), late])
            return np.linalg.lstsq(A, y[kept], rcond=None)[1][0]

        near = found.seconds + np.array([-0.02, 0.02])
        return minimize_scalar(misfit, bounds=near, options={"xatol": 1e-8}).x

    delays = np.array([without(block) for block in np.array_split(samples, n)])
    return n, np.sqrt((n - 1) / n * np.sum((delays - delays.mean()) ** 2))


@pytest.mark.slow
def test_the_error_of_a_delay_is_that_of_delays_found_again_without_a_block():
    ratios, time = [], np.arange(1300) / 200.0
    for seed in range(4, 9):
        rng = np.random.default_rng(seed)
        motion = tones(rng, joints=1)
        late = motion(time - 0.05) + 0.02 * rng.normal(size=(len(time), 1))
        tracks = [
            signals.Track("position", NAMES[:1], time, x) for x in (motion(time), late)
        ]
        found = signals.estimate_delay(*tracks, cutoff=5.0)
        n, error = error_by_leaving_out_blocks(tracks, found)
        few = t.ppf(0.975, n - 1) / norm.ppf(0.975)  # in units of a normal one
        ratios.append(found.standard_error / (few * error))
    # One step of Newton's method from the whole log is off by up to 6 %, either way.
    assert ratios == pytest.approx(np.ones(5), abs=0.07)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.03)


def test_a_joint_of_much_noise_does_not_widen_the_error_of_a_delay():
    first, late, _ = pair(0, "position", "velocity", (100, 100), (1e-5, 0.002))
    noise = np.random.default_rng(1).normal(size=len(late.time))
    spoilt = late.values.copy()
    spoilt[:, 1:] += noise[:, None] * 3.0
    both = signals.Track("velocity", NAMES, late.time, spoilt)
    one, other = (
        signals.Track(t.channel, NAMES[:1], t.time, t.values[:, :1])
        for t in (first, late)
    )
    alone = signals.estimate_delay(one, other, cutoff=5.0).standard_error
    beside = signals.estimate_delay(first, both, cutoff=5.0).standard_error
    assert beside < 1.5 * alone


@pytest.mark.slow
def test_a_delay_longer_than_the_longest_is_refused():
    # Slow signals are similar at the longest delay, too: they are still 0.1 s apart.
    time = np.arange(4000) / 100.0
    first, late = (
        signals.Track("position", NAMES[:1], time, np.sin(0.5 * (time - d))[:, None])
        for d in (0.0, 0.3)
    )
    assert signals.estimate_delay(first, late, longest=0.4).seconds == pytest.approx(
        0.3, abs=1e-3
    )
    with pytest.raises(RecordingError, match=r"the longest that was tried; raise"):
        signals.estimate_delay(first, late, longest=0.2)


def test_a_period_of_the_filter_is_left_out_at_each_end_of_the_late_signal():
    def recorded(start, stop):
        time = np.arange(start * 128, stop * 128 + 1) / 128.0  # exact in binary
        return log(time, np.sin(5.0 * time))

    ends = []
    for first, second in ((recorded(0, 40), recorded(10, 30)), (recorded(8, 32),) * 2):
        pair = _filtered_pair(first, second, 0, 20.0, longest=0.5, lowest=1.0)
        ends.append((pair.time[0], pair.time[-1]))
    # Of the reference as much again as the longest delay is needed.
    assert ends == [(11.0, 29.0), (9.5, 30.5)]


@pytest.mark.slow
def test_a_joint_at_rest_says_nothing_and_the_reverse_delay_is_the_negative():
    a, b, _ = pair(1, "position", "velocity", (200, 200), (1e-4, 0.01))
    moving = np.array([1.0, 0.0, 1.0])
    a, b = (signals.Track(x.channel, NAMES, x.time, x.values * moving) for x in (a, b))
    found, back = signals.estimate_delay(a, b), signals.estimate_delay(b, a)
    assert found.gains[1] == 0.0 == back.gains[1]
    assert back.seconds == -found.seconds


def test_a_joint_whose_rate_alone_is_all_zero_says_nothing():
    a, b, truth = pair(1, "position", "velocity", (200, 200), (1e-4, 0.01))
    held = signals.Track(b.channel, NAMES, b.time, b.values * np.array([1.0, 0.0, 1.0]))
    found = signals.estimate_delay(a, held)
    assert found.seconds == pytest.approx(truth, abs=0.5e-3)
    assert found.gains[1] == 0.0 == found.correlations[1]


def test_signals_that_have_no_delay_to_find_are_refused():
    a, b, _ = pair(0, "position", "velocity", (200, 200), (1e-4, 0.01))
    other = pair(9, "position", "velocity", (200, 200), (1e-4, 0.01))[1]
    torque = signals.Track("torque", NAMES, b.time, b.values)
    late = signals.Track("velocity", NAMES, b.time + 60.0, b.values)
    for bad, message in (
        (other, "no delay up to"),
        (torque, "without a model"),
        (late, "too little of both"),
        (signals.Track("velocity", ("x",), b.time, b.values[:, :1]), "no joint in"),
    ):
        with pytest.raises(RecordingError, match=message):
            signals.estimate_delay(a, bad)


@pytest.mark.slow
@pytest.mark.skipif(not (Path(DATA) / "tiago").is_dir() or not DATA, reason="no data")
def test_tiagos_velocity_comes_some_190_ms_after_its_position():
    for file in ("identification/first60.parquet", "validation/last40.parquet"):
        recording = read_recording(
            Path(DATA) / "tiago" / file,
            [f"joint {n}" for n in range(1, 9)],
            Columns(position="q{number}", velocity="dq{number}"),
        )
        found = signals.estimate_delay(
            signals.track(recording, "position"), signals.track(recording, "velocity")
        )
        # Joints by themselves: 0.15 s (arm_1) to 0.20 s (arm_2).
        assert found.seconds == pytest.approx(0.19, abs=0.01)
        assert found.correlations.min() > 0.99


@pytest.mark.slow
def test_three_clocks_are_brought_to_the_slowest():
    rng = np.random.default_rng(4)
    motion, step = tones(rng), 1e-3
    time, slow = np.arange(12000) * step, np.arange(3600) / 300.0
    recording = log(time, motion(time), torque=5 * motion(time))
    late = signals.Track("acceleration", NAMES, slow, motion(slow - 0.0123, 2))
    delay = signals.estimate_delay(signals.track(recording, "position"), late)
    both = signals.aligned(recording, late, delay=delay.seconds)
    assert len(both) < len(late.time) and both.rate == pytest.approx(300.0)
    inside = slice(300, -300)
    t = both.time[inside]
    # A quintic spline through 300 Hz samples of 3 Hz; the filter passes 3 Hz to 1e-9.
    np.testing.assert_allclose(both.position[inside], motion(t), atol=1e-5)
    np.testing.assert_allclose(both.torque[inside], 5 * motion(t), atol=5e-5)
    np.testing.assert_allclose(both.acceleration[inside], motion(t, 2), atol=2e-2)


def test_a_channel_that_lags_is_put_right_on_its_own_clock():
    motion, time = tones(np.random.default_rng(5)), np.arange(2000) / 100.0
    recording = log(time, motion(time), velocity=motion(time - 0.18, 1))
    late = signals.track(recording, "velocity")
    right = signals.aligned(recording, late, delay=0.18)
    assert (right.time == time[time <= time[-1] - 0.18 + 1e-9]).all()
    assert (right.position == recording.position[: len(right)]).all()
    inside = slice(50, -50)
    # Of a cubic spline through 100 Hz samples of 3 Hz tones: 5/384 (w h)^4 of 50.
    np.testing.assert_allclose(
        right.velocity[inside], motion(right.time, 1)[inside], atol=1e-3
    )


def test_the_first_and_the_last_sample_that_both_clocks_have_are_kept():
    motion, time = tones(np.random.default_rng(6)), np.arange(600) / 100.0
    recording = log(time, motion(time))
    inner = signals.Track("velocity", NAMES, time[100:501], motion(time[100:501], 1))
    both = signals.aligned(recording, inner)
    assert (both.time == time[100:501]).all()
    assert (both.position == recording.position[100:501]).all()
    np.testing.assert_allclose(both.velocity, motion(both.time, 1), atol=1e-12)


def test_clocks_that_do_not_meet_or_have_gaps_are_refused():
    time = np.arange(500) / 100.0
    recording = log(time, np.sin(time))
    far = signals.Track("velocity", ("a",), time + 50.0, np.cos(time)[:, None])
    with pytest.raises(RecordingError, match="no two samples in common"):
        signals.aligned(recording, far)
    keep = np.r_[:200, 300:500]
    gappy = signals.Track("velocity", ("a",), time[keep], np.cos(time[keep])[:, None])
    with pytest.raises(RecordingError, match=r"gap of 1\.01 s"):
        signals.aligned(recording, gappy)


def test_parts_between_gaps_hold_every_sample_but_short_runs():
    time = np.delete(np.arange(1000) / 100.0, [*range(300, 320), *range(325, 360)])
    recording = log(time, np.sin(time))
    parts = signals.split_at_gaps(recording, 0.05)
    assert [len(p) for p in parts] == [300, 5, 640]
    assert (np.concatenate([p.time for p in parts]) == time).all()
    assert all(np.diff(p.time).max() < 0.05 for p in parts)
    assert len(signals.split_at_gaps(recording, 0.05, shortest=0.5)) == 2
    assert signals.split_at_gaps(recording, 1.0) == (recording,)
    with pytest.raises(RecordingError, match="none of 3 parts has two samples"):
        signals.split_at_gaps(recording, 0.05, shortest=100.0)


def test_nothing_beyond_a_gap_changes_what_is_derived_before_it():
    time = np.arange(1000) / 100.0
    time[500:] += 3.0
    q = np.sin(time)
    other = np.where(time > 6.0, 50.0 * time, q)

    def first(values):
        part = signals.split_at_gaps(log(time, values), 0.1)[0]
        smooth = signals.low_passed(part, motion_cutoff=5.0)
        return signals.differentiated(smooth).acceleration

    assert (first(q) == first(other)).all()


def test_standstill_is_trimmed_at_both_ends_alone():
    time = np.arange(1000) / 100.0
    u = np.clip(time - 2.0, 0.0, 2.0) + np.clip(time - 5.0, 0.0, 2.0)
    q = 0.5 - 0.5 * np.cos(np.pi * u / 2)
    recording = signals.differentiated(log(time, q))
    still = signals.standstill(recording, 1e-3)[:, 0]
    assert still[:199].all() and still[410:495].all() and not still[220:380].any()
    part = signals.trim_standstill(recording)
    assert part.time[0] == pytest.approx(2.0, abs=0.03)
    assert part.time[-1] == pytest.approx(7.0, abs=0.03)
    kept = signals.trim_standstill(recording, margin=0.5)
    assert kept.duration == pytest.approx(part.duration + 1.0, abs=0.011)
    moving = signals.without(recording, still, shortest=0.5)
    assert len(moving) == 2
    with pytest.raises(RecordingError, match="no joint ever moves"):
        signals.trim_standstill(log(time, 0 * time))


def test_a_mask_follows_a_log_through_resampling_and_filters():
    time = np.arange(1000) * 0.01
    whole = Recording(("a", "b"), time, np.zeros((1000, 2)))
    mask = np.zeros((1000, 2), dtype=bool)
    mask[300:310, 1] = True
    part = whole.of(("b", "a")).samples(slice(100, 900, 5))
    for reach, first, last in ((0.0, 3.0, 3.1), (0.2, 2.8, 3.25)):
        found = signals.mask_onto(whole, mask, part, reach=reach)
        assert not found[:, 1].any()
        masked = part.time[found[:, 0]]
        assert masked[0] == pytest.approx(first)
        assert masked[-1] == pytest.approx(last)
    assert not signals.mask_onto(whole, np.zeros(1000, dtype=bool), part).any()
    with pytest.raises(RecordingError, match="reach is -1"):
        signals.mask_onto(whole, mask, part, reach=-1.0)


def test_masks_that_do_not_fit_are_refused():
    recording = log(np.arange(50) / 10.0, np.zeros((50, 2)))
    for bad in (np.zeros(50), np.zeros(49, bool), np.zeros((50, 3), bool)):
        with pytest.raises(RecordingError, match="expected bool and"):
            signals.without(recording, bad)
    with pytest.raises(RecordingError, match="has no torque"):
        signals.saturated(recording)


def test_a_velocity_channel_of_zeros_has_no_delay():
    time = np.arange(2000) / 200.0
    angle = np.column_stack([np.sin(3 * time + time**2 / 8), np.sin(2 * time)])
    rate = np.gradient(angle, time, axis=0)
    position = signals.Track("position", ("a", "b"), time, angle)
    dead = signals.Track("velocity", ("a", "b"), time, 0.0 * rate)
    with pytest.raises(RecordingError, match=r"correlations of a, b are \[0.0, 0.0\]"):
        signals.estimate_delay(position, dead)
    half = signals.Track("velocity", ("a", "b"), time, rate * [1.0, 0.0])
    found = signals.estimate_delay(position, half)
    assert found.seconds == pytest.approx(0.0, abs=1e-3)
    assert found.correlations[1] == 0.0


def test_a_torque_is_compared_with_a_torque_as_it_stands():
    a, b, delay = pair(2, "torque", "torque", (200, 200), (0.02, 0.02))
    found = signals.estimate_delay(a, b)
    assert found.seconds == pytest.approx(delay, abs=0.1 / 200)
    np.testing.assert_allclose(found.gains, 1.0, rtol=0.02)


@pytest.mark.parametrize("rates", [(500.0, 50.0), (50.0, 500.0)])
def test_what_the_slower_clock_cannot_hold_does_not_come_back_as_an_alias(rates):
    # A tone of 40 Hz on the faster signal would be one of 10 Hz at 50 Hz.
    def values(rate):
        time = np.arange(int(20 * rate)) / rate
        tone = np.sin(2 * np.pi * 40.0 * time) if rate > 80.0 else 0.0 * time
        return time, np.cos(3.0 * time)[:, None] + tone[:, None]

    (time, position), (other, velocity) = map(values, rates)
    track = signals.Track("velocity", NAMES[:1], other, velocity)
    both = signals.aligned(log(time, position), track)
    assert both.rate == pytest.approx(50.0)
    inside = slice(100, -100)
    for channel in (both.position, both.velocity):
        np.testing.assert_allclose(
            channel[inside, 0], np.cos(3.0 * both.time[inside]), rtol=0, atol=1e-3
        )


def test_cut_offs_are_halved_while_blocks_hold_enough_and_half_of_the_variance_stays():
    def both(size):
        time = np.arange(6401) / 160.0  # 40 s
        slow, fast = np.sin(0.5 * time), np.sin(6 * np.pi * time)
        return log(time, np.column_stack([slow, size * fast]))

    first = log(np.arange(401) / 80.0, np.zeros(401))  # highest: an eighth of 80 Hz
    # Blocks of 2.5 periods: 25 of a cut-off of 0.625 Hz would fill the 40 s.
    found = _filtered_late(first, both(0.5))
    assert list(found) == [1.25, 2.5, 5.0, 10.0]
    for cutoff, smooth in found.items():
        same = signals.low_passed(both(0.5), motion_cutoff=cutoff)
        np.testing.assert_array_equal(smooth.position, same.position)
    # Of a tone of 3 Hz, little passes 2.5 Hz.
    assert list(_filtered_late(first, both(2.0))) == [5.0, 10.0]


@pytest.mark.parametrize(("samples", "enough"), [(72, True), (71, False)])
def test_forty_samples_are_needed_between_the_ends(samples, enough):
    """Of 16 at each end, 0.052 s for the delay and 0.1 s for the filter."""
    time = np.arange(samples) / 100.0
    late = log(time, np.sin(9.0 * time))
    if enough:
        found = _filtered_pair(late, late, 0, 10.0, longest=0.052, lowest=10.0)
        assert len(found.time) == 40
    else:
        with pytest.raises(RecordingError, match="too little of both is left"):
            _filtered_pair(late, late, 0, 10.0, longest=0.052, lowest=10.0)


def test_of_a_filtered_signal_sixteen_samples_stand_for_a_period():
    time = np.arange(4001) / 100.0
    late = log(time, np.sin(2.0 * time))
    found = _filtered_pair(late, late, 0, 2.0, longest=0.5, lowest=2.0)
    np.testing.assert_allclose(np.diff(found.time), 0.03, atol=1e-12)


def test_the_error_of_a_delay_is_that_of_newton_steps_without_a_block():
    """Two joints of other units, gains and noise; 30 s are 12 blocks of 2.5 s."""
    rng = np.random.default_rng(8)
    time = np.arange(601) / 20.0
    w, size, gain = np.array([1.3, 2.1]), np.array([1e-3, 40.0]), np.array([0.7, 1.9])

    def at(order):
        return lambda t: (
            size * w**order * np.sin(np.outer(t, w) + order * np.pi / 2) + size
        )

    y = gain * at(0)(time - 0.1) + size * [0.05, 0.2] * rng.normal(size=(601, 2))
    y -= y.mean(axis=0)
    pair = _FilteredSignals(time, y, at(0), at(1), at(2))
    found = _with_error(pair, y, 0.1, NAMES[:2], 1.0)

    r, slope, bend = (at(order)(time - 0.1) for order in range(3))
    fits = [np.polyfit(r[:, j], y[:, j], 1) for j in range(2)]
    correlations = [np.corrcoef(r[:, j], y[:, j])[0, 1] for j in range(2)]
    np.testing.assert_allclose(found.gains, [fit[0] for fit in fits])
    np.testing.assert_allclose(found.correlations, correlations)
    variance = [np.var(y[:, j] - np.polyval(fits[j], r[:, j])) for j in range(2)]
    steps = []
    for block in np.array_split(np.arange(601), 12):
        kept = np.setdiff1d(np.arange(601), block)
        score = curvature = 0.0
        for j in range(2):
            g, level = np.polyfit(r[kept, j], y[kept, j], 1)
            rest = y[kept, j] - g * r[kept, j] - level
            felt = slope[kept, j] - slope[kept, j].mean()
            centred = y[kept, j] - y[kept, j].mean()
            score -= g * rest @ felt / variance[j]
            curvature -= g * centred @ bend[kept, j] / variance[j]
        steps.append(score / curvature)
    few = t.ppf(0.975, 11) / norm.ppf(0.975)
    expected = few * np.sqrt(11 * np.var(steps))
    assert found.standard_error == pytest.approx(expected, rel=1e-6)
    assert (found.seconds, found.cutoff, found.joints) == (0.1, 1.0, NAMES[:2])
