"""Segments: nothing lost, nothing twice, nothing mixed."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment
from hypothesis import given
from hypothesis import strategies as st

from consistent_id import NotExcitedError, ProblemError, Recording, build_regression
from consistent_id.recordings import ContactFlags
from consistent_id.regression.segments import (
    _spans,
    lengthened,
    merged,
    segment_cuts,
    segment_regressions,
    segment_sources,
    segments_of,
)


def test_segments_add_up_to_the_whole_regression():
    model, truth, log = experiment(0, joints=3, noise=1.0, samples=500)
    segments = segment_regressions(model, log, count=7)
    whole, together = build_regression(model, log), merged(segments)
    assert len(segments) == 7
    assert together.counts == whole.counts
    for x in (truth, *np.random.default_rng(0).normal(size=(5, len(truth)))):
        assert together.residual_rms(x) == pytest.approx(whole.residual_rms(x))


@given(st.integers(2, 3000), st.integers(2, 60))
def test_every_sample_is_in_exactly_one_segment_of_two_or_more(samples, count):
    found = segment_cuts(samples, max(samples / count, 2.0))
    assert [i for cut in found for i in range(*cut)] == list(range(samples))
    lengths = [stop - start for start, stop in found]
    assert min(lengths) >= 2
    assert max(lengths) - min(lengths) <= 2
    assert len(found) == count or len(found) == max(samples // 2, 1) < count


def test_no_segment_has_samples_of_two_recordings():
    model, _, log = experiment(1, joints=2, samples=300)
    parts = [log.samples(slice(0, 250)), log.samples(slice(250, None))]
    segments = segment_regressions(model, parts, count=6)
    assert [s.counts[0] for s in segments] == [50, 50, 50, 50, 50, 50]
    segments = segment_regressions(model, parts, count=2)
    assert [s.counts[0] for s in segments] == [125, 125, 50]


def test_what_cannot_be_cut_is_refused():
    model, _, log = experiment(2, joints=2, samples=2)
    with pytest.raises(NotExcitedError, match="2 samples are too few"):
        segment_regressions(model, log)
    with pytest.raises(ProblemError, match="count is 1"):
        segment_regressions(model, log, count=1)
    with pytest.raises(ProblemError, match="no segments"):
        merged([])


def test_segments_know_their_recording_and_are_joined_within_it():
    model, truth, log = experiment(1, joints=2, samples=300)
    parts = [log.samples(slice(0, 250)), log.samples(slice(250, None))]
    segments = segment_regressions(model, parts, count=6)
    sources = segment_sources(parts, count=6)
    assert sources == (0, 0, 0, 0, 0, 1)
    longer, owners = lengthened(segments, sources, np.array([80.0, 90.0]))
    # The second recording is short, but there is no more of it.
    assert [s.counts[0] for s in longer] == [100, 150, 50]
    assert owners == (0, 0, 1)
    whole, together = merged(segments), merged(longer)
    assert together.residual_rms(truth) == pytest.approx(whole.residual_rms(truth))


def test_neighbours_are_one_where_contacts_are_not_certain():
    """The first joint's torque is known where contacts are doubtful, and at the end."""
    known, certain = np.ones((60, 2), dtype=bool), np.ones(60, dtype=bool)
    known[10:30, 0], certain[:10] = False, False
    log = Recording(
        ("a", "b"),
        np.arange(60.0),
        np.zeros((60, 2)),
        torque_known=known,
        contacts=[ContactFlags("foot", np.ones(60, dtype=bool), certain=certain)],
    )
    assert [len(part) for part in segments_of([log], count=6)] == [40, 10, 10]


def test_neighbours_are_one_where_a_joint_s_torque_is_not_known():
    """Of seven segments the second has no known torque of a joint: it takes the next.

    What is left over at the end joins the last.
    """
    model, _, log = experiment(0, joints=3, noise=1.0, samples=700)
    known = np.ones((700, 3), dtype=bool)
    known[100:200, 1] = known[600:, 2] = False
    part = replace(log, torque_known=known)
    segments = segment_regressions(model, part, count=7)
    assert [max(s.counts) for s in segments] == [100, 200, 100, 100, 200]
    assert segment_sources([part], count=7) == (0,) * 5
    assert merged(segments).counts == build_regression(model, part).counts


def test_two_segments_are_the_fewest():
    model, _, log = experiment(0, joints=1, samples=4)
    assert len(segment_regressions(model, log, count=2)) == 2
    with pytest.raises(NotExcitedError, match="2 samples are too few to be cut"):
        segment_regressions(model, log.samples(slice(0, 2)), count=2)


def test_a_segment_has_rows_where_contacts_are_certain():
    """Of samples without rows, more are taken until there is one."""
    certain = np.ones(12, dtype=bool)
    certain[3:8] = False
    feet = ContactFlags("foot", np.ones(12, dtype=bool), certain=certain)
    log = Recording(("a",), np.arange(12.0), np.zeros((12, 1)), contacts=(feet,))
    assert _spans(log, 3.0) == [(0, 3), (3, 9), (9, 12)]
    assert _spans(replace(log, contacts=()), 3.0) == segment_cuts(12, 3.0)
