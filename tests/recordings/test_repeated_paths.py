"""Periods, and paths there and back: each limit at both sides."""

import numpy as np
import pytest

from consistent_id import Recording, RecordingError
from consistent_id.recordings.beside import BaseMotion, Wrench
from consistent_id.recordings.signals import repetitions
from consistent_id.recordings.signals.fourier import series_columns
from consistent_id.recordings.signals.repetitions import (
    _refined,
    _require_one_path,
    _self_similar,
    _turn,
    estimated_period,
    there_and_back,
    whole_periods,
)


@pytest.mark.parametrize(
    ("duration", "step", "count"),
    [
        (2.98, 0.0, 3),  # a fiftieth of a period may be missing
        (2.97, 0.0, 2),
        (2.97, 0.01, 3),  # and one step
        (3.97, 0.0, 3),
        (0.97, 0.0, 0),
    ],
)
def test_a_motion_has_as_many_whole_periods_as_nearly_fit(duration, step, count):
    assert whole_periods(duration, 1.0, step) == count
    assert whole_periods(10.0 * duration, 10.0, 10.0 * step) == count


def periodic(periods, period=2.0, step=0.01):
    time = 7.0 + np.arange(round(periods * period / step) + 1) * step
    angle = 2.0 * np.pi / period * (time - 7.0)
    both = np.column_stack([np.sin(angle) + 0.3 * np.cos(3 * angle), np.cos(angle)])
    return Recording(("a", "b"), time, both)


@pytest.mark.parametrize("harmonics", [None, 1, 3])
def test_the_period_of_a_series_is_found_however_many_harmonics_it_has(harmonics):
    found = estimated_period(periodic(2.7), harmonics=harmonics)
    # A single harmonic does not describe the third: it is biased.
    assert found == pytest.approx(2.0, abs=0.05 if harmonics == 1 else 1e-6)
    # Shifts by several periods fit as well: the first is meant.
    assert estimated_period(periodic(5.3), harmonics=3) == pytest.approx(2.0, abs=1e-6)


def test_a_period_is_sought_where_it_is_said_to_be():
    log = periodic(5.3)  # 10.6 s
    two = estimated_period(log, shortest=3.0, longest=5.0, harmonics=6)
    assert two == pytest.approx(4.0, abs=1e-6)
    whole = estimated_period(log, shortest=1.0, longest=log.duration)
    assert whole == pytest.approx(2.0, abs=1e-6)
    for shortest, longest in ((0.0, 3.0), (2.0, 2.0), (1.0, 10.7)):
        with pytest.raises(RecordingError, match="a period between"):
            estimated_period(log, shortest=shortest, longest=longest)
    # Twenty samples are the shortest, two thirds of the log the longest.
    with pytest.raises(RecordingError, match=r"after 0\.2 s to 1\.333 s; give"):
        estimated_period(periodic(1.0))


def bent(apart=0.0, count=21, turn=10, **more):
    """A path of one radian there and back, which is `apart` on the way back."""
    k = np.arange(count)
    q = 1.0 - abs(k - turn) / turn
    q[turn + 1 :] += apart * np.sin(np.pi * (k[turn + 1 :] - turn) / turn)
    return Recording(("j",), 0.5 + 0.1 * k, q[:, None], name="log", **more)


def test_ways_a_fiftieth_apart_are_one_path_and_others_are_not():
    mean = there_and_back(bent(0.0195))
    assert len(mean) == 10
    assert mean.position[5, 0] == pytest.approx(0.5 + 0.0195 / 2.0)
    with pytest.raises(RecordingError, match=r"0\.0205 .*for a travel of 1;"):
        there_and_back(bent(0.0205))


def test_the_mean_is_that_of_samples_equally_far_from_the_turn():
    k = np.arange(21.0)[:, None]
    torque_known = np.ones((21, 1), dtype=bool)
    torque_known[[3, 12]] = False
    log = bent(
        velocity=k,
        acceleration=10.0 * k,
        torque=k**2,
        torque_known=torque_known,
        wrenches=(Wrench("tool", np.tile(k**2, 6)),),
    )
    for turn in (None, 1.5, 1.52):
        mean = there_and_back(log, turn)
        there, back = k[:10], k[20:10:-1]
        assert mean.name == "log, there and back"
        assert mean.time.tolist() == log.time[:10].tolist()
        np.testing.assert_allclose(mean.velocity, (there - back) / 2.0)
        np.testing.assert_allclose(mean.acceleration, 100.0)
        np.testing.assert_allclose(mean.torque, (there**2 + back**2) / 2.0)
        np.testing.assert_allclose(mean.wrenches[0].values[:, [5]], mean.torque)
        assert np.flatnonzero(~mean.torque_known).tolist() == [3, 8]
    rest = there_and_back(bent())
    assert not rest.velocity.any()
    assert not rest.acceleration.any()
    assert rest.torque is None


def test_the_shorter_way_may_be_a_quarter_of_the_recording():
    for turn, ways in ((60, 60), (140, 60), (100, 100)):
        log = bent(count=201, turn=turn)
        assert there_and_back(log).time[-1] == pytest.approx(0.4 + 0.1 * turn)
        assert len(there_and_back(log)) == ways
    # Of a long recording, too, of which not every sample is tried at first.
    log = bent(count=1501, turn=601)
    assert len(there_and_back(log)) == 601


