"""Torque that lags by much, clocks, and gains: found with the size that was put in."""

from dataclasses import replace

import known_arm
import numpy as np
import pytest
from faulty_logs import DRIVE, arm, clean_log, logs

from consistent_id.diagnosis import diagnose
from consistent_id.diagnosis.explain import datasheet_constraints, fitted_log
from consistent_id.diagnosis.torque_causes import late_torque, low_pass
from consistent_id.regression import base_parameters

RATE = 200.0  # Hz, of the logs


def _candidates(log):
    """Return what is suggested of a spoilt log."""
    model = arm()
    ready = logs().prepared(log)
    constraints = datasheet_constraints(model)
    as_is = fitted_log(model, ready, constraints, base_parameters(model))
    return as_is, list(late_torque(as_is))


def _found(log, kind):
    return diagnose(arm(), log, prepare=logs().prepared).of(kind)


def test_a_filter_of_first_order_answers_a_step_as_in_closed_form():
    step = np.r_[0.0, np.ones(50)]
    t = np.arange(51)
    # Sampled, as behind a hold of one sample.
    np.testing.assert_allclose(low_pass(step, 8.0), 1.0 - np.exp(-t / 8.0), atol=1e-12)
    np.testing.assert_array_equal(low_pass(step, 0.0), step)
    np.testing.assert_allclose(low_pass(1.0 + 0.0 * t, 8.0), 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("late", [16, 40])
def test_a_long_delay_is_found_with_its_length(late):
    log = clean_log(4)
    rolled = replace(log, torque=np.roll(log.torque, late, axis=0))
    as_is, (found,) = _candidates(rolled.samples(slice(50, -50)))
    assert found.cause.kind == "lag"
    assert f"{1e3 * late / RATE:.3g} ms earlier" in found.cause.statement
    # All of it goes: what is left is less than a fifth.
    assert found.factors.least_misfit() < 0.2 * as_is.misfit


def test_a_drives_filter_is_no_delay():
    log = clean_log(4)
    filtered = low_pass(log.torque.T, 0.16 * RATE).T
    _, (found,) = _candidates(replace(log, torque=filtered))
    assert found.cause.kind == "drive filter"
    # A time constant of 0.16 s.
    assert f"{1.0 / (2.0 * np.pi * 0.16):.2g} Hz" in found.cause.statement


def test_a_clean_log_is_not_said_to_be_late():
    assert _candidates(clean_log(4))[1] == []


@pytest.mark.slow
def test_a_clock_at_half_speed_is_found_without_velocities():
    log = replace(clean_log(4), velocity=None)
    (finding,) = _found(replace(log, time=2.0 * log.time), "clock")
    speed = float(finding.statement.split("with a clock ")[1].split()[0])
    # Friction's edge moves with the speed as well, which is worth a tenth of it.
    assert speed == pytest.approx(2.0, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("velocity_scale", [0.01, 0.05, 0.08])
def test_a_wrong_velocity_of_friction_is_no_clock(velocity_scale):
    """The model says 0.02: a clock 2, 0.4 and 0.25 times as fast mends the friction."""
    model = replace(known_arm.arm(), drive=DRIVE)
    found = diagnose(model, known_arm.slow_log(model, velocity_scale))
    assert found.of("clock") == ()
    assert found.of("masses or gain") == ()
    assert found.faults == ()


@pytest.mark.slow
@pytest.mark.parametrize("gain", [0.75, 1.5])
def test_one_gain_is_found_whatever_the_masses(gain):
    log = clean_log(4)
    scale = np.array([1.0, gain, 1.0, 1.0])
    (finding,) = _found(replace(log, torque=log.torque * scale), "torque gain")
    assert (finding.severity, finding.where) == ("fault", "joint2")


@pytest.mark.slow
def test_zeros_are_judged_over_all_recordings_of_a_robot():
    both = [clean_log(2), replace(clean_log(2), name="again")]
    off = np.radians([0.0, 8.0, 0.0, 0.0])
    moved = [replace(log, position=log.position + off) for log in both]
    found = diagnose(arm(), moved, prepare=logs().prepared).of("offset zero")
    assert [(f.where, f.recording) for f in found] == [("joint2", "")]
