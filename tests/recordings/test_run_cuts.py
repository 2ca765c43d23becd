"""Parts of a recording: a walk from sample to sample is the truth."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from consistent_id import Recording, RecordingError, signals

# Seeds explicit: hypothesis derives its examples from the test's own source.
REPEATABLE = settings(derandomize=True, deadline=None, max_examples=60)
STEPS = st.lists(st.sampled_from([0.25, 0.5, 1.0]), min_size=1, max_size=12)


def recording(steps):
    """Samples whose position is their number, after steps in time [s]."""
    time = np.concatenate([[0.0], np.cumsum(steps)])
    return Recording(("elbow",), time, np.arange(len(time))[:, None] * 1.0, name="log")


def numbers(parts):
    """The samples of each part, by their numbers."""
    return [part.position[:, 0].astype(int).tolist() for part in parts]


def runs(samples, goes_on):
    """Runs of two samples or more that go on from one to the next."""
    found = []
    for sample in samples:
        if found and goes_on(found[-1][-1], sample):
            found[-1].append(sample)
        else:
            found.append([sample])
    return [run for run in found if len(run) > 1]


def cut(function, log, *arguments):
    """The samples of the parts; no part where that is an error."""
    try:
        return numbers(function(log, *arguments))
    except RecordingError:
        return []


@pytest.mark.slow
@REPEATABLE
@given(STEPS)
def test_a_recording_is_cut_after_the_last_sample_before_each_gap(steps):
    log = recording(steps)
    near = runs(range(len(log)), lambda a, b: log.time[b] - log.time[a] <= 0.5)
    assert cut(signals.split_at_gaps, log, 0.5) == near


@pytest.mark.slow
@REPEATABLE
@given(st.data(), STEPS)
def test_only_masked_samples_are_left_out_and_no_run_reaches_across_one(data, steps):
    log = recording(steps)
    mask = data.draw(st.lists(st.booleans(), min_size=len(log), max_size=len(log)))
    kept = [sample for sample in range(len(log)) if not mask[sample]]
    apart = runs(kept, lambda a, b: b == a + 1)
    assert cut(signals.without, log, np.array(mask)) == apart


def test_parts_keep_the_stamps_and_are_numbered():
    log = recording([0.5, 0.5, 1.0, 0.5, 1.0, 0.5])
    parts = signals.split_at_gaps(log, 0.5)
    assert [part.time.tolist() for part in parts] == [[0, 0.5, 1], [2, 2.5], [3.5, 4]]
    assert [part.name for part in parts] == [f"log (part {k})" for k in (1, 2, 3)]


@pytest.mark.parametrize(("shortest", "count"), [(0.0, 2), (0.5, 2), (0.6, 1), (1, 1)])
def test_a_part_lasts_from_its_first_sample_to_its_last(shortest, count):
    log = recording([0.5, 0.5, 1.0, 0.5])
    assert len(signals.split_at_gaps(log, 0.5, shortest=shortest)) == count


@pytest.mark.slow
@REPEATABLE
@given(STEPS, st.sampled_from([0.0, 0.25, 0.5, 1.0]), st.sampled_from([1.0, 1.5, 3.0]))
def test_trimming_keeps_both_times_that_it_names(steps, start, stop):
    log = recording(steps)
    inside = [k for k, time in enumerate(log.time) if start <= time <= stop]
    kept = cut(lambda *a: [signals.trimmed(*a)], log, start, stop)
    assert kept == ([inside] if len(inside) > 1 else [])


def test_standstill_is_cut_off_from_the_first_sample_that_moves_to_the_last():
    velocity = np.array([0, 0, 1, 2, 0, 2, 1, 0, 0, 0], dtype=float)
    time = np.arange(10) / 10
    log = Recording(
        ("elbow",), time, np.arange(10.0)[:, None], velocity=velocity[:, None]
    )
    assert numbers([signals.trim_standstill(log, 0.5)]) == [[2, 3, 4, 5, 6]]
    assert numbers([signals.trim_standstill(log, 0.5, margin=0.1)]) == [
        [1, 2, 3, 4, 5, 6, 7]
    ]
