"""Noise of the motion in the regressor: attenuation in closed form, and in a loop."""

from dataclasses import replace

import numpy as np
import pytest
from some_fast import some_fast

from consistent_id import DHRow, DriveTerms, Recording, TorqueModel, from_modified_dh
from consistent_id.diagnosis.coverage import column_noise, motion_noise_findings
from consistent_id.recordings.signals import differentiated, low_passed
from consistent_id.regression import base_parameters

SLIDER = from_modified_dh("slider", [DHRow(0, 0, kind="prismatic")], gravity=[0, 0, 0])
MODEL = TorqueModel(SLIDER, DriveTerms(viscous=True))
BASE = base_parameters(MODEL)


def _slider(noise, n=4000):
    """A mass of 2 kg and 3 N s/m under white motion, its acceleration misread."""
    rng = np.random.default_rng(0)
    a, v = rng.normal(size=(2, n, 1))
    read = a + noise * rng.normal(size=(n, 1))
    force = 2.0 * a + 3.0 * v
    time = np.arange(n) / 100.0
    return Recording(SLIDER.joint_names, time, 0.0 * a, v, read, force)


def test_shares_and_bias_are_those_of_the_closed_form():
    noise = 0.1
    covariance = np.diag([0.0, 0.0, noise**2])[None]
    found = column_noise(MODEL, _slider(noise), covariance, BASE)
    share = noise**2 / (1.0 + noise**2)
    assert BASE.names == ("link1.m", "joint1.viscous")
    assert found.shares == pytest.approx([share, 0.0], rel=0.1)
    # m tends to 2 (1 - share): 2 % of the force's part of it, to first order.
    assert found.bias[0] == pytest.approx(-2.0 * share, rel=0.1)
    assert abs(found.bias[1]) < 1e-3
    expected = 2.0 * share / np.sqrt(2.0**2 + 3.0**2)
    assert found.torque_error == pytest.approx(expected, rel=0.1)
    assert found.noisiest[0][0] == "link1.m"


def test_the_bias_of_strong_noise_is_the_noises_share_of_the_power():
    noise = 0.7
    covariance = np.diag([0.0, 0.0, noise**2])[None]
    found = column_noise(MODEL, _slider(noise), covariance, BASE)
    power = 1.0 + noise**2
    estimated = 2.0 / power  # by least squares, of a mass of 2 kg
    assert found.bias[0] == pytest.approx(-(noise**2) / power * estimated, rel=0.1)


def test_noise_takes_no_more_than_a_parameter_has():
    """Without acceleration the mass is not in the data, though noise moves it."""
    still = replace(_slider(0.0), acceleration=np.full((4000, 1), 1e-9))
    found = column_noise(MODEL, still, np.diag([0.0, 0.0, 0.01])[None], BASE)
    assert found.shares[0] > 1.0
    assert found.torque_error < 0.02  # what chance explains by such a column


def test_without_noise_there_is_no_share():
    found = column_noise(MODEL, _slider(0.0), np.zeros((1, 3, 3)), BASE)
    assert not found.shares.any()
    assert found.torque_error == 0.0


def _logged(rate=500.0, step=1e-4):
    """The slider on an encoder with steps, moved as two sines."""
    time = np.arange(int(10 * rate)) / rate
    w = 2.0 * np.pi * np.array([[0.5], [0.83]])
    q = (0.3 * np.sin(w * time)).sum(axis=0)[:, None]
    dq = (0.3 * w * np.cos(w * time)).sum(axis=0)[:, None]
    ddq = (-0.3 * w**2 * np.sin(w * time)).sum(axis=0)[:, None]
    force = 2.0 * ddq + 3.0 * dq
    read = np.round(q / step) * step
    return Recording(SLIDER.joint_names, time, read, torque=force), 2.0 * ddq


@pytest.mark.slow
@pytest.mark.parametrize(("cutoff", "found"), some_fast([(100.0, 1), (5.0, 0)]))
def test_a_cutoff_that_lets_noise_through_is_warned_of(cutoff, found):
    log, _ = _logged()

    def prepare(raw):
        return differentiated(low_passed(raw, motion_cutoff=cutoff))

    warnings = motion_noise_findings(MODEL, log, prepare, BASE)
    assert len(warnings) == found
    for warning in warnings:
        assert warning.kind == "motion noise"
        assert warning.severity == "warning"
        assert "link1.m" in warning.statement
        assert "instrumental_variables" in warning.advice


@pytest.mark.slow
def test_noise_that_hardly_biases_the_torque_is_a_note():
    log, _ = _logged()
    speed = np.gradient(log.position[:, 0], log.time)[:, None]
    rubbing = replace(log, torque=log.torque + 1000.0 * speed)

    def prepare(raw):
        return differentiated(low_passed(raw, motion_cutoff=100.0))

    (found,) = motion_noise_findings(MODEL, rubbing, prepare, BASE)
    assert found.severity == "note" and "link1.m" in found.statement


def test_what_has_its_acceleration_already_is_not_judged():
    log = _slider(0.1)
    assert motion_noise_findings(MODEL, log, lambda raw: raw, BASE) == []
