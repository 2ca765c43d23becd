"""What data leave to a prior is said, if other motions rest on it."""

import numpy as np
import pytest
from experiments import experiment
from quadrupeds import quadruped_text

from consistent_id import (
    BaseMotion,
    Recording,
    TorqueModel,
    base_parameters,
    build_regression,
    constrained_least_squares,
    load_mjcf,
)
from consistent_id.estimation.guessed_torque import guessed_share


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
    rich = guessed_share(model, build_regression(model, log), base, truth, known(model))
    assert rich < 0.01
    alone = np.array([0.0, 0.0, 1.0])
    states = [x * alone for x in (log.position, log.velocity, log.acceleration)]
    torque = model.predict(truth, *states)
    still = Recording(log.joints, log.time, *states, torque)
    poor = guessed_share(
        model, build_regression(model, still), base, truth, known(model)
    )
    assert poor > 0.5


def test_what_is_stated_is_not_guessed():
    model, truth, log = experiment(0, joints=2, noise=0.01, samples=40)
    base = base_parameters(model)
    regression = build_regression(model, log)
    everything = np.eye(len(truth))
    assert guessed_share(model, regression, base, truth, everything) == 0.0


def test_the_share_of_noise_is_the_error_of_predictions():
    model, truth, log = experiment(1, joints=2, samples=400)
    base = base_parameters(model)
    rng = np.random.default_rng(0)
    states = [rng.uniform(-s, s, (2000, 2)) for s in (np.pi, 2.0, 2.0)]
    true = model.predict(truth, *states)
    errors, shares = [], []
    for _ in range(20):
        torque = log.torque + 0.3 * rng.normal(size=log.torque.shape)
        noisy = build_regression(
            model,
            Recording(
                log.joints,
                log.time,
                log.position,
                log.velocity,
                log.acceleration,
                torque,
            ),
        )
        R = noisy.stacked()[:, [*base.independent, -1]]
        x = base.lift(np.linalg.lstsq(R[:, :-1], R[:, -1], rcond=None)[0])
        wrong = np.linalg.norm(model.predict(x, *states) - true, axis=0)
        errors.append((wrong / np.linalg.norm(true, axis=0)).max())
        shares.append(guessed_share(model, noisy, base, x, known(model)))
    assert np.mean(shares) == pytest.approx(
        np.sqrt(np.mean(np.square(errors))), rel=0.5
    )
