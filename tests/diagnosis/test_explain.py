"""What a log leaves unexplained, beside what laws of friction always leave."""

from dataclasses import replace

import numpy as np
import pytest
from faulty_logs import DRIVE

from consistent_id import (
    DHRow,
    InertialParameters,
    Recording,
    TorqueModel,
    from_modified_dh,
    simulate_torque,
)
from consistent_id.diagnosis import diagnose
from consistent_id.diagnosis.explain import datasheet_constraints, fitted_log
from consistent_id.regression.base import base_parameters
from consistent_id.robot.model import Link

FRICTION = np.array([1.0, 2.0, 0.0])  # viscous, coulomb, offset


def _swing(inertia):
    """Return a level joint with a body [kg m^2], and its log: friction has a ripple."""
    robot = from_modified_dh("pan", [DHRow(0, 0)])
    body = InertialParameters.from_central(5.0, [0.0, 0.0, 0.0], inertia * np.eye(3))
    links = tuple(Link(link.name, body) for link in robot.links)
    model = TorqueModel(replace(robot, links=links), DRIVE)
    time = np.arange(3000) / 100.0
    omega, phase = 2 * np.pi * np.array([[0.13], [0.29], [0.47]]), [[0.0], [1.0], [2.0]]
    q = (0.6 * np.sin(omega * time + phase)).sum(axis=0)
    dq = (0.6 * omega * np.cos(omega * time + phase)).sum(axis=0)
    ddq = (-0.6 * omega**2 * np.sin(omega * time + phase)).sum(axis=0)
    states = (x[:, None] for x in (q, dq, ddq))
    motion = Recording(model.robot.joint_names, time, *states)
    rubbed = simulate_torque(model, np.append(np.zeros(10), FRICTION), motion).torque
    whole = np.append(np.asarray(model.robot.nominal), FRICTION)
    torque = simulate_torque(model, whole, motion).torque
    torque = torque + 0.14 * np.sin(9.0 * motion.position) * rubbed
    noise = 0.02 * np.random.default_rng(0).normal(size=torque.shape)
    return model, replace(motion, torque=torque + noise), rubbed


def _fitted(model, log):
    base = base_parameters(model)
    return fitted_log(model, log, datasheet_constraints(model), base)


@pytest.mark.parametrize("inertia", [0.01, 1.0, 10.0])
def test_the_share_of_friction_is_that_with_which_the_log_was_made(inertia):
    model, log, rubbed = _swing(inertia)
    share = np.linalg.norm(rubbed) / np.linalg.norm(log.torque)
    assert _fitted(model, log).friction == pytest.approx(min(share, 1.0), abs=0.03)


def test_friction_that_varies_is_no_other_robot():
    model, log, _ = _swing(0.01)
    assert _fitted(model, log).misfit > 0.08
    assert diagnose(model, log).of("model does not explain") == ()
    # As much beside a torque that bodies make is not friction's.
    model, log, _ = _swing(3.0)
    ripple = 0.14 * np.std(log.torque) * np.sin(9.0 * log.position)
    odd = replace(log, torque=log.torque + ripple)
    assert diagnose(model, odd).of("model does not explain") != ()
