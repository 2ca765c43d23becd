"""Delay, scale and encoder bias, found again where they are known."""

from dataclasses import replace

import numpy as np
import pytest
from robots import random_robot
from test_command_delay import GAINS, TIME, motion

from consistent_id import (
    DriveTerms,
    ProblemError,
    Recording,
    RecordingError,
    TorqueModel,
)
from consistent_id.constraints import FixedParameters
from consistent_id.estimation import fit_calibration
from consistent_id.signals import DriveCalibration, calibrated

DRIVE = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.1, offset=True)
TRUTH = DriveCalibration(0.0064, [1.08, 0.93, 1.02], [0.02, -0.03, 0.015])


def told(model, x, truth, noise=0.0):
    """A log of drives that are late and weak, and of encoders that are turned.

    The torque at a time is the true one of the motion; the command that makes it was
    given a delay, and half a step, before.
    """
    late = truth.delay + 0.5 * (TIME[1] - TIME[0])
    q, dq, ddq = motion(TIME, len(model.robot))
    qe, dqe, ddqe = motion(TIME + late, len(model.robot))
    torque = model.predict(x, qe, dqe, ddqe) / truth.scale
    torque += noise * np.random.default_rng(1).standard_normal(torque.shape)
    command = qe + (torque + GAINS.kd * dqe) / GAINS.kp
    names, bias = model.robot.joint_names, truth.encoder_bias
    return Recording(names, TIME, q + bias, dq, ddq, position_command=command + bias)


def robot_of(seed, joints):
    """A chain, its torque model, parameters, and what fixes its bodies."""
    _, robot = random_robot(np.random.default_rng(seed), joints)
    model = TorqueModel(robot, DRIVE)
    x = np.append(robot.nominal, np.tile([0.3, 0.2, 0.1], joints))
    names = model.layout.names[: 10 * joints]
    return model, x, FixedParameters(dict(zip(names, x.tolist(), strict=False)))


def recordings(log):
    # The last samples have no command that was given later.
    return lambda known: [calibrated(log, GAINS, known).samples(slice(0, 2900))]


@pytest.mark.slow
def test_delay_scale_and_bias_are_found_again_together():
    model, x, bodies = robot_of(5, 3)
    log = told(model, x, TRUTH, noise=0.02)
    fit = fit_calibration(model, recordings(log), constraints=[bodies])
    truth = np.r_[TRUTH.delay, TRUTH.scale, TRUTH.encoder_bias]
    assert fit.known.all()
    # Linear interpolation of 200 Hz commands: 0.05 ms, and its share of the others.
    slack = np.r_[5e-5, np.full(3, 1e-3), np.full(3, 5e-4)]
    assert (abs(fit.values - truth) < 4.0 * fit.standard_errors + slack).all()
    assert (fit.standard_errors > 0.0).all()
    assert abs(fit.calibration.delay - TRUTH.delay) < 2e-4


@pytest.mark.slow
def test_errors_are_those_of_repeated_noise():
    model, x, bodies = robot_of(5, 2)
    truth = DriveCalibration(0.0, [1.05, 0.95], [0.02, -0.01])
    log = told(model, x, truth)
    found, errors = [], []
    size = 0.03 * recordings(log)(truth)[0].torque.std(axis=0)
    for seed in range(40):
        noise = size * np.random.default_rng(seed).standard_normal((2900, 2))

        def noisy(known, noise=noise):
            (one,) = recordings(log)(known)
            return [replace(one, torque=one.torque + noise)]

        names = ("scale", "encoder_bias")
        fit = fit_calibration(model, noisy, names, constraints=[bodies])
        found.append(fit.values[1:])
        errors.append(fit.standard_errors[1:])
    scatter = np.std(found, axis=0, ddof=1)
    # 40 draws know a standard deviation to 11 %; here are three such errors.
    assert scatter == pytest.approx(np.mean(errors, axis=0), rel=0.35)


def test_what_bodies_explain_as_well_is_not_known():
    model, x, _ = robot_of(5, 2)
    known = DriveCalibration(0.0, [1.0, 1.0], [0.0, 0.0])
    log = told(model, x, known, noise=0.02)
    fit = fit_calibration(model, recordings(log), ("scale",))
    # All parameters a tenth larger are drives that are a tenth weaker.
    assert not fit.known[1:3].any()
    assert fit.calibration.scale == pytest.approx([1.0, 1.0], rel=0.02)
    assert "not known" in fit.table().text()
    assert fit.standard_errors[0] == 0.0


def test_what_is_not_asked_for_stays_as_stated():
    model, x, bodies = robot_of(5, 2)
    truth = DriveCalibration(0.0, [1.1, 0.9], [0.0, 0.0])
    log = told(model, x, truth)
    start = DriveCalibration(0.0, encoder_bias=[0.0, 0.0])
    fit = fit_calibration(
        model, recordings(log), ("scale",), start=start, constraints=[bodies]
    )
    assert fit.calibration.scale == pytest.approx(truth.scale, rel=5e-3)
    assert fit.known[1:3].all()  # known bodies show the drives' scale
    assert fit.calibration.encoder_bias.tolist() == [0.0, 0.0]
    with pytest.raises(ProblemError, match="colour"):
        fit_calibration(model, recordings(log), ("colour",))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"delay": -1e-6}, "delay of commands is -1e-06 s, expected 0 or more"),
        ({"delay": np.inf}, "delay of commands is inf"),
        ({"delay": np.nan}, "delay of commands is nan"),
        ({"scale": [1.0, 0.0]}, "scale is .* expected positive numbers"),
        ({"compliance": [0.0, -1e-9]}, "compliance is .* expected 0 or more"),
    ],
)
def test_drives_that_cannot_be_are_refused(wrong, message):
    with pytest.raises(RecordingError, match=message):
        DriveCalibration(**wrong)


def test_a_drive_does_not_feel_its_encoder_s_bias():
    model, x, _ = robot_of(5, 2)
    log = told(model, x, DriveCalibration())
    plain = calibrated(log, GAINS, DriveCalibration())
    turned = calibrated(log, GAINS, DriveCalibration(encoder_bias=0.1))
    assert turned.torque == pytest.approx(plain.torque, abs=1e-12)
    assert turned.position == pytest.approx(plain.position - 0.1, abs=1e-15)


def test_bodies_that_are_not_known_leave_the_bias_of_the_last_encoder_open():
    model, x, _ = robot_of(5, 2)
    none = DriveCalibration(0.0, [1.0, 1.0], [0.0, 0.0])
    log = told(model, x, replace(none, encoder_bias=np.array([0.02, -0.01])))
    fit = fit_calibration(model, recordings(log), ("encoder_bias",), start=none)
    # Gravity shows the first joint's; turning the last body's axes undoes the other.
    assert fit.known[3:].tolist() == [True, False]
    assert fit.calibration.encoder_bias[0] == pytest.approx(0.02, abs=1e-3)
    assert 0.0 < fit.standard_errors[3] < 1e-3
    assert fit.standard_errors[4] == pytest.approx(0.05, rel=1e-3)  # of the prior


def test_a_large_bias_is_found_as_exactly_as_a_small_one():
    model, x, bodies = robot_of(5, 1)
    none = DriveCalibration(0.0, [1.0], [0.0])
    small, large = (
        fit_calibration(
            model,
            recordings(told(model, x, replace(none, encoder_bias=np.array([bias])))),
            ("encoder_bias",),
            start=none,
            constraints=[bodies],
        ).calibration.encoder_bias[0]
        for bias in (0.02, 0.2)
    )
    assert large - small == pytest.approx(0.18, abs=1e-4)
