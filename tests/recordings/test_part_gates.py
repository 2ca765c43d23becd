"""Parts of recordings, and folds: each limit at both sides, in whole samples."""

import numpy as np
import pytest

from consistent_id import NotExcitedError, Recording, RecordingError
from consistent_id.recordings.signals.parts import (
    blocked_folds,
    blocks_of,
    faster,
    split_at_gaps,
    trim_standstill,
    trimmed,
    without,
)


def log(time=10, **more):
    """One sample a second, or samples at given times; each shows its own time."""
    stamps = np.arange(float(time)) if np.isscalar(time) else np.array(time, float)
    return Recording(("j",), stamps, stamps[:, None], name="log", **more)


def times(recording):
    return recording.position[:, 0].tolist()


def test_trimming_keeps_both_ends_and_two_samples_at_least():
    assert times(trimmed(log(), 3.0, 5.0)) == [3.0, 4.0, 5.0]
    assert times(trimmed(log(), 3.1, 5.9)) == [4.0, 5.0]
    assert times(trimmed(log(), stop=1.0)) == [0.0, 1.0]
    assert times(trimmed(log(), 8.0)) == [8.0, 9.0]
    for start, stop, left in ((3.1, 4.9, 1), (7.0, 3.0, 0), (20.0, 30.0, 0)):
        with pytest.raises(RecordingError, match=f"{left} samples between"):
            trimmed(log(), start, stop)
    for start, stop in ((np.nan, 3.0), (3.0, np.nan)):
        with pytest.raises(RecordingError, match="trimmed from"):
            trimmed(log(), start, stop)


def test_a_recording_is_cut_where_a_step_is_longer_than_a_gap():
    whole = log([0, 1, 2, 4, 5, 9, 20, 21, 22])
    assert split_at_gaps(whole, 11.0) == (whole,)
    parts = split_at_gaps(whole, 2.0)  # a step of two is none; a single sample goes
    assert [times(part) for part in parts] == [[0, 1, 2, 4, 5], [20, 21, 22]]
    assert [part.name for part in parts] == ["log (part 1)", "log (part 2)"]
    for shortest, count in ((2.0, 2), (2.1, 1), (5.0, 1)):
        assert len(split_at_gaps(whole, 2.0, shortest=shortest)) == count
    with pytest.raises(RecordingError, match="none of 3 parts"):
        split_at_gaps(whole, 2.0, shortest=5.1)
    with pytest.raises(RecordingError, match="max_gap is 0"):
        split_at_gaps(whole, 0.0)


def test_masked_samples_are_left_out_and_what_is_left_is_cut_there():
    mask = np.zeros(10, dtype=bool)
    mask[[3, 5, 8]] = True
    parts = without(log(), mask)
    assert [times(part) for part in parts] == [[0, 1, 2], [6, 7]]
    assert [len(part) for part in without(log(), mask, shortest=1.5)] == [3]
    whole = log()
    assert without(whole, np.zeros((10, 1), dtype=bool)) == (whole,)


def test_rows_at_least_as_fast_as_a_share_of_top_speed_are_kept():
    speeds = np.array([[4.0], [2.0], [1.9], [0.0], [-2.0]])
    kept = faster(log(5, velocity=speeds), 0.5)
    assert times(kept) == [0.0, 1.0, 4.0]
    assert times(faster(log(5, velocity=speeds), 0.49)) == [0.0, 1.0, 4.0]
    assert len(faster(log(5, velocity=speeds[[0, 0, 2, 2, 2]]), 0.6)) == 2
    with pytest.raises(RecordingError, match=r"1 rows are faster than 0\.6"):
        faster(log(5, velocity=speeds), 0.6)


def test_standstill_is_cut_off_at_both_ends_but_for_a_margin():
    speeds = np.array([0, 0, 0, 1, 0, 1, 0, 0, 0, 0.0])[:, None]
    moved = log(velocity=speeds)
    assert times(trim_standstill(moved)) == [3, 4, 5]
    assert times(trim_standstill(moved, margin=2.0)) == [1, 2, 3, 4, 5, 6, 7]
    assert times(trim_standstill(moved, margin=1.9)) == [2, 3, 4, 5, 6]
    assert times(trim_standstill(moved, 0.5)) == [3, 4, 5]
    with pytest.raises(RecordingError, match="no joint ever moves"):
        trim_standstill(log(velocity=np.eye(10)[:, 3:4]))


def test_each_sample_is_held_out_once_and_the_guard_is_in_neither_part():
    folds = blocked_folds(log(), 5)
    assert [times(fold.held_out) for fold in folds] == [
        [2.0 * k, 2.0 * k + 1.0] for k in range(5)
    ]
    assert [times(part) for part in folds[2].training] == [[0, 1, 2, 3], [6, 7, 8, 9]]
    # Samples within the guard, or exactly as far, are left out.
    for guard, before, after in (
        (0.9, [0, 1, 2, 3], [6, 7, 8, 9]),
        (1.0, [0, 1, 2], [7, 8, 9]),
        (2.0, [0, 1], [8, 9]),
    ):
        fold = blocked_folds(log(), 5, guard=guard)[2]
        assert [times(part) for part in fold.training] == [before, after]
    assert fold.held_out.name == "log (block 3 of 5)"
    assert [part.name for part in fold.training] == [
        "log (before block 3 of 5)",
        "log (after block 3 of 5)",
    ]
    # A single sample is no part: of the second block, what is before it.
    fold = blocked_folds(log(), 5, guard=1.0)[1]
    assert [times(part) for part in fold.training] == [[5, 6, 7, 8, 9]]


def test_folds_that_leave_nothing_are_refused():
    assert len(blocked_folds(log(4), 2)) == 2
    for count, guard, message in (
        (1, 0.0, "1 blocks, expected 2"),
        (2, -0.1, "guard is"),
        (2, np.nan, "guard is"),
        (6, 0.0, "cannot be cut into 6 blocks"),
        (2, 4.0, "nothing is left for training 4 s away from block 1 of 2"),
    ):
        with pytest.raises(RecordingError, match=message):
            blocked_folds(log(), count, guard=guard)


def test_blocks_are_about_equally_long_and_each_recording_has_one():
    logs = [log(60), log(30), log(3)]
    assert [len(block) for block in blocks_of(logs, 9)] == [10] * 9 + [3]
    assert [len(block) for block in blocks_of(logs[:1], 4)] == [15] * 4
    whole = [sample for block in blocks_of(logs[:1], 7) for sample in times(block)]
    assert whole == list(range(60))
    assert len(blocks_of(logs[:2], 1)) == 2
    with pytest.raises(NotExcitedError, match="too short"):
        blocks_of(logs[:1], 1)
