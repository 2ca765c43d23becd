"""Torque of joints at rest, and of those that turn back."""

import numpy as np
import pytest

import consistent_id as ci
from consistent_id.recordings.signals.filters import zero_phase


def _log(position, step=0.01):
    time = step * np.arange(len(position))
    log = ci.Recording(("knee",), time, np.asarray(position, dtype=float)[:, None])
    return ci.differentiated(log)


@pytest.mark.parametrize("cutoff", [5.0, 20.0])
def test_after_the_guard_a_hundredth_of_a_jump_is_left(cutoff):
    rate, middle = 1000.0, 2000
    jump = (np.arange(2 * middle) >= middle).astype(float)
    found = zero_phase(jump[:, None], cutoff=cutoff, rate=rate, order=4, pad=100)[:, 0]
    away = abs(np.arange(2 * middle) - middle) / rate
    off, guard = abs(found - jump), ci.signals.rest_guard(cutoff)
    inside = (away >= guard) & (away < 1.5)  # beyond, ends of the filter
    assert off[inside].max() < 0.01 < off[away >= 0.5 * guard].max()


def test_a_joint_that_turns_back_between_two_samples_rests_with_a_reach():
    """At 1.05 s it turns, at 20 rad/s: no sample is slow."""
    time = 0.1 * np.arange(21)
    log = _log(20.0 * abs(time - 1.05), step=0.1)
    assert abs(log.velocity[[0, -1]]).min() > 19.0
    kept = ci.signals.without_rests(log, 0.01).torque_known
    assert kept.sum() == len(log) - (log.velocity == 0.0).sum()
    lost = ~ci.signals.without_rests(log, 0.01, reach=0.2).torque_known[:, 0]
    assert lost[8:14].all()
    assert not lost[:7].any() and not lost[15:].any()


def test_what_was_not_known_stays_so():
    log = _log(np.arange(20.0))
    known = np.ones((20, 1), dtype=bool)
    known[3] = False
    part = ci.signals.without_rests(
        ci.Recording(
            log.joints, log.time, log.position, log.velocity, torque_known=known
        ),
        0.01,
        reach=0.02,
    )
    assert np.array_equal(part.torque_known, known)


@pytest.mark.parametrize("cutoff", [0.0, -1.0, np.inf, np.nan])
def test_a_cut_off_that_is_none_is_refused(cutoff):
    with pytest.raises(ci.RecordingError, match="expected a positive number"):
        ci.signals.rest_guard(cutoff)


@pytest.mark.parametrize("window", [0.0, 0.02, 0.13, 9.0])
def test_a_speed_share_is_the_largest_within_half_a_window(window):
    time, dq = np.arange(200) / 100.0, np.random.default_rng(0).normal(size=(200, 2))
    log = ci.Recording(("a", "b"), time, np.zeros((200, 2)), dq)
    own, reach = (abs(dq) / abs(dq).max(axis=0)).max(axis=1), int(50 * window + 1e-6)
    expected = [own[max(i - reach, 0) : i + reach + 1].max() for i in range(200)]
    assert ci.signals.speed_share(log, window).tolist() == expected
