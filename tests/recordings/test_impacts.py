"""Samples next to touch-down and lift-off, which a filter mixes."""

import numpy as np
import pytest

import consistent_id as ci
from consistent_id.recordings.signals.filters import zero_phase

RATE = 100.0


def _log(*closed, **more):
    samples = len(closed[0])
    contacts = [
        ci.recordings.ContactFlags(f"foot {i}", c, **more) for i, c in enumerate(closed)
    ]
    time = np.arange(samples) / RATE
    return ci.Recording(("knee",), time, np.zeros((samples, 1)), contacts=contacts)


def test_samples_within_the_guard_of_a_change_are_not_certain():
    flags = np.zeros((2, 20), dtype=bool)
    flags[0, 8:] = True  # a change at 7.5 samples
    flags[1, :14] = True  # and one at 13.5
    found = ci.signals.without_impacts(_log(*flags), 0.02)
    left_out = [np.flatnonzero(~c.certain).tolist() for c in found.contacts]
    assert left_out == [[6, 7, 8, 9], [12, 13, 14, 15]]
    assert [c.closed.tolist() for c in found.contacts] == flags.tolist()


def test_what_was_doubtful_stays_so():
    flags, certain = np.zeros(20, dtype=bool), np.ones(20, dtype=bool)
    flags[8:], certain[15] = True, False
    found = ci.signals.without_impacts(_log(flags, certain=certain), 0.01)
    assert np.flatnonzero(~found.contacts[0].certain).tolist() == [7, 8, 15]


def test_feet_that_always_stand_lose_nothing():
    found = ci.signals.without_impacts(_log(np.ones(20, dtype=bool)), 0.1)
    assert found.contacts[0].certain.all()


def test_without_a_guard_every_sample_stays():
    """A change is between two samples."""
    found = ci.signals.without_impacts(_log(np.arange(20) >= 8), 0.0)
    assert found.contacts[0].certain.all()


def test_samples_are_lost_by_time_and_not_by_number():
    flags = np.arange(200) >= 100
    slow, fast = _log(flags[::4]), _log(flags)
    fast = ci.Recording(
        fast.joints, np.arange(200) / (4 * RATE), fast.position, contacts=fast.contacts
    )
    lost = [
        (~ci.signals.without_impacts(log, 0.1).contacts[0].certain).sum()
        for log in (slow, fast)
    ]
    assert lost == [20, 80]


@pytest.mark.parametrize("cutoff", [5.0, 20.0])
def test_after_the_guard_half_a_percent_of_an_impact_is_left(cutoff):
    rate, middle = 1000.0, 2000
    impact = np.zeros((2 * middle, 1))
    impact[middle] = 1.0
    spread = abs(zero_phase(impact, cutoff=cutoff, rate=rate, order=4, pad=100)[:, 0])
    away = abs(np.arange(2 * middle) - middle) / rate
    guard = ci.signals.impact_guard(cutoff)
    assert spread[away > guard].max() < 0.005 * spread.max()
    assert spread[away > guard / 2].max() > 0.03 * spread.max()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda log: ci.signals.without_impacts(log, -0.1),
            "guard is -0.1 s, expected zero",
        ),
        (lambda log: ci.signals.without_impacts(log, np.nan), "guard is nan s"),
        (lambda log: ci.signals.without_impacts(log, np.inf), "guard is inf s"),
        (
            lambda log: ci.signals.without_impacts(
                ci.Recording(log.joints, log.time, log.position), 0.1
            ),
            "there are no contacts",
        ),
        (
            lambda _: ci.signals.impact_guard(0.0),
            "cut-off is 0.0 Hz, expected a positive",
        ),
        (lambda _: ci.signals.impact_guard(np.inf), "cut-off is inf Hz"),
    ],
)
def test_what_cannot_be_meant_is_refused(call, message):
    with pytest.raises(ci.RecordingError, match=message):
        call(_log(np.ones(20, dtype=bool)))
