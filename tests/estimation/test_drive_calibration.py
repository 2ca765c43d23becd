"""Delay, scale and encoder bias, found again where they are known."""

from dataclasses import replace

import numpy as np
import pytest
from robots import random_robot
from test_command_delay import GAINS, TIME, motion

from consistent_id import (
    DHRow,
    DriveTerms,
    InertialParameters,
    ProblemError,
    Recording,
    RecordingError,
    TorqueModel,
    build_regression,
    from_modified_dh,
)
from consistent_id.constraints import FixedParameters
from consistent_id.estimation import command_delay, fit_calibration
from consistent_id.estimation.drive_calibration import UNKNOWNS
from consistent_id.regression.correlated_noise import spectral_errors
from consistent_id.regression.residual_noise import joint_noise
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


# ----- drives and noise in closed form: torque that the calibration shifts and scales

SPREADS = np.r_[0.03, 0.1, 0.1, 0.05, 0.005]  # delay, scales, biases: turn, slide


class Shifted:
    """A log whose torque is linear in the delay, with noise that is correlated.

    Bodies are known, so that friction alone is fitted; noise is so large that the
    prior counts.
    """

    def __init__(self, truth, noise=(1.0, 6.0), samples=400):
        rows = DHRow(np.pi / 2, 0.0), DHRow(0.5, 0.5, kind="prismatic")
        arm = from_modified_dh("arm", rows)
        body = InertialParameters.from_central(2.0, [0.2, 0.1, 0.0], 0.02 * np.eye(3))
        robot = replace(arm, links=tuple(replace(k, nominal=body) for k in arm.links))
        self.model, self.truth = TorqueModel(robot, DRIVE), truth
        known = dict(zip(self.model.layout.names[:20], robot.nominal, strict=False))
        self.bodies = FixedParameters({name: float(v) for name, v in known.items()})
        rng, time = np.random.default_rng(2), TIME[:samples]
        self.states = motion(time, 2)
        x = np.append(robot.nominal, np.tile([0.3, 0.2, 0.1], 2))
        white = rng.normal(size=(samples, 2))
        slow = white + 0.8 * np.vstack([np.zeros((1, 2)), white[:-1]])
        self.torque = self.model.predict(x, *self.states) + slow * noise
        self.effect = 300.0 * np.column_stack([np.cos(9 * time), np.sin(7 * time)])
        self.time, self.x = time, x

    def __call__(self, known):
        """What `fit_calibration` calls: the log as these drives and encoders see it."""
        values = np.r_[known.delay, known.scale, known.encoder_bias]
        return [self.seen(values)]

    def seen(self, values):
        """The log for any values, also those that no drive has."""
        truth, (q, dq, ddq) = self.truth, self.states
        late = (values[0] - truth.delay) * self.effect
        torque = (self.torque + late) * values[1:3] / truth.scale
        q = q + truth.encoder_bias - values[3:]
        names = self.model.robot.joint_names
        return Recording(names, self.time, q, dq, ddq, torque)

    def residuals(self, values):
        """Columns of friction, and what they shall explain, of each joint."""
        log = self.seen(values)
        Y = self.model.regressor(log.position, log.velocity, log.acceleration)
        Y = Y.swapaxes(1, 2)
        return [
            (Y[j, :, 20:], log.torque[:, j] - Y[j, :, :20] @ self.x[:20])
            for j in range(2)
        ]

    def levels(self, values):
        regression = build_regression(self.model, self.seen(values))
        return joint_noise(self.model, regression), regression.correlation

    def friction(self, values, levels):
        """Friction's parameters, by least squares."""
        rows = self.residuals(values)
        A = np.vstack([Y / s for (Y, _), s in zip(rows, levels, strict=True)])
        b = np.hstack([r / s for (_, r), s in zip(rows, levels, strict=True)])
        return np.linalg.lstsq(A, b, rcond=None)[0]


