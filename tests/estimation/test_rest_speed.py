"""Rows of joints at rest are left out where they pull at the parameters."""

from dataclasses import replace

import numpy as np
import pytest
from quadrupeds import quadruped_text, standing

import consistent_id as ci
from consistent_id.estimation import resting
from consistent_id.estimation.resting import _errors

RATE, SECONDS, STICKS = 100.0, 60, 0.15  # Hz, s, rad/s below which friction is anything
DRIVE = ci.DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.01)


def pendulum(*, sticks):
    """A pendulum that creeps and swings; what it weighs, and a log of it.

    At rest friction bears two thirds of what its Coulomb friction could, against
    gravity.
    """
    robot = ci.from_modified_dh("pendulum", [ci.DHRow(-np.pi / 2, 0)])
    model = ci.TorqueModel(robot, DRIVE)
    truth = np.zeros(len(model.layout))
    for name, value in (
        ("link1.hx", 1.0),
        ("link1.hy", 0.3),
        ("link1.Izz", 0.5),
        ("joint1.viscous", 0.2),
        ("joint1.coulomb", 3.0),
    ):
        truth[model.layout.index(name)] = value
    rng, time = np.random.default_rng(0), np.arange(SECONDS * RATE) / RATE
    waves = [(0.9, 0.11, 0.3), (0.3, 0.37, 1.2), (0.15, 0.9, 2.0)]
    q, dq, ddq = (
        sum(
            a * (2 * np.pi * f) ** k * np.sin(2 * np.pi * f * time + p + k * np.pi / 2)
            for a, f, p in waves
        )[:, None]
        for k in range(3)
    )
    torque = model.predict(truth, q, dq, ddq)
    if sticks:
        still = truth.copy()
        still[model.layout.index("joint1.coulomb")] = 0.0
        weight = model.predict(still, q, dq, ddq)
        held = weight - 2.0 * np.sign(weight)
        torque = np.where(abs(dq) < STICKS, held, torque)
    torque += 0.02 * rng.normal(size=torque.shape)
    return model, truth, ci.Recording(robot.joint_names, time, q, dq, ddq, torque)


def off(model, truth, log):
    found = ci.least_squares(model, ci.build_regression(model, log))
    names = ["link1.hx", "link1.hy", "link1.Izz"]
    return max(abs(found[n] - truth[model.layout.index(n)]) for n in names)


def test_the_lowest_speed_whose_squared_error_is_near_the_least_is_chosen(monkeypatch):
    # At the next speed the error is 3.7 times the least, its square 14 times.
    monkeypatch.setattr(resting, "GAIN", 5.0)
    model, _, log = pendulum(sticks=True)
    some = log.samples(slice(0, 6000, 4))
    found = ci.estimation.rest_speed(model, some, reach=0.01)
    squared = (found.errors**2).mean(axis=1)
    near = squared <= 6.0 * squared.min()
    assert found.speed == found.tried[near].min() > STICKS
    # The first speed leaves enough rows with the whole reach.
    assert len(found.tried) > 1 and found.reach == 0.01


def test_rests_that_pull_at_the_parameters_are_left_out():
    model, truth, log = pendulum(sticks=True)
    found = ci.estimation.rest_speed(model, log)
    assert STICKS <= found.speed <= 4 * STICKS
    without = ci.signals.without_rests(log, found.speed)
    assert off(model, truth, without) < 1e-3 < 0.02 < off(model, truth, log)


def test_where_friction_is_as_modelled_no_row_is_left_out():
    model, _, log = pendulum(sticks=False)
    found = ci.estimation.rest_speed(model, log)
    assert found.speed == 0.0
    assert found.tried[-1] == 0.0 and (np.diff(found.tried) < 0.0).all()


