"""Masks of samples: each limit at both sides, with steps and speeds that are known."""

from dataclasses import replace

import numpy as np
import pytest

from consistent_id import Recording, RecordingError
from consistent_id.recordings.beside import ContactFlags
from consistent_id.recordings.signals.drive_limits import (
    _filled_runs,
    _runs_into,
    _stays,
    beyond_speed,
    saturated,
    within_speed,
)
from consistent_id.recordings.signals.masks import (
    _turning,
    encoder_resolution,
    held_samples,
    mask_onto,
    quantum,
    row_weights,
    speed_share,
    standstill,
    without_impacts,
    without_rests,
)


def log_with(velocity, step=0.01, **more):
    speeds = np.asarray(velocity, dtype=float).reshape(len(velocity), -1)
    joints = tuple(f"j{k}" for k in range(speeds.shape[1]))
    time = np.arange(len(speeds)) * step
    return Recording(joints, time, 0.0 * speeds, speeds, **more)


def marked(mask):
    return np.flatnonzero(mask).tolist()


def test_a_hundredth_of_the_largest_speed_is_motion_and_less_is_rest():
    log = log_with([2.0, 0.02, 0.0199, -0.0199, -0.02, 0.0])
    assert marked(standstill(log)) == [2, 3, 5]
    assert marked(standstill(log, 0.02)) == [2, 3, 5]
    assert marked(standstill(log, 0.0)) == [5]
    # The speed of all joints counts.
    beside = log_with(np.column_stack([[1.0, 1.0], [0.009, 0.011]]))
    assert standstill(beside).tolist() == [[False, True], [False, False]]
    with pytest.raises(RecordingError, match="expected zero or more"):
        standstill(log, -1.0)


@pytest.mark.parametrize("reach", range(9))
def test_a_joint_that_turns_back_is_as_fast_as_around(reach):
    rng = np.random.default_rng(reach)
    speeds = rng.uniform(-1.0, 1.0, (30, 2)) * [1.0, 9.0]
    log = log_with(speeds)
    share = np.max(abs(speeds) / abs(speeds).max(axis=0), axis=1)
    expected = [share[max(k - reach, 0) : k + reach + 1].max() for k in range(30)]
    assert speed_share(log, 0.02 * reach + 0.005).tolist() == expected


def test_the_usual_window_is_an_eighth_of_a_second_to_either_side():
    speeds = np.full(60, 0.1)
    speeds[30] = -1.0
    fast = speed_share(log_with(speeds)) == 1.0
    assert marked(fast) == list(range(18, 43))  # 12 samples of 0.01 s
    # Of a stated top speed; a joint that has none counts as resting.
    both = log_with(np.column_stack([speeds, speeds]))
    half = speed_share(both, 0.0, top=np.array([2.0, 0.0]))
    assert half[[0, 30]].tolist() == [0.05, 0.5]


def test_a_mask_reaches_as_far_as_stated_and_to_the_nearest_samples():
    log = log_with(np.ones((10, 2)))
    mask = np.zeros((10, 2), dtype=bool)
    mask[5, 1] = True
    for reach, found in ((0.0, [5]), (0.0101, [4, 5, 6]), (0.0201, [3, 4, 5, 6, 7])):
        onto = mask_onto(log, mask, log, reach=reach)
        assert marked(onto[:, 1]) == found
        assert not onto[:, 0].any()
    half = log.samples(slice(0, 10, 2))  # samples 4 and 6 are equally near to 5
    assert marked(mask_onto(log, mask, half)[:, 1]) == [2, 3]
    last = mask_onto(log, np.arange(10) == 9, log)
    assert marked(last[:, 0]) == [9]
    turned = mask_onto(log, mask, log.of(("j1", "j0")))
    assert marked(turned[:, 0]) == [5]
    with pytest.raises(RecordingError, match="reach is -1 s"):
        mask_onto(log, mask, log, reach=-1)
    for wrong in (mask.astype(int), mask[:9], mask[:, :1]):
        with pytest.raises(RecordingError, match="expected bool"):
            mask_onto(log, wrong, log)


def test_masked_rows_have_no_weight_and_others_are_kept():
    log = log_with(np.ones((3, 2)))
    mask = np.array([[True, False], [False, True], [False, False]])
    weights = row_weights(log, mask, ("base.fx", "j1", "j0"), others=("base.fx",))
    assert weights.tolist() == [[1.0, 1.0, 0.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0]]


