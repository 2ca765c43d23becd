"""What data leave to a prior is said, if other motions rest on it."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment
from known_arm import logged
from quadrupeds import quadruped_text

from consistent_id import (
    Recording,
    TorqueModel,
    build_regression,
    constrained_least_squares,
    simulate_torque,
)
from consistent_id.constraints import (
    NonNegativeDrive,
    Penalty,
    PhysicalConsistency,
    PointToSet,
)
from consistent_id.estimation.determination import linear_errors
from consistent_id.estimation.fit import AGREES, _distance, guessed_share, prior_errors
from consistent_id.recordings import BaseMotion
from consistent_id.regression import base_parameters
from consistent_id.regression.residual_noise import unconstrained_fit
from consistent_id.regression.row_structure import random_rows
from consistent_id.robot import load_mjcf
from consistent_id.robot.scaling import USUAL_WIDTHS, link_scales, reference_bodies

KNOWN = (PhysicalConsistency(), NonNegativeDrive())


def known(model):
    return np.zeros((0, len(model.layout)))


@pytest.fixture(scope="module")
def quadruped(tmp_path_factory):
    """The floating robot, and a log of random states with all torques."""
    file = tmp_path_factory.mktemp("quadruped") / "robot.xml"
    file.write_text(quadruped_text())
    robot = load_mjcf(file, base="floating")
    rng = np.random.default_rng(0)
    n, samples = len(robot), 1500
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, samples, n))
    w, dw, a = rng.uniform(-1.0, 1.0, (3, samples, 3))
    base = BaseMotion(w, dw, a + np.array([0.0, 0.0, 9.81]))
    model = TorqueModel(robot)
    tau = model.predict(robot.nominal, q, dq, ddq, base=base)
    tau = tau + 1e-3 * rng.normal(size=tau.shape)
    time = 0.01 * np.arange(samples)
    return model, Recording(robot.joint_names, time, q, dq, ddq, tau[:, 6:], base=base)


@pytest.mark.parametrize("prior", [PointToSet(), Penalty(1e-3)])
def test_errors_of_nominal_bodies_do_not_excuse_a_penalty(prior):
    model, _, log = experiment(1, joints=2, samples=300, noise=0.1)
    regression = build_regression(model, log)
    fit = constrained_least_squares(model, regression, prior=prior).fit
    known = np.isfinite(fit.prior_errors)
    assert known.all() if prior == PointToSet() else not known.any()


@pytest.mark.slow
def test_a_trunk_that_no_joint_torque_shows_is_guessed(quadruped):
    whole, log = quadruped
    legs = TorqueModel(whole.robot, torque_joints=whole.robot.joint_names)
    found = constrained_least_squares(legs, build_regression(legs, log))
    # Seven of 16 kg are the trunk's: about so much of the base's force is the prior's.
    assert found.fit.guessed == pytest.approx(7.0 / 16.2, abs=0.1)
    assert found.verdict.word == "use with care"
    assert "mostly guessed" in [r.kind for r in found.verdict.grounds]


def test_rich_data_leave_nothing_to_guess_and_still_joints_their_bodies():
    model, truth, log = experiment(5, joints=3, noise=0.01)
    base = base_parameters(model)
    free = unconstrained_fit(build_regression(model, log), base)
    rich = guessed_share(model, free, truth, known(model))
    assert rich < 0.01
    alone = np.array([0.0, 0.0, 1.0])
    states = [x * alone for x in (log.position, log.velocity, log.acceleration)]
    torque = model.predict(truth, *states)
    still = Recording(log.joints, log.time, *states, torque)
    free = unconstrained_fit(build_regression(model, still), base)
    poor = guessed_share(model, free, truth, known(model))
    assert poor > 0.5


def test_what_is_stated_is_not_guessed():
    model, truth, log = experiment(0, joints=2, noise=0.01, samples=40)
    base = base_parameters(model)
    free = unconstrained_fit(build_regression(model, log), base)
    everything = np.eye(len(truth))
    assert guessed_share(model, free, truth, everything) == 0.0


def test_the_noisier_a_log_the_more_of_it_is_guessed():
    model, truth, log = experiment(1, joints=2, samples=400)
    base, rng = base_parameters(model), np.random.default_rng(0)
    white = rng.normal(size=log.torque.shape)
    shares = []
    for level in (1e-3, 1.0, 1e2, 1e5):
        noisy = build_regression(model, replace(log, torque=log.torque + level * white))
        free = unconstrained_fit(noisy, base)
        shares.append(guessed_share(model, free, truth, known(model)))
    assert shares == sorted(shares)
    assert shares[0] < 1e-6
    assert shares[-1] > 0.99


def test_the_guess_is_the_prior_s_share_of_a_posterior_mean():
    """One unknown: the share is ``s^2 / (s^2 + p^2)``, s its standard error."""
    model, truth, log = experiment(1, joints=2, samples=400)
    base, rng = base_parameters(model), np.random.default_rng(0)
    torque = log.torque + 2.0 * rng.normal(size=log.torque.shape)
    regression = build_regression(model, replace(log, torque=torque))
    i = model.layout.index(model.layout.names[model.layout.inertial_size])
    others = np.delete(np.eye(len(truth)), i, axis=0)
    x = np.zeros(len(truth))
    x[i] = truth[i]
    free = unconstrained_fit(regression, base)
    noise = replace(free.noise, between=())  # the share is that beside noise alone
    error = linear_errors(base, noise, others).values[i]
    # Of the one parameter that makes torque; the mean square is over all parameters.
    prior = x[i] ** 2 / len(x)
    share = guessed_share(model, free, x, others)
    # The error is of rows that count alike; the share weighs them as they scatter.
    assert share == pytest.approx(error**2 / (error**2 + prior), rel=0.02)
    assert 0.2 < share < 0.8


def errors_of_the_prior(model, log, truth):
    free = unconstrained_fit(build_regression(model, log), base_parameters(model))
    return prior_errors(model, free, truth, np.zeros((0, len(truth))))


@pytest.mark.slow
def test_a_rich_log_needs_no_prior_and_a_poor_one_a_good_prior():
    model, rich = logged(0)
    x = np.append(model.robot.nominal.ravel(), np.tile((1.0, 2.0, 0.3), 4))
    poor = replace(
        rich,
        position=0.05 * rich.position,
        velocity=0.05 * rich.velocity,
        acceleration=0.05 * rich.acceleration,
    )
    noise = np.random.default_rng(0).normal(size=rich.torque.shape)
    poor = replace(poor, torque=simulate_torque(model, x, poor).torque + 0.1 * noise)
    of_rich, of_poor = (errors_of_the_prior(model, log, x) for log in (rich, poor))
    assert of_rich.max() < 0.02
    assert np.isnan(of_poor).all()  # beyond the gate of all rows together


@pytest.mark.slow
def test_errors_of_the_prior_are_those_of_a_posterior_mean():
    """``cov = w K K^T w``, ``K = (w A^T A w + 1)^-1``, on torque of random motions."""
    model, log = logged(0, noise=1.0)
    size, x = model.layout.inertial_size, np.zeros(len(model.layout))
    x[:size], x[size:] = model.robot.nominal.ravel(), np.tile((1.0, 2.0, 0.3), 4)
    free = unconstrained_fit(build_regression(model, log), base_parameters(model))
    rows = random_rows(model)
    norms = np.where(rows.norms > 0.0, rows.norms, 1.0)
    width = np.sqrt(np.mean((norms * x) ** 2)) / norms
    width[:size] = link_scales(model.robot).widths(USUAL_WIDTHS)
    A = free.noise.coordinates @ free.base.projection
    A = np.linalg.solve(free.noise.root.T, A)
    kept = np.linalg.inv(width[:, None] * A.T @ A * width + np.eye(len(x)))
    squares = sum(rows.rms(change) ** 2 for change in (width[:, None] * kept).T)
    errors = errors_of_the_prior(model, log, x)
    assert errors.min() > 1e-3  # all of the rows make torque
    np.testing.assert_allclose(errors, np.sqrt(squares) / rows.rms(x), rtol=1e-6)


@pytest.mark.slow
def test_of_a_prior_that_the_log_contradicts_no_errors_are_known():
    model, right = logged(0)
    x = np.append(model.robot.nominal.ravel(), np.tile((1.0, 2.0, 0.3), 4))
    doubled = replace(right, velocity=0.5 * right.velocity)
    doubled = replace(doubled, acceleration=0.25 * right.acceleration)
    of_right, of_doubled = (
        errors_of_the_prior(model, log, x) for log in (right, doubled)
    )
    assert of_right.max() < 0.01
    assert np.isnan(of_doubled).all()


@pytest.mark.parametrize("speed", [1.0, 0.7, 0.5])
def test_the_distance_of_nominal_bodies_is_that_of_the_nearest_that_fit(speed):
    """``min ||L^-1 (y - M b)||^2 + ||(b - b0) / w||^2`` over bodies and free drives."""
    model, log = logged(0, spread=0.5)
    log = replace(
        log, velocity=speed * log.velocity, acceleration=speed**2 * log.acceleration
    )
    free = unconstrained_fit(build_regression(model, log), base_parameters(model))
    size = model.layout.inertial_size
    width = np.ones(len(model.layout))
    width[:size] = link_scales(model.robot).widths(USUAL_WIDTHS)
    noise, b0 = free.noise, reference_bodies(model.robot).ravel()
    L = np.linalg.cholesky(noise.scatter)
    M = np.linalg.solve(L, noise.coordinates @ free.base.projection)
    y = np.linalg.solve(L, noise.coordinates @ free.solution.x)
    pull = np.eye(size, len(width)) / width[:size, None]
    A, z = np.vstack([M, pull]), np.append(y, b0 / width[:size])
    scale = np.linalg.norm(A, axis=0)
    least = np.linalg.norm(A @ (np.linalg.lstsq(A / scale, z)[0] / scale) - z)
    bodies = sum(k < size for k in free.base.independent)
    expected = max(least / np.sqrt(bodies), 1.0)
    assert _distance(free, reference_bodies(model.robot), width) == pytest.approx(
        expected, rel=1e-5
    )
    assert (expected > AGREES) == (speed < 1.0)


@pytest.mark.slow
def test_of_a_penalty_no_errors_of_the_prior_are_known():
    model, log = logged(0)
    rows = build_regression(model, log)
    near = constrained_least_squares(model, rows, constraints=KNOWN)
    pulled = constrained_least_squares(
        model, rows, constraints=KNOWN, prior=Penalty(100.0)
    )
    assert np.isfinite(near.fit.prior_errors).all()
    assert np.isnan(pulled.fit.prior_errors).all()


def test_of_placeholders_no_errors_are_known():
    model, log = logged(0)
    body = model.robot.links[0].nominal
    links = tuple(replace(link, nominal=body) for link in model.robot.links)
    same = replace(model, robot=replace(model.robot, links=links))
    x = np.zeros(len(model.layout)) + 1.0
    assert np.isnan(errors_of_the_prior(same, log, x)).all()
