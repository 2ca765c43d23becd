"""Regressions for penalised fits, and what they are compared with."""

import numpy as np
from experiments import DRIVE
from robots import random_body, random_robot, random_states

from consistent_id import (
    Recording,
    TorqueModel,
    build_regression,
    simulate_torque,
)


def noisy(seed, joints, drive=DRIVE, noise=0.1, samples=200):
    """A robot other than the nominal one, and noise relative to its torque."""
    rng = np.random.default_rng(seed)
    _, robot = random_robot(rng, joints)
    model = TorqueModel(robot, drive)
    states = random_states(rng, joints, samples)
    log = Recording(robot.joint_names, np.arange(samples) / 100, *states)
    others = [random_body(rng).vector for _ in range(joints)]
    extra = rng.uniform(0.1, 1.0, len(model.layout) - 10 * joints)
    truth = np.concatenate([*others, extra])
    sigma = noise * simulate_torque(model, truth, log).torque.std(axis=0) + 1e-9
    log = simulate_torque(model, truth, log, noise=sigma, rng=rng)
    return model, build_regression(model, log).weighted(sigma)


def objective(fit, distance, weight, u):
    return (fit.excess(u) + weight * distance.squared(u)) / 2