def test_reversals_are_rests_only_where_a_filter_spreads_them():
    log = log_with([3.0, 2.0, 1.0, -1.0, -2.0, -3.0, -3.0, 0.1, 0.1, 0.1])
    known = np.ones((10, 1), dtype=bool)
    known[9] = False
    for reach, unknown in ((0.0, [7, 8]), (0.0101, [1, 2, 3, 4, 5, 6, 7, 8, 9])):
        found = without_rests(log, 0.5, reach=reach).torque_known
        assert marked(~found) == unknown + [9] * (9 not in unknown)
        beside = replace(log, torque_known=known)
        assert 9 in marked(~without_rests(beside, 0.5, reach=reach).torque_known)
    fast = within_speed(replace(log, torque_known=known), 2.5)
    assert marked(~fast.torque_known) == [0, 5, 6, 9]


def test_contacts_are_uncertain_around_their_changes():
    closed = np.arange(8) >= 4
    log = log_with(np.ones(8), contacts=(ContactFlags("foot", closed),))
    (flags,) = without_impacts(log, 0.0101).contacts
    assert 3 in marked(~flags.certain)
    assert 4 in marked(~flags.certain)
    assert marked(flags.certain)[0] == 0
    assert marked(flags.certain)[-1] == 7
    without_impacts(log, 0.0)
    for wrong in (-1.0, np.inf, np.nan):
        with pytest.raises(RecordingError, match="guard is"):
            without_impacts(log, wrong)


def from_gaps(gaps):
    return np.concatenate([[0.0], np.cumsum(gaps)])


@pytest.mark.parametrize(
    ("gaps", "step"),
    [
        (np.full(12, 0.5), 0.5),
        (np.full(11, 0.5), 0.0),  # too few
        # Alike, or not: by a thousandth of the step
        (np.tile([1.0009, 0.9991], 10), 1.0),
        (np.tile([1.0011, 0.9989], 10), 0.0),
        # Two of a hundred may lie between levels.
        ([1.02, 0.98] + [1.0] * 98, 1.0),
        ([1.02, 0.98, 1.02] + [1.0] * 97, 0.0),
        # A step that never occurs alone: halves and thirds of the smallest are tried.
        (np.tile([2.0, 3.0, 5.0], 6), 1.0),
        (np.tile([3.0, 4.0, 5.0], 6), 1.0),
        # Levels that differ by rounding alone are one.
        (np.concatenate([np.ones(19), [1e-11]]), 1.0),
        (np.concatenate([np.ones(19), [1e-10]]), 0.0),
        # Most steps are far larger: nothing is known of them.
        (np.concatenate([np.ones(12), np.full(12, 4001.0)]), 1.0),
        (np.concatenate([np.ones(12), np.full(13, 4001.0)]), 0.0),
    ],
)
def test_the_quantum_is_that_of_which_steps_are_multiples(gaps, step):
    assert quantum(from_gaps(gaps)) == pytest.approx(step, abs=1e-6)