def test_a_turn_at_an_end_leaves_no_way_back():
    assert len(there_and_back(bent().samples(slice(8, 13)), 1.5)) == 2
    for cut in (slice(9, 21), slice(0, 12)):
        with pytest.raises(RecordingError, match="no way there or none back"):
            there_and_back(bent().samples(cut), 1.5)
    still = np.zeros((21, 3))
    moving = bent(base=BaseMotion(still, still, still))
    with pytest.raises(RecordingError, match="the base moves"):
        there_and_back(moving)


def test_joints_count_alike_for_a_period_whatever_their_units():
    """Two joints of slightly different periods, one of which moves by a millimetre."""
    time = np.arange(900) * 0.01
    both = np.sin(2.0 * np.pi * time[:, None] / [2.0, 2.02])
    periods = [
        estimated_period(Recording(("a", "b"), time, both * size), harmonics=1)
        for size in ([1.0, 1.0], [1e-3, 1.0], [1.0, 1e-3])
    ]
    assert periods == pytest.approx([periods[0]] * 3, abs=1e-5)
    assert 2.005 < periods[0] < 2.015


@pytest.mark.parametrize(("apart", "refused"), [(0.0019, False), (0.0021, True)])
def test_a_joint_that_moves_little_has_to_come_back_the_same_way_too(apart, refused):
    """Within a fiftieth of its own 0.1 rad; another joint comes within 0.015 of 1."""
    there, back = np.arange(3), np.array([6, 5, 4])
    q = np.abs(np.arange(7) - 3.0)[:, None] / 3.0 * [1.0, 0.1, 0.0]
    q[1] += [0.015, apart, 0.0]
    log = Recording(("far", "near", "still"), np.arange(7.0), q)
    if refused:
        with pytest.raises(RecordingError, match="near differs by up to"):
            _require_one_path(log, there, back)
    else:
        _require_one_path(log, there, back)


def random_periods(periods, size=(1.0, 1e-3)):
    """Random readings, again after 24 samples; of the first joint after 12."""
    rng = np.random.default_rng(4)
    once = np.column_stack([np.tile(rng.normal(size=12), 2), rng.normal(size=24)])
    time = 5.0 + np.arange(24 * periods) * 0.02
    return Recording(("a", "b"), time, np.tile(once, (periods, 1)) * size)


@pytest.mark.parametrize(("low", "high"), [(0.02, 0.9), (0.46, 0.9), (0.02, 0.48)])
@pytest.mark.parametrize("size", [(1.0, 1e-3), (1e-4, 1.0)])
def test_a_motion_is_first_like_itself_after_all_joints_are(low, high, size):
    """To the sample, though readings in between have nothing in common."""
    found = _self_similar(random_periods(3, size), low + 1e-9, high + 1e-9)
    assert found == pytest.approx([0.48, 0.02])
    with pytest.raises(RecordingError, match="does not repeat itself"):
        _self_similar(random_periods(3, size), 0.02, 0.46 + 1e-9)


def test_no_more_harmonics_are_fitted_than_samples_tell_apart():
    """Of 24 samples a period, 0.45 times as many."""
    log = random_periods(4)
    most = _refined(log, 0.48, 0.01, 10)
    assert _refined(log, 0.48, 0.01, 1000) == most == pytest.approx(0.48, abs=1e-3)


@pytest.mark.parametrize(("at", "found"), [(9, 10), (10, 10), (17, 17), (31, 30)])
def test_a_turn_is_not_in_the_first_or_last_quarter(at, found):
    assert _turn(abs(np.arange(41.0) - at)[:, None]) == found


def changing(ratio, periods):
    """A motion with a given squared change after a period, over its variance."""
    once, change = np.random.default_rng(3).normal(size=(2, 24))
    once, change = once - once.mean(), change - change.mean()
    change *= np.sqrt(ratio / (1.0 - ratio / 4.0) * once.var() / change.var())
    q = np.concatenate([once + (-1) ** k * change / 2.0 for k in range(periods)])
    time = np.arange(24 * periods) * 0.02
    return Recording(("a",), time, np.column_stack([q]))


def test_a_tenth_of_the_variance_is_the_most_that_a_period_changes():
    assert _self_similar(changing(0.099, 2), 0.4, 0.56)[0] == pytest.approx(0.48)
    with pytest.raises(RecordingError, match="does not repeat itself"):
        _self_similar(changing(0.101, 2), 0.4, 0.56)


@pytest.mark.parametrize(("ratio", "found"), [(0.019, 0.48), (0.021, 0.96)])
def test_a_period_is_the_first_that_is_alike_to_a_fiftieth(ratio, found):
    assert _self_similar(changing(ratio, 4), 0.4, 1.2)[0] == pytest.approx(found)


@pytest.mark.parametrize(
    ("step", "guess", "harmonics", "terms"),
    [(0.01, 1.99, 5, 5), (0.1, 2.015, 200, 9), (0.1, 1.985, 200, 8)],
)
def test_a_series_has_the_harmonics_that_samples_tell_apart(
    monkeypatch, step, guess, harmonics, terms
):
    """Those slower than 0.45 of the sampling rate."""
    tried = []

    def columns(time, frequencies):
        tried.append(frequencies)
        return series_columns(time, frequencies)

    monkeypatch.setattr(repetitions, "series_columns", columns)
    period = _refined(periodic(1.5, step=step), guess, 0.01, harmonics)
    assert guess - 0.01 < period < guess + 0.01
    for frequencies in tried:
        first = frequencies[0]
        assert frequencies == pytest.approx(first * np.arange(1, terms + 1))
        assert guess - 0.01 < 1.0 / first < guess + 0.01
