"""Blocks of a recording held out in turn: each sample once, with a guard around."""

import numpy as np
import pytest

from consistent_id import Recording, RecordingError, low_passed
from consistent_id.signals import blocked_folds


def _log(samples=100):
    time = np.arange(samples) * 0.01
    return Recording(("elbow",), time, np.sin(time)[:, None], name="log")


def test_each_sample_is_held_out_once_and_otherwise_learned_from():
    log = _log()
    folds = blocked_folds(log, 4)
    held_out = np.concatenate([fold.held_out.time for fold in folds])
    assert np.array_equal(held_out, log.time)
    for fold in folds:
        learned = np.concatenate([part.time for part in fold.training])
        assert np.array_equal(np.sort(np.r_[learned, fold.held_out.time]), log.time)


def test_nothing_within_the_guard_is_learned_from():
    for fold in blocked_folds(_log(), 5, guard=0.055):
        start, stop = fold.held_out.time[[0, -1]]
        for part in fold.training:
            before, after = start - part.time[-1], part.time[0] - stop
            assert max(before, after) == pytest.approx(0.06)


def test_after_the_guard_the_filter_has_forgotten_what_is_held_out():
    time = np.arange(4000) * 0.001
    torque = np.where(abs(time - 2.0) < 0.4, 1.0, 0.0)[:, None]  # the third block's own
    log = Recording(("elbow",), time, 0.0 * torque, torque=torque)
    smooth = low_passed(log, torque_cutoff=50.0)
    for part in blocked_folds(smooth, 5, guard=5.0 / 50.0)[2].training:
        assert abs(part.torque).max() < 1e-5


@pytest.mark.parametrize(
    ("count", "guard", "message"),
    [
        (1, 0.0, "1 blocks, expected 2"),
        (60, 0.0, "100 samples cannot be cut into 60"),
        (2, -1.0, "guard is -1.0 s"),
        (2, 3.0, "nothing is left for training 3 s away"),
    ],
)
def test_folds_that_cannot_be_made_are_refused(count, guard, message):
    with pytest.raises(RecordingError, match=message):
        blocked_folds(_log(), count, guard=guard)