@pytest.mark.slow
@pytest.mark.parametrize("shown", [2**14, 150])
@pytest.mark.parametrize(
    ("found", "delay"),
    [(UNKNOWNS, 0.02), (("encoder_bias",), 0.0), (("delay", "scale"), -0.1)],
)
def test_a_calibration_is_the_optimum_of_misfit_and_prior_with_its_errors(
    monkeypatch, found, delay, shown
):
    monkeypatch.setattr("consistent_id.estimation.drive_calibration.SHOWN", shown)
    start = DriveCalibration(0.0, [1.05, 0.9], [0.01, -0.02])
    bias = [0.08, -0.06] if "encoder_bias" in found else start.encoder_bias
    scale = [1.3, 0.8] if "scale" in found else start.scale
    log = Shifted(DriveCalibration(0.0, scale, bias))
    log.torque = log.torque - delay * log.effect
    fit = fit_calibration(log.model, log, found, start=start, constraints=[log.bodies])
    values, errors = fit.values, fit.standard_errors
    stated = np.r_[0.0, start.scale, start.encoder_bias]
    wanted = np.repeat([name in found for name in UNKNOWNS], [1, 2, 2])
    np.testing.assert_array_equal(values[~wanted], stated[~wanted])
    np.testing.assert_array_equal(errors[~wanted], 0.0)
    level, correlation = log.levels(values)
    assert (abs(np.log(correlation)) > 0.1).all()
    level = level * np.sqrt(correlation)

    f = log.friction(values, level)

    def left(v):
        return np.array([r - Y @ f for Y, r in log.residuals(v)])

    # What is left moves with the values; with the logarithm of a scale it moves by the
    # predicted torque: the measured one would scale its noise, and so be too small.
    steps = np.diag([1e-5, 1.0, 1.0, 1e-5, 1e-5])
    moved = [(left(values + h) - left(values - h)) / (2 * h.max()) for h in steps]
    predicted = log.seen(values).torque.T - left(values)
    moved[1:3] = np.eye(2)[:, :, None] * predicted
    moved, unit = np.array(moved)[wanted], np.r_[1.0, values[1:3], 1.0, 1.0]
    away = values - stated
    away[1:3] = np.log(values[1:3] / stated[1:3])
    slope = np.einsum("kjt,jt->k", moved, left(values) / level[:, None] ** 2)
    slope += (away / SPREADS**2)[wanted]
    if delay >= 0.0:
        # The distance to the optimum, in standard errors: smaller steps are the last.
        assert (abs(slope * (errors / unit)[wanted]) < 0.05).all()
    else:
        assert values[0] == 0.0 < slope[0]
    # Errors are those of least squares with a row of the prior for each value.
    total, n = len(log.time), len(moved)
    count = min(shown, total)
    middle = slice((total - count) // 2, (total + count) // 2)
    rows = [
        np.column_stack([Y, -moved[:, j].T, r])[middle] / level[j]
        for j, (Y, r) in enumerate(log.residuals(values))
    ]
    share = np.sqrt(count / total)
    prior = np.zeros((n, 6 + n + 1))
    prior[:, 6:-1] = share * np.diag(1.0 / SPREADS[wanted])
    expected = share * spectral_errors(rows, prior)[6:] * unit[wanted]
    np.testing.assert_allclose(errors[wanted], expected, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("shown", [2**14, 150])
@pytest.mark.parametrize("delay", [0.013, 0.0, -0.01, 0.04])
def test_a_delay_is_that_of_least_squares_beside_friction(monkeypatch, delay, shown):
    monkeypatch.setattr("consistent_id.estimation.delayed_commands.SHOWN", shown)
    log = Shifted(DriveCalibration(0.0, [1.0, 1.0], [0.0, 0.0]), noise=(0.2, 2.0))
    log.torque = log.torque - delay * log.effect
    found = command_delay(
        log.model,
        lambda seconds: [log.seen(np.r_[seconds, 1.0, 1.0, 0.0, 0.0])],
        constraints=[log.bodies],
    )
    nearest = found.tried[np.argmin(found.misfits)]
    values = np.r_[nearest, 1.0, 1.0, 0.0, 0.0]
    level, _ = log.levels(values)
    rows = [
        np.column_stack([Y, -log.effect[:, j], r]) / level[j]
        for j, (Y, r) in enumerate(log.residuals(values))
    ]
    A = np.vstack(rows)
    exact = nearest + np.linalg.lstsq(A[:, :-1], A[:, -1], rcond=None)[0][-1]
    assert found.seconds == pytest.approx(np.clip(exact, 0.0, 0.03), abs=1e-9)
    assert nearest == pytest.approx(found.seconds, abs=0.5 * 0.03 / 6 / 8 + 1e-12)
    total = len(log.time)
    count = min(shown, total)
    middle = slice((total - count) // 2, (total + count) // 2)
    parts = [own[middle] for own in rows]
    error = spectral_errors(parts)[-1] * np.sqrt(count / total)
    assert found.standard_error == pytest.approx(error, rel=1e-6)
    # The misfit is that of friction beside each delay.
    for seconds, misfit in zip(found.tried, found.misfits, strict=True):
        b = A[:, -1] - (seconds - nearest) * A[:, -2]
        least = np.linalg.lstsq(A[:, :-2], b, rcond=None)[1][0]
        at = np.linalg.lstsq(A[:, :-2], A[:, -1], rcond=None)[1][0]
        assert misfit == pytest.approx(least / at, rel=1e-6)
