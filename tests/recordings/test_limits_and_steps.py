"""Limits of torque and steps of encoders are found where they are, and only there."""

import numpy as np
import pytest
from swinging_logs import log, tones

from consistent_id import signals
from consistent_id.recordings.signals.masks import quantum


@pytest.mark.parametrize("step", [0.0, 1e-3])
def test_clipped_torque_is_told_from_the_top_of_a_smooth_curve(step):
    time = np.arange(5000) / 1000.0
    smooth = np.column_stack([np.sin(3 * time), 2 * np.sin(3 * time)])
    tau = smooth.copy()
    tau[:, 0] = np.clip(tau[:, 0], -0.9, 0.92)
    if step:
        tau = np.round(tau / step) * step
    recording = log(time, smooth, torque=tau)
    mask = signals.saturated(recording)
    limited = (tau[:, 0] <= -0.9 + 1e-9) | (tau[:, 0] >= 0.92 - 1e-9)
    assert (mask[:, 0] == limited)[abs(tau[:, 0]) < 0.899].all()
    assert mask[limited, 0].all()
    assert not mask[:, 1].any()
    known = signals.saturated(recording, [0.9, 5.0])
    assert known[:, 0].sum() >= mask[:, 0].sum() and not known[:, 1].any()
    weights = signals.row_weights(recording, mask, ("b", "a"))
    assert (weights[:, 1] == ~mask[:, 0]).all() and weights[:, 0].all()


def test_a_torque_that_stays_below_its_largest_absolute_value_is_not_limited():
    # A joint that carries weight: its torque is negative, its least torque is 5 of 87.
    time = np.arange(4000) / 200.0
    tau = np.minimum(-46.0 - 41.0 * np.sin(2.0 * time), -5.3)[:, None]
    assert not signals.saturated(log(time, np.sin(time), torque=tau)).any()


def test_a_single_plateau_and_short_ones_are_not_limits():
    time = np.arange(4000) / 1000.0
    rising = np.minimum(np.minimum(time, 4.0 - time), 1.0)[:, None]
    # Twice: ramps to 1 that stay there for 20 or 60 ms.
    sawtooth = abs((time % 2.0) - 1.0)
    assert not signals.saturated(log(time, time, torque=rising)).any()
    for seconds, limited in ((0.02, False), (0.06, True)):
        tau = np.minimum(sawtooth, 1.0 - 0.5 * seconds)[:, None]
        assert signals.saturated(log(time, time, torque=tau)).any() == limited


def test_steep_ramps_that_stay_for_twenty_milliseconds_are_not_at_a_limit():
    time = np.arange(4000) / 1000.0
    sawtooth = abs((time % 0.5) / 0.25 - 1.0)  # 4 per second
    for seconds, limited in ((0.02, False), (0.06, True)):
        tau = np.minimum(sawtooth, 1.0 - 2.0 * seconds)[:, None]
        assert signals.saturated(log(time, time, torque=tau)).any() == limited


def test_equal_readings_show_a_limit_that_noise_interrupts():
    # Noise of 10 % leaves single samples at the limit.
    rng = np.random.default_rng(1)
    time = np.arange(3000) / 250.0
    smooth = np.sin(3.0 * time) + 0.1 * rng.normal(size=len(time))
    for step in (0.0, 1e-3):
        whole = np.round(smooth / step) * step if step else smooth
        tau = np.clip(whole, -1.15, 1.15)[:, None]
        mask = signals.saturated(log(time, time, torque=tau))
        assert (mask[:, 0] == (abs(tau[:, 0]) >= 1.15)).all() and mask.sum() > 20
        assert not signals.saturated(log(time, time, torque=whole[:, None])).any()


def test_a_limit_is_found_beside_more_rests_at_less_than_half_of_it():
    # Six times at the limit for 0.43 s, and seven times at a fifth of it for 0.5 s.
    time = np.arange(7700) / 1000.0
    slow = np.interp(time % 1.2, [0.0, 0.5, 0.7, 1.0, 1.2], [0.2, 0.2, 1.4, 1.4, 0.2])
    tau = np.minimum(slow, 1.0)[:, None]
    mask = signals.saturated(log(time, time, torque=tau))
    assert (mask == (tau == 1.0)).all()


def test_a_torque_held_at_rest_is_not_limited():
    # Pick and place, simulated without noise: 1 s of motion, then 1 s of rest.
    time = np.arange(8000) / 1000.0
    phase = np.pi * np.minimum(time % 2.0, 1.0)
    angle = 0.5 * (1.0 - np.cos(phase)) * np.where(time % 4.0 < 2.0, 1.0, -1.0)
    angle += np.where(time % 4.0 < 2.0, 0.0, 1.0)
    recording = log(time, angle, torque=10.0 * angle[:, None])
    assert not signals.saturated(recording).any()


def test_a_torque_that_is_computed_in_steps_is_not_limited():
    time = np.arange(6000) / 100.0
    knots = np.arange(601) * 0.1
    steps = np.sin(1.3 * knots) + 0.4 * np.sin(3.1 * knots)
    uneven = np.searchsorted(knots + 0.03 * np.sin(7.0 * knots), time, "right") - 1
    recording = log(time, np.sin(time), torque=steps[uneven][:, None])
    assert not signals.saturated(recording).any()


@pytest.mark.parametrize("step", [2e-5, 2 * np.pi / 2**17, 1.534e-5, 1e-3])
@pytest.mark.parametrize("seed", range(3))
def test_an_encoders_step_is_found_where_there_is_one(step, seed):
    time = np.arange(4000) / 1000.0
    q = tones(np.random.default_rng(seed))(time)
    coarse = signals.encoder_resolution(log(time, np.round(q / step) * step + 0.1))
    np.testing.assert_allclose(coarse, step, rtol=1e-5)
    single = np.float32(np.round(q / 1e-3) * 1e-3).astype(float)
    np.testing.assert_allclose(
        signals.encoder_resolution(log(time, single)), 1e-3, rtol=1e-5
    )
    assert not signals.encoder_resolution(log(time, q)).any()


def test_motion_at_even_speed_and_standstill_have_no_step():
    time = np.arange(2000) / 1000.0
    even = np.column_stack([0.3 * time + 1e-3 * np.sin(time), 0 * time])
    assert not signals.encoder_resolution(log(time, even)).any()


@pytest.mark.parametrize(("far", "found"), [(3000, 2.0**-10), (3001, 0.0)])
def test_a_quantum_is_told_by_steps_of_up_to_three_thousand_of_it(far, found):
    # Half of the steps have to tell of it; of those here, eighteen of 34 are far ones.
    multiples = [1] * 10 + [2, 3, 4, 5, 6, 7] + [far] * 18
    assert quantum(np.cumsum(multiples) * 2.0**-10) == found


@pytest.mark.parametrize(("steps", "found"), [(11, 0.0), (12, 2.0**-10)])
def test_a_quantum_is_known_from_twelve_steps_on(steps, found):
    multiples = np.r_[0, 1 + np.arange(steps) % 3]
    assert quantum(np.cumsum(multiples) * 2.0**-10) == found
