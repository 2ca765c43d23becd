"""Filtered recordings: their kernel, their ends, and what was before the filter."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from filter_matrix import filter_matrix

from consistent_id import Recording, RecordingError, differentiated, low_passed, trimmed
from consistent_id.recordings.beside import BaseMotion, ContactFlags, Wrench
from consistent_id.recordings.recording import TorqueFilter
from consistent_id.recordings.signals.filtered_rows import (
    RowFilter,
    counting,
    left_out,
    places_of_rows,
    require_unchanged,
    row_filter,
)
from consistent_id.recordings.signals.filters import spaced
from consistent_id.signals import (
    altered,
    decimated,
    faster,
    fourier_differentiated,
    kalman_differentiated,
    motion_noise,
    resampled,
    savitzky_golay_differentiated,
    trim_standstill,
    without,
    without_rests,
)

RATE = 100.0
CUTOFFS = [(0.004, 4), (0.05, 4), (0.2, 8), (0.4, 4), (0.05, 1), (0.1, 2)]


def clock(samples):
    return np.arange(samples) / RATE


def log(samples=600, seed=0, **beside):
    """A recording of two joints, whose torque is noise."""
    rng = np.random.default_rng(seed)
    time = clock(samples)
    angle = np.outer(time, [2.0, 3.0])
    return Recording(
        ("shoulder", "elbow"),
        time,
        np.sin(angle),
        np.cos(angle) * [2.0, 3.0],
        -np.sin(angle) * [4.0, 9.0],
        torque=rng.normal(size=(samples, 2)),
        name="log 7",
        **beside,
    )


def matrix(recording, cutoff, order=4):
    reach = RowFilter(cutoff / RATE, order).reach
    return filter_matrix(len(recording), cutoff / RATE, order, reach)


def close(found, expected, tolerance=1e-12):
    size = abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * size)


def kernel(by):
    """The answer to an impulse far from both ends."""
    n = 2 * by.reach + 1
    impulse = np.zeros((3 * n, 1))
    impulse[n + by.reach] = 1.0
    answer = by(impulse, np.arange(3 * n))[:, 0]
    assert abs(np.r_[answer[:n], answer[2 * n :]]).max() < 1e-16  # transforms round
    return answer[n : 2 * n]


@pytest.mark.parametrize(("cutoff", "order"), CUTOFFS)
def test_the_kernel_has_the_gains_of_a_butterworth_filter_run_both_ways(cutoff, order):
    by = RowFilter(cutoff, order)
    h = kernel(by)
    assert len(h) == 2 * by.reach + 1
    assert h.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(h, h[::-1], rtol=0, atol=1e-15)
    # Its ends have fallen to a millionth of its peak, and not to much less.
    ends = abs(h[: max(by.reach // 8, 1)]).max() / h.max()
    assert 1e-9 < ends < 2e-5
    f = np.array([0.0, 0.3, 0.9, 1.0, 1.1, 1.7]) * cutoff
    places = np.arange(-by.reach, by.reach + 1)
    gains = np.cos(2 * np.pi * np.outer(f, places)) @ h
    ratio = np.tan(np.pi * f) / np.tan(np.pi * cutoff)
    # What is cut off at a millionth adds up to some 1e-5.
    np.testing.assert_allclose(gains, 1 / (1 + ratio ** (2 * order)), atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("samples", [2, 7, 40, 300, 2500])
@pytest.mark.parametrize(("cutoff", "order"), [(0.05, 4), (0.2, 8), (0.01, 4)])
def test_ends_are_reflected_however_short_a_recording_is(samples, cutoff, order):
    by = RowFilter(cutoff, order)
    values = np.random.default_rng(samples).normal(size=(samples, 3))
    expected = filter_matrix(samples, cutoff, order, by.reach) @ values
    every = np.arange(samples)
    close(by(values, every), expected)
    few = every[samples // 3 :: 7]
    close(by(values, few), expected[few])
    # Constant values stay what they are, up to the ends.
    close(by(np.ones((samples, 1)), every), np.ones((samples, 1)))


@pytest.mark.slow
@pytest.mark.parametrize("samples", [30, 3000, 9000])
def test_fourier_transforms_and_matrices_make_the_same_rows(samples):
    by = RowFilter(0.02)
    values = np.random.default_rng(0).normal(size=(samples, 2))
    every = np.arange(samples)
    close(by.of_spans(lambda span: values[span], every, samples), by._spectral(values))
    # At a cut-off as low as this transforms are taken.
    low = RowFilter(0.001)
    assert low.reach > 500
    by_spans = low.of_spans(lambda span: values[span], every, samples)
    close(low(values, every), by_spans)


@pytest.mark.parametrize("samples", [5, 100, 1000, 20_000])
@pytest.mark.parametrize("cutoff", [0.002, 0.05, 0.3])
def test_spans_hold_what_their_rows_are_made_of(samples, cutoff):
    by = RowFilter(cutoff)
    kept = np.arange(samples // 4, samples, 3)
    rows, asked = [], []
    for run, span in by.spans(kept, samples):
        assert 0 <= span.start < span.stop <= samples
        rows.append(kept[run])
        asked.append(span.stop - span.start)
        for end in (kept[run][0] - by.reach, kept[run][-1] + by.reach):
            mirrored = end % (2 * samples)
            place = min(mirrored, 2 * samples - 1 - mirrored)
            assert span.start <= place < span.stop
    np.testing.assert_array_equal(np.concatenate(rows), kept)
    # Memory is bounded by the filter, not by the recording.
    assert max(asked) <= max(8 * by.reach, 4096) + 2 * by.reach + 1
    assert by.of_spans(lambda s: np.ones((samples, 2))[s], kept[:0], samples).size == 0


def test_five_rows_are_kept_in_a_period_of_the_cut_off():
    for cutoff, step in ((0.4, 1), (0.2, 1), (0.1, 2), (0.02, 10), (0.0301, 6)):
        assert RowFilter(cutoff).step == step


def test_shares_are_the_power_of_white_noise_that_is_left():
    by, rng = RowFilter(0.05), np.random.default_rng(1)
    counted = (rng.random((400, 2)) < 0.7).astype(float)
    kept = np.arange(0, 400, 4)
    squares = filter_matrix(400, 0.05, 4, by.reach, squared=True)
    close(by.shares(counted, kept), (squares @ counted)[kept])
    np.testing.assert_allclose(by.shares(np.ones((400, 1)), kept), 1.0, rtol=1e-12)


def test_torque_and_wrenches_pass_the_filter_and_motion_does_not():
    wrench = Wrench("tool", np.random.default_rng(2).normal(size=(600, 6)))
    raw = log(wrenches=(wrench,))
    smooth = low_passed(raw, torque_cutoff=8.0)
    F = matrix(raw, 8.0)
    close(smooth.torque, F @ raw.torque)
    close(smooth.wrenches[0].values, F @ wrench.values)
    assert smooth.name == raw.name and (smooth.position == raw.position).all()
    behind = smooth.torque_filter
    assert (behind.cutoff, behind.order, behind.source) == (8.0, 4, raw)
    assert row_filter(smooth) == RowFilter(8.0 / RATE)
    assert low_passed(replace(raw, torque=None, wrenches=()), torque_cutoff=8.0)


def test_a_lower_cut_off_filters_anew_and_a_higher_one_changes_nothing():
    raw = log()
    twice = low_passed(low_passed(raw, torque_cutoff=20.0), torque_cutoff=6.0)
    close(twice.torque, matrix(raw, 6.0) @ raw.torque)
    again = low_passed(twice, torque_cutoff=10.0)
    assert (again.torque == twice.torque).all() and again.torque_filter.cutoff == 6.0
    few = low_passed(trimmed(twice, 1.0, 4.0), torque_cutoff=3.0)
    close(few.torque, (matrix(raw, 3.0) @ raw.torque)[100:401])


CHANGES = {
    "filter": lambda log: differentiated(low_passed(log, motion_cutoff=5.0)),
    "polynomials": lambda log: savitzky_golay_differentiated(log, 0.15),
    "series": lambda log: fourier_differentiated(log, 2 * np.pi),
    "smoother": lambda log: kalman_differentiated(log, motion_noise(log.samples(SOME))),
}
SOME = slice(0, 200)


@pytest.mark.parametrize(
    "name",
    [*list(CHANGES)[:3], pytest.param("smoother", marks=pytest.mark.slow)],
)
def test_motion_may_be_prepared_before_or_after_the_filter(name):
    raw, change = replace(log(900), velocity=None, acceleration=None), CHANGES[name]
    first = low_passed(change(raw), torque_cutoff=8.0)
    then = change(low_passed(raw, torque_cutoff=8.0))
    for channel in ("position", "velocity", "acceleration", "torque"):
        close(getattr(then, channel), getattr(first, channel), 1e-9)
    require_unchanged(then)


def test_a_change_before_the_filter_is_made_to_all_samples():
    raw = log()
    few = decimated(trimmed(low_passed(raw, torque_cutoff=8.0), 1.0, 5.0), 2)
    seen = []

    def doubled(whole):
        seen.append(len(whole))
        return replace(whole, torque=2.0 * whole.torque, velocity=-whole.velocity)

    found = altered(few, doubled)
    assert seen == [600] and len(found) == len(few) < 250
    close(found.torque, 2.0 * few.torque)
    np.testing.assert_array_equal(found.velocity, -few.velocity)
    np.testing.assert_array_equal(found.time, few.time)
    require_unchanged(found)
    # Torque that is not filtered is changed as it is.
    assert (altered(raw, doubled).torque == 2.0 * raw.torque).all()


@pytest.mark.parametrize("copied", [False, True])
def test_torque_is_filtered_again_only_if_it_or_the_clock_is_changed(copied):
    few = spaced(trimmed(low_passed(log(), torque_cutoff=8.0), 1.0, 5.0), 7)
    few = pickle.loads(pickle.dumps(few)) if copied else few
    turned = altered(few, lambda raw: replace(raw, velocity=-raw.velocity))
    np.testing.assert_array_equal(turned.torque, few.torque)  # to the last bit
    slow = altered(few, lambda raw: replace(raw, time=2.0 * raw.time))
    require_unchanged(slow)
    assert abs(slow.torque - few.torque).max() > 0.01 * abs(few.torque).max()


def _spike(values):
    values = values.copy()
    values[307, 0] += 1e-3
    return values


def _flags(samples):
    closed = np.arange(samples) % 50 < 30
    return ContactFlags("foot", closed)


CHANNELS = {
    "time": lambda log: replace(log, time=log.time + 1.0),
    "position": lambda log: replace(log, position=_spike(log.position)),
    "velocity": lambda log: replace(log, velocity=None),
    "acceleration": lambda log: replace(log, acceleration=1.1 * log.acceleration),
    "torque": lambda log: replace(log, torque=_spike(log.torque)),
    "torque, of all": lambda log: replace(log, torque=1.001 * log.torque),
    "torque, left out": lambda log: replace(log, torque=None),
    "torque_known": lambda log: replace(log, torque_known=log.torque > 0.0),
    "joints": lambda log: replace(log, joints=("elbow", "shoulder")),
    "base": lambda log: replace(log, base=BaseMotion.at_rest(len(log))),
    "contacts": lambda log: replace(log, contacts=(_flags(len(log)),)),
    "contacts, open": lambda log: replace(
        log, contacts=(replace(log.contacts[0], certain=log.torque[:, 0] > 0.0),)
    ),
    "wrench": lambda log: replace(
        log, wrenches=(replace(log.wrenches[0], values=_spike(log.wrenches[0].values)),)
    ),
    "wrenches": lambda log: replace(log, wrenches=()),
}


@pytest.mark.parametrize("name", CHANNELS)
def test_a_channel_that_is_changed_after_the_filter_is_refused(name):
    values = np.random.default_rng(2).normal(size=(600, 6))
    raw = log(wrenches=(Wrench("tool", values),), contacts=(_flags(600),))
    smooth = low_passed(raw, torque_cutoff=8.0)
    require_unchanged(smooth)
    if name == "contacts":
        smooth = low_passed(replace(raw, contacts=()), torque_cutoff=8.0)
    changed = CHANNELS[name](smooth)
    word = name.split(",")[0]
    with pytest.raises(RecordingError, match=rf"{word}.* was changed after .* 8 Hz"):
        require_unchanged(changed)
    # It would be lost in silence if the next step began before the filter.
    for step in (
        lambda one: low_passed(one, torque_cutoff=5.0),
        lambda one: altered(one, lambda whole: whole),
    ):
        with pytest.raises(RecordingError, match="Change it before the filter"):
            step(changed)


def test_a_recording_that_is_not_filtered_has_no_filter_to_refuse():
    for function in (require_unchanged, row_filter):
        with pytest.raises(RecordingError, match="log 7: its torque is not filtered"):
            function(log())


def test_joints_and_samples_are_taken_of_both_sides_of_the_filter():
    raw = log()
    smooth = low_passed(raw, torque_cutoff=8.0)
    turned = smooth.of(("elbow", "shoulder"))
    assert turned.torque_filter.source.joints == ("elbow", "shoulder")
    close(turned.torque, smooth.torque[:, ::-1])
    require_unchanged(turned)
    require_unchanged(smooth.of(("elbow",)))
    for part in (
        smooth.samples(slice(10, 500, 3)),
        smooth.samples(np.array([3, 5, 90, 91])),
        trimmed(smooth, 2.0, 3.0),
    ):
        require_unchanged(part)
        places = part.torque_filter.kept
        np.testing.assert_array_equal(part.time, raw.time[places])
        close(part.torque, smooth.torque[places])


def rested():
    """The recording with a rest at its start, and one in its middle."""
    raw = log()
    moving = np.ones((600, 1))
    moving[:60] = moving[300:360] = 0.0
    return replace(raw, velocity=raw.velocity * moving)


def test_samples_that_do_not_count_are_left_out_before_the_filter():
    raw = rested()
    smooth = low_passed(raw, torque_cutoff=8.0)
    still = (raw.velocity == 0.0).all(axis=1)
    for found, out in (
        (trim_standstill(smooth, 1e-6), np.arange(600) < 60),
        (without(smooth, raw.velocity == 0.0)[0], still),
        (counting(smooth, ~still), still),
    ):
        np.testing.assert_array_equal(found.torque_filter.left_out, out)
        require_unchanged(found)
    fast = faster(smooth, 0.3)
    out = ~np.isin(np.arange(600), fast.torque_filter.kept)
    np.testing.assert_array_equal(fast.torque_filter.left_out, out)
    # Masks add; a cut by time is none.
    twice = trimmed(counting(fast, fast.time > 1.0), 2.0, 5.0)
    np.testing.assert_array_equal(
        twice.torque_filter.left_out, out | (raw.time <= 1.0) & ~out
    )
    assert left_out(smooth, np.zeros(600, dtype=bool)) is smooth
    assert left_out(raw, still) is raw
    assert counting(smooth, np.ones(600, dtype=bool)) is smooth


def test_what_thinned_samples_stand_for_is_left_out_with_them():
    few = decimated(log(), 4)
    mask = np.zeros(len(few), dtype=bool)
    mask[[10, 11]] = True
    out = left_out(few, mask).torque_filter.left_out
    np.testing.assert_array_equal(np.flatnonzero(out), np.arange(39, 47))


def test_samples_beyond_those_that_are_left_are_not_left_out_with_them():
    """Of every third of samples 3 to 12, marks at both ends: 3, 4 and 11, 12."""
    time = np.arange(20) / 100.0
    log = Recording(("a",), time, time[:, None], torque=np.ones((20, 1)))
    few = low_passed(log, torque_cutoff=20.0).samples(slice(3, 13, 3))
    ends = np.array([True, False, False, True])
    out = left_out(few, ends).torque_filter.left_out
    assert np.flatnonzero(out).tolist() == [3, 4, 11, 12]


def test_rests_are_found_before_the_filter_too():
    raw = rested()
    smooth = trimmed(low_passed(raw, torque_cutoff=8.0), 1.0, 5.0)
    found = without_rests(smooth, 1e-6)
    require_unchanged(found)
    known = without_rests(raw, 1e-6).torque_known
    np.testing.assert_array_equal(found.torque_filter.source.torque_known, known)
    np.testing.assert_array_equal(found.torque_known, known[100:501])
    assert not known[:60].any() and not known[300:360].any()


def test_thinning_follows_the_clock_and_not_the_first_sample_that_is_left():
    raw = log()
    smooth = low_passed(raw, torque_cutoff=8.0)
    late = decimated(trimmed(smooth, 0.07, 5.0), 5)
    np.testing.assert_array_equal(late.torque_filter.kept, np.arange(10, 501, 5))
    assert late.torque_filter.cutoff == 8.0  # which is below that against aliasing
    close(late.torque, smooth.torque[10:501:5])


def test_thinning_twice_thins_by_the_product():
    raw = log()
    for first, second in ((2, 2), (2, 3), (3, 2)):
        both = decimated(decimated(raw, first), second)
        whole = decimated(raw, first * second)
        np.testing.assert_array_equal(both.time, whole.time)
        assert both.torque_filter.cutoff == pytest.approx(whole.torque_filter.cutoff)
        close(both.torque, whole.torque)
        assert both.torque_filter.step == first * second


def test_thinning_is_remembered_where_few_samples_are_left():
    few = decimated(log(), 2).samples(np.array([0, 3]))
    assert few.torque_filter.step == 2
    assert (
        low_passed(log(), torque_cutoff=8.0)
        .samples(np.array([0, 3]))
        .torque_filter.step
        == 3
    )


def test_another_clock_is_refused_after_the_filter():
    smooth = low_passed(log(), torque_cutoff=8.0)
    with pytest.raises(RecordingError, match=r"low-passed at 8 Hz on its own clock"):
        resampled(smooth, 95.0)


def test_filters_want_steps_that_are_equal_before_the_filter():
    raw = log()
    time = raw.time + 1e-3 * np.sin(np.arange(600))
    with pytest.raises(RecordingError, match="clock is not uniform"):
        low_passed(replace(raw, time=time), torque_cutoff=8.0)
    # Samples may be missing after it.
    kept = np.flatnonzero(np.arange(600) % 7 > 0)
    gappy = low_passed(raw, torque_cutoff=8.0).samples(kept)
    close(
        low_passed(gappy, torque_cutoff=4.0).torque,
        (matrix(raw, 4.0) @ raw.torque)[kept],
    )


@pytest.mark.parametrize(("change", "refused"), [(4e-9, False), (1e-7, True)])
def test_rounding_of_filtered_torque_is_no_change(change, refused):
    """A part in 1e9 of the torque, times the root of 600 samples."""
    smooth = low_passed(log(), torque_cutoff=8.0)
    torque = 1e-3 * smooth.torque
    torque[100, 1] += change * abs(torque[:, 1]).max()
    raw = replace(smooth.torque_filter.source, torque=1e-3 * log().torque)
    behind = replace(smooth.torque_filter, source=raw)
    rounded = replace(smooth, torque=torque, torque_filter=behind)
    if refused:
        with pytest.raises(RecordingError, match="torque was changed"):
            require_unchanged(rounded)
    else:
        require_unchanged(rounded)


def test_rows_worth_keeping_are_on_a_grid_of_the_whole_log():
    """Of every second sample from the fifth on, in a log that begins at sample 7."""
    kept = np.arange(5, 60, 2)
    raw = log()
    behind = TorqueFilter(8.0, 4, raw, kept, first=7, thinned=2)
    rows = places_of_rows(behind, 6)
    assert (kept[rows] + 7).tolist() == [12, 18, 24, 30, 36, 42, 48, 54, 60, 66]
    # Steps that are no multiple are shortened to one.
    assert places_of_rows(behind, 5).tolist() == places_of_rows(behind, 4).tolist()


@pytest.mark.parametrize("cutoff", [0.001, 0.3])
def test_no_rows_of_a_filter_are_no_rows(cutoff):
    values = np.ones((3000, 2))
    assert RowFilter(cutoff)(values, np.arange(0)).shape == (0, 2)