@pytest.mark.slow
def test_rows_free_of_contact_forces_are_compared_too(tmp_path):
    """The torque of slow joints is off by what dry friction may hold."""
    path = tmp_path / "quadruped.xml"
    path.write_text(quadruped_text())
    robot = ci.robot.load_mjcf(path, base="floating")
    patterns = np.array([[i != j for j in range(4)] for i in range(4)] * 40)
    log = standing(robot, patterns, noise=0.05)
    slow = abs(log.velocity) < np.quantile(abs(log.velocity), 0.1)
    log = replace(log, torque=log.torque + 2.0 * slow)
    model = ci.regression.contact_free_model(ci.TorqueModel(robot))
    known = dict(zip(model.layout.names[10:], robot.nominal[10:], strict=True))
    found = ci.estimation.rest_speed(
        model, log, constraints=[ci.constraints.FixedParameters(known)]
    )
    left = ci.signals.without_rests(log, found.speed).torque_known
    assert not left[slow].any()
    assert left.mean() > 0.5


@pytest.mark.slow
def test_some_torque_of_each_joint_is_left(tmp_path):
    """One joint is slow all the time: what would leave it out is not tried."""
    path = tmp_path / "quadruped.xml"
    path.write_text(quadruped_text())
    robot = ci.robot.load_mjcf(path, base="floating")
    patterns = np.array([[i != j for j in range(4)] for i in range(4)] * 50)
    log = standing(robot, patterns, noise=0.05)
    velocity = log.velocity.copy()
    velocity[:, 3] *= 0.01
    log = replace(log, velocity=velocity, wrenches=())
    known = dict(
        zip(
            ci.TorqueModel(robot).layout.names[10:],
            robot.nominal[10:],
            strict=True,
        )
    )
    model = ci.regression.contact_free_model(ci.TorqueModel(robot))
    found = ci.estimation.rest_speed(
        model, log, constraints=[ci.constraints.FixedParameters(known)]
    )
    assert found.tried.max() < 0.01 < np.median(abs(log.velocity))
    for speed in found.tried[:-1]:
        assert ci.signals.without_rests(log, speed).torque_known.any(axis=0).all()


def test_a_reach_that_leaves_too_few_rows_is_shortened():
    """Every 0.5 s a joint turns back: guards of 0.3 s to either side are all of it."""
    model, _, log = pendulum(sticks=False)
    time = log.time[:, None]
    log = replace(
        log, velocity=np.cos(2 * np.pi * time), position=np.sin(2 * np.pi * time)
    )
    assert ci.estimation.rest_speed(model, log, reach=0.06).reach == 0.06
    found = ci.estimation.rest_speed(model, log, reach=0.3)
    assert found.reach == pytest.approx(0.2)
    assert len(found.tried) > 1


def test_what_does_not_move_has_no_rests():
    model, _, log = pendulum(sticks=False)
    with pytest.raises(ci.NotExcitedError, match="no joint moves"):
        ci.estimation.rest_speed(model, replace(log, velocity=0 * log.velocity))
    with pytest.raises(ci.ProblemError, match="rests show in velocity"):
        ci.estimation.rest_speed(model, replace(log, velocity=None, acceleration=None))


def test_parts_are_predicted_by_the_others_along_the_allowed_combinations():
    """Rows of steps, of a start that is known, and of the torque."""
    rng = np.random.default_rng(0)
    parts = [rng.normal(size=(n, 5)) for n in (9, 12, 7)]
    tested = [rng.normal(size=(6, 5)) for _ in parts]
    turn = rng.normal(size=(3, 2))
    found = _errors(parts, tested, turn)
    for k, rows in enumerate(tested):
        A, start, torque = np.split(
            np.vstack(parts[:k] + parts[k + 1 :]), [3, 4], axis=1
        )
        y = turn @ np.linalg.lstsq(A @ turn, torque - start, rcond=None)[0]
        rest = rows[:, :3] @ y[:, 0] + rows[:, 3] - rows[:, 4]
        assert found[k] == pytest.approx(
            np.linalg.norm(rest) / np.linalg.norm(rows[:, 4])
        )
