"""Limits of clocks: rates, gaps and steps, at both sides of each limit."""

from dataclasses import replace

import numpy as np
import pytest

from consistent_id import Recording, RecordingError
from consistent_id.recordings.beside import ContactFlags
from consistent_id.recordings.signals import clocks


def log_at(time):
    return Recording(("j",), np.asarray(time), np.sin(time)[:, None])


@pytest.mark.parametrize(
    ("rate", "upwards", "refused"),
    [
        (79.9, False, "aliased"),
        (80.0, False, None),  # 0.8 of the mean rate
        (125.0, False, None),  # 1.25 of its own
        (125.1, False, "invented"),
        (125.1, True, None),
        (79.9, True, "aliased"),
        (0.0, True, "expected a positive number"),
        (np.inf, True, "expected a positive number"),
    ],
)
def test_rates_from_four_fifths_to_five_fourths_are_allowed(rate, upwards, refused):
    if refused is None:
        clocks.require_rate("log", rate, 100.0, 100.0, upwards)
    else:
        with pytest.raises(RecordingError, match=refused):
            clocks.require_rate("log", rate, 100.0, 100.0, upwards)


def test_samples_are_invented_only_where_that_is_asked_for():
    with pytest.raises(RecordingError, match="invented"):
        clocks.require_rate("log", 200.0, 100.0, 100.0)
    log = log_at(np.arange(9) / 100)
    with pytest.raises(RecordingError, match="invented"):
        clocks.resampled(log, 200.0)
    assert clocks.resampled(log, 200.0, upwards=True).rate == pytest.approx(200.0)


def test_the_nominal_rate_is_that_of_most_steps():
    lost = np.delete(np.arange(13.0), [5, 6, 7]) / 64.0  # 9 steps in 12 / 64 s
    assert clocks.own_rate(log_at(lost)) == 64.0
    assert log_at(lost).rate == 48.0
    # A step that is too short raises the mean rate beyond that of most steps.
    assert clocks.own_rate(log_at([0.0, 1.0, 2.0, 2.25])) == 3.0 / 2.25


def test_ten_mean_steps_are_bridged_or_as_much_as_is_allowed():
    assert clocks.largest_gap(50.0, None) == 0.2
    assert clocks.largest_gap(50.0, 0.5) == 0.5
    for wrong in (0.0, -1.0, np.nan):
        with pytest.raises(RecordingError, match="max_gap"):
            clocks.largest_gap(50.0, wrong)
    gap = np.concatenate([np.arange(9), np.arange(17, 26)]) / 64.0  # a step of 9/64 s
    assert len(clocks.resampled(log_at(gap), 64.0, max_gap=9 / 64)) == 26
    with pytest.raises(RecordingError, match=r"a gap of 0.1406 s after sample 8 "):
        clocks.resampled(log_at(gap), 64.0, max_gap=8.9 / 64)


def test_steps_that_differ_by_a_thousandth_are_uniform():
    time = np.arange(11.0)  # one step is longer, by nine tenths of it than the mean
    time[5:] += 1.0e-3
    assert clocks.is_uniform(log_at(time))
    assert clocks.uniform_rate(log_at(time)) == pytest.approx(1.0 / 1.0001)
    time[5:] += 0.2e-3
    assert not clocks.is_uniform(log_at(time))
    with pytest.raises(RecordingError, match=r"step after sample 4 is 1.0012 s"):
        clocks.uniform_rate(log_at(time))


def test_distant_stamps_may_differ_by_their_rounding():
    eps = np.finfo(np.float64).eps
    assert clocks.jitter(0.01, 0.0) == 1e-5
    assert clocks.jitter(0.0, 2.0) == 8.0 * eps


def test_a_duration_has_a_sample_at_either_end():
    assert clocks.samples_at(10.0, 0.0) == 1
    assert clocks.samples_at(10.0, 0.3) == 4  # 0.3 * 10 is rounded below 3
    assert clocks.samples_at(10.0, 0.299) == 3


def test_contacts_between_stamps_are_certain_where_both_neighbours_agree():
    closed = np.array([True, True, False, False, False])
    certain = np.array([True, True, True, True, False])
    log = replace(
        log_at(np.arange(5.0)),
        contacts=(ContactFlags("foot", closed, certain=certain),),
    )
    moved = clocks.onto_clock(log, np.array([0.0, 0.5, 1.0, 1.5, 2.5, 3.5, 4.0]))
    (found,) = moved.contacts
    assert found.closed.tolist() == [True] * 4 + [False] * 3
    assert found.certain.tolist() == [True, True, False, False, True, False, False]


def commanded(time, values):
    return replace(log_at(time), position_command=np.asarray(values, float)[:, None])


def on(log, clock):
    return clocks.held_commands(log, np.asarray(clock, float))["position_command"][:, 0]


def test_commands_between_stamps_are_means_and_before_any_the_first():
    log = commanded([0.0, 1.0, 2.0], [3.0, 5.0, 7.0])
    means = on(log, [-0.5, 0.0, 0.9, 1.0, 2.5])
    assert np.allclose(means, [3.0, 3.0, 3.0, (5.0 + 0.5 * 7.0) / 1.5, 7.0], rtol=1e-14)
    assert on(log, [0.5]).tolist() == [4.0]


def test_commands_on_their_own_stamps_keep_every_bit():
    values = np.random.default_rng(3).normal(size=500)
    for time in (np.arange(500) / 250, 1.7e9 + np.arange(500) * 0.004):
        assert on(commanded(time, values), time).tolist() == values.tolist()
        nearly = time + 1e-10 * np.resize([-1.0, 1.0], 500)
        if time[0] == 0.0:  # rounding delays no command by a sample
            assert on(commanded(time, values), nearly).tolist() == values.tolist()


def test_commands_of_uneven_stamps_are_neither_late_nor_early():
    """The mean command over the motion is that of the held commands themselves."""
    rng = np.random.default_rng(5)
    clock = np.arange(1001) / 250
    time = clock + np.concatenate([[0.0], rng.uniform(-5e-4, 5e-4, 999), [0.0]])
    ramp = commanded(time, time)  # a command that says when it was given
    shift = on(ramp, clock) - clock
    assert abs(shift[1:-1].mean()) < 1e-4  # -2e-3, half a sample, if not averaged
    held = np.sum(time[:-1] * np.diff(time))
    assert np.isclose(on(ramp, clock)[:-1].sum() / 250, held, rtol=1e-12)


def test_a_rate_may_be_less_than_one_hertz():
    clocks.require_rate("log", 0.01, 0.01, 0.01)