def test_six_different_multiples_may_each_be_off_by_a_tenth():
    for kinds, off, known in ((6, 0.09, True), (6, 0.11, False), (5, 0.09, False)):
        gaps = np.repeat(np.arange(1.0, kinds + 1), 4)
        gaps += np.tile([off, -off], len(gaps) // 2)
        assert (quantum(from_gaps(gaps)) == pytest.approx(1.0, rel=0.01)) is known


def test_each_joint_has_its_resolution_and_one_at_rest_has_none():
    position = np.column_stack([0.25 * np.arange(20.0), np.zeros(20)])
    log = Recording(("a", "b"), np.arange(20.0), position)
    assert encoder_resolution(log).tolist() == [0.25, 0.0]


@pytest.mark.parametrize(
    ("runs", "held"),
    [
        ([4] * 8 + [9] * 2, 4),
        ([4] * 7 + [9] * 3, 1),  # eight of ten must be alike
        ([4] * 6 + [5] * 4, 4),  # within a sample
        ([4] * 6 + [6] * 4, 1),
        ([20] * 6 + [22] * 4, 20),  # or a tenth
        ([20] * 6 + [23] * 4, 1),
        ([1] * 10, 1),
        ([2] * 10, 2),
        ([], 1),
    ],
)
def test_a_held_reading_lasts_about_as_long_as_each_other(runs, held):
    lengths = [3, *runs, 3]  # the first and the last may be cut
    values = np.repeat(np.arange(len(lengths)) * 0.3, lengths)
    assert held_samples(values) == held


def test_a_torque_within_a_thousandth_of_a_stated_limit_is_at_it():
    torque = np.array([[-50.0, 2.0], [49.96, 1.998], [49.94, -1.9979], [0.0, 0.0]])
    log = log_with(np.ones((4, 2)), torque=torque)
    found = saturated(log, [50.0, 2.0])
    assert found.tolist() == [[True] * 2, [True] * 2, [False] * 2, [False] * 2]
    assert saturated(log, 2.0)[:, 0].tolist() == [True, True, True, False]
    for wrong in (0.0, [1.0, -1.0]):
        with pytest.raises(RecordingError, match="positive"):
            saturated(log, wrong)


def test_a_joint_at_its_rated_speed_is_not_beyond_it():
    log = log_with([[1.0, -2.0], [-1.01, 2.0], [9.0, 9.0]])
    found = beyond_speed(log, [1.0, 0.0])
    assert found.tolist() == [[False, False], [True, False], [True, False]]
    assert marked(beyond_speed(log, np.inf)) == []
    with pytest.raises(RecordingError, match="limit is"):
        beyond_speed(log, [1.0, -1.0])


# ----- torques that run into a limit: ramps between plateaus, 0.01 s a sample


def ramps(plateau, height=1.0, count=4, length=20):
    """A torque that goes up to a plateau, and down again, several times."""
    up = np.linspace(0.0, height, length, endpoint=False)
    once = np.concatenate([up, np.full(plateau, height), up[::-1]])
    # Noise of rounding: no two readings of a ramp are equal, though plateaus are.
    slopes = np.tile(once, count)
    drift = np.where(slopes < height, 1e-5 * np.arange(len(slopes)) / len(slopes), 0.0)
    return slopes - drift


def limited(torque, velocity=None, **more):
    speeds = np.ones(len(torque)) if velocity is None else velocity
    return saturated(log_with(speeds, torque=np.asarray(torque)[:, None], **more))[:, 0]


@pytest.mark.parametrize(
    ("plateau", "count", "found"),
    [
        (3, 2, True),  # 0.03 s, twice
        (3, 1, False),
        (2, 2, False),  # shorter
    ],
)
def test_a_limit_is_met_for_three_hundredths_of_a_second_twice(plateau, count, found):
    torque = ramps(plateau, count=count)
    assert limited(torque).any() == found
    if found:
        assert marked(limited(torque)) == marked(torque == 1.0)
        assert marked(limited(-torque)) == marked(torque == 1.0)


def test_a_plateau_at_rest_is_no_limit():
    torque = ramps(5)
    still = np.where(torque == 1.0, 0.0, 1.0)
    assert not limited(torque, still).any()


@pytest.mark.parametrize(("resting", "found"), [(1, True), (2, False)])
def test_more_than_half_of_a_plateau_is_in_motion(resting, found):
    torque = ramps(4, count=2)
    speeds = np.ones(len(torque))
    for run in np.flatnonzero(torque == 1.0).reshape(2, 4):
        speeds[run[:resting]] = 0.0
    assert limited(torque, speeds).any() == found


def test_a_limit_is_within_a_twentieth_of_the_largest_torque():
    for height, found in ((0.96, True), (0.94, False)):
        both = np.concatenate([ramps(6), -ramps(6, height)])
        assert (limited(both) & (both < 0.0)).any() == found
        assert (limited(both) & (both > 0.0)).any()


def test_a_channel_without_change_has_no_limit():
    assert not limited(np.ones(50)).any()


def noisy_tops(tops, next_ones=1, fourth=1):
    """Unlike torque below 0.9, and between it single readings of the largest value."""
    rng = np.random.default_rng(0)
    torque = rng.uniform(0.1, 0.9, 200)
    torque[5 : 5 + 10 * tops : 10] = 1.0
    # The next value, and the fourth, read several times.
    order = np.argsort(torque)[::-1][tops:]
    torque[order[:next_ones]] = torque[order[0]]
    later = order[next_ones + 2 :]
    torque[later[:fourth]] = torque[later[0]]
    return torque


@pytest.mark.parametrize(
    ("tops", "others", "found"),
    [
        (5, {}, True),  # five single readings, five times as many as of the next
        (4, {}, False),
        (5, {"next_ones": 2}, False),
        (10, {"next_ones": 2}, True),
        (9, {"next_ones": 2}, False),
        (5, {"fourth": 2}, True),  # the next three count
    ],
)
def test_single_readings_at_one_value_show_a_limit_that_noise_hides(
    tops, others, found
):
    torque = noisy_tops(tops, **others)
    assert limited(torque).any() == found
    if found:
        assert marked(limited(torque)) == marked(torque == 1.0)
        assert marked(limited(-torque)) == marked(torque == 1.0)
    still = np.where(torque == 1.0, 0.0, 1.0)
    assert not limited(torque, still).any()


def test_runs_that_a_lone_mark_divides_are_two_and_those_with_a_gap_are_one():
    marks = np.array(list("11110001000111110111")) == "1"
    assert _filled_runs(marks, 4) == [slice(0, 4), slice(11, 20)]
    assert _filled_runs(marks, 5) == [slice(11, 20)]


@pytest.mark.parametrize(("least", "stays"), [(5, 1), (6, 0)])
def test_a_stay_is_long_enough_and_is_come_to_with_a_slope(least, stays):
    """Five equal readings at 0.6 of the peak; a long rest at 0.7 has no slope."""
    steep = [0.1, 0.2, 0.3, 0.6, 0.6, 0.6, 0.6, 0.6, 0.3, 0.2, 0.1]
    assert _stays(2.0 * np.array(steep), 2.0, 0.02, least) == stays
    assert _stays(np.full(40, -1.4), 2.0, 0.02, least) == 0


def test_a_velocity_turns_where_its_sign_changes_and_not_at_rest():
    speeds = [1.0, 0.0, 1.0, -1.0, -1.0, 0.0, 0.0]
    turning = _turning(log_with(speeds))[:, 0]
    assert turning.tolist() == [False, False, True, True, False, False, False]


@pytest.mark.parametrize("least", [2, 3, 5, 8])
def test_plateaus_are_runs_most_of_whose_surroundings_are_marked(least):
    rng = np.random.default_rng(least)
    for density in (0.3, 0.6, 0.8):
        marks = rng.random(60) < density
        n, half = len(marks), least // 2
        near = [
            sum(marks[max(k - half, 0) : max(k - half + least, 0)]) > 0.5 * least
            for k in range(n)
        ]
        joined, found = marks | near, []
        for k in range(n):
            if joined[k] and (k == 0 or not joined[k - 1]):
                stop = next((i for i in range(k, n) if not joined[i]), n)
                own = [i for i in range(k, stop) if marks[i]]
                if own and own[-1] - own[0] + 1 >= least:
                    whole = slice(own[0], own[-1] + 1)
                    if marks[whole].mean() > 0.5:
                        found.append(whole)
        assert _filled_runs(marks, least) == found


@pytest.mark.parametrize(
    ("torque", "run", "comes"),
    [
        ([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0], slice(3, 6), True),
        ([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0], slice(3, 6), True),
        # The medians of as long before and after are 0.95.
        ([0.0, 0.0, 0.95, 0.95, 1.0, 1.0, 0.95, 0.95, 0.0], slice(4, 6), False),
        ([0.0, 0.95, 0.0, 0.0, 1.0, 1.0], slice(4, 6), True),
        ([1.0, 1.0, 1.0], slice(0, 3), False),
    ],
)
def test_a_plateau_is_come_to_by_more_than_ten_times_its_flatness(torque, run, comes):
    tau = np.array(torque)
    assert _runs_into(tau, run, 0.095) == comes
    assert not _runs_into(tau, run, 0.1)
    assert _runs_into(1e-3 * tau, run, 9.5e-5) == comes


def test_a_stay_that_is_only_left_with_a_slope_counts():
    """Between 0.59 and 0.3, of as many samples as the stay itself."""
    tau = np.array([0.59] * 5 + [0.6] * 5 + [0.3, 0.2, 0.1, 0.0, 0.0])
    assert _stays(tau, 1.0, 0.02, 5) == 1


@pytest.mark.parametrize("size", [1e-3, 1.0, 300.0])
def test_a_limit_is_met_within_a_thousandth_in_any_unit(size):
    """Three readings that differ a little, four times, and no two alike."""
    torque = ramps(3)
    top = torque == 1.0
    torque[top] -= 9e-4 * np.random.default_rng(0).random(12)
    assert marked(limited(size * torque)) == marked(top)


def test_readings_that_differ_by_rounding_are_of_one_value():
    """By a part in 1e9 of the largest, or less."""
    torque = noisy_tops(6)
    top = torque == 1.0
    torque[top] -= np.linspace(0.0, 9e-10, 6)
    assert marked(limited(torque)) == marked(top)
