"""Simulated experiments whose truth is known."""

import numpy as np
from robots import random_robot, random_states

from consistent_id import (
    DHRow,
    DriveTerms,
    InertialParameters,
    Recording,
    TorqueModel,
    from_modified_dh,
    simulate_torque,
)
from consistent_id.robot import Datasheet

DRIVE = DriveTerms(viscous=True, coulomb="sign", rotor_inertia=True)


def experiment(seed, joints=4, noise=0.0, samples=1500, drive=DRIVE):
    rng = np.random.default_rng(seed)
    _, robot = random_robot(rng, joints)
    model = TorqueModel(robot, drive)
    states = random_states(rng, joints, samples)
    motion = Recording(robot.joint_names, np.arange(samples) / 100, *states)
    extra = rng.uniform(0.1, 1.0, len(model.layout) - 10 * joints)
    truth = np.concatenate([robot.nominal, extra])
    return model, truth, simulate_torque(model, truth, motion, noise=noise, rng=rng)


def pendulum(mass=2.0, com=(0.3, 0.0, 0.0)):
    robot = from_modified_dh("pendulum", [DHRow(-np.pi / 2, 0.0)])
    sheet = Datasheet(
        mass=mass, com=com, mass_bounds=(1.0, 3.0), com_box=[[0] * 3, [0.5] * 3]
    )
    model = TorqueModel(
        robot.with_datasheet({"link1": sheet}), DriveTerms(viscous=True)
    )
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-2, 2, (3, 500, 1))
    log = Recording(("joint1",), np.arange(500) / 100, q, dq, ddq)
    ball = InertialParameters.from_central(mass, com, 0.01 * np.eye(3))
    truth = np.append(ball.vector, 0.4)
    return model, truth, simulate_torque(model, truth, log)
