"""An arm of four links and a pendulum whose bodies are known, and logs of them."""

from dataclasses import replace

import numpy as np

from consistent_id import (
    DHRow,
    DriveTerms,
    InertialParameters,
    Recording,
    TorqueModel,
    from_modified_dh,
    simulate_torque,
)
from consistent_id.robot.model import Link
from consistent_id.robot.scaling import reference_bodies

_DRIVE = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.05, offset=True)
_ROWS = [
    DHRow(0, 0, 0.4),
    DHRow(-np.pi / 2, 0.1),
    DHRow(0, 0.5, 0.1),
    DHRow(np.pi / 2, 0.05, 0.4),
]
_MASSES = (8.0, 6.0, 4.0, 2.0)
_CENTRES = ([0, 0.05, -0.1], [0.2, 0, 0.1], [0.03, -0.1, 0.05], [0.05, 0, 0.1])


OTHER_ROWS = [
    DHRow(0, 0, 0.2),
    DHRow(np.pi / 2, 0),
    DHRow(np.pi / 2, 0.1, 0.5),
    DHRow(-np.pi / 2, 0.3, 0.1),
]


def arm(rows=_ROWS):
    """Return an arm of four links, whose bodies are known."""
    robot = from_modified_dh("arm", rows)
    links = tuple(
        Link(
            link.name,
            InertialParameters.from_central(m, c, np.diag([0.02, 0.03, 0.025]) * m),
        )
        for link, m, c in zip(robot.links, _MASSES, _CENTRES, strict=True)
    )
    return TorqueModel(replace(robot, links=links), _DRIVE)


def logged(seed, *, spread=0.0, noise=0.02, friction=(1.0, 2.0, 0.3), load=None):
    """Return the model and a smooth log of a robot whose bodies may differ.

    The load is one more body, fixed to the last link.
    """
    model, rng = arm(), np.random.default_rng(seed)
    time = np.arange(600) / 30.0
    w = 2 * np.pi * rng.uniform(0.1, 0.5, (4, 3))[..., None]
    angle = w * time + rng.uniform(0, 6, (4, 3))[..., None]
    q = 0.4 * np.sin(angle).sum(axis=1).T + rng.uniform(-0.5, 0.5, 4)
    dq = 0.4 * (w * np.cos(angle)).sum(axis=1).T
    ddq = -0.4 * (w**2 * np.sin(angle)).sum(axis=1).T
    bodies = []
    for link in model.robot.links:
        nominal = link.nominal
        moved = nominal.com + spread * 0.05 * rng.normal(size=3)
        central = nominal.central_inertia * np.exp(spread * 0.3 * rng.normal())
        mass = nominal.mass * (1.0 + min(spread, 1.0) * 0.05 * rng.normal())
        bodies.append(InertialParameters.from_central(mass, moved, central).vector)
    if load is not None:
        bodies[-1] = bodies[-1] + load.vector
    truth = np.append(np.concatenate(bodies), np.tile(friction, 4))
    motion = Recording(model.robot.joint_names, time, q, dq, ddq)
    return model, simulate_torque(model, truth, motion, noise=noise, rng=rng)


def pendulum(turned):
    """Return a pendulum and its log, whose zero is off by an angle [rad]."""
    robot = from_modified_dh("pendulum", [DHRow(-np.pi / 2, 0.0)])
    body = InertialParameters.from_central(5.0, [0.3, 0.0, 0.0], 0.05 * np.eye(3))
    links = (Link(robot.links[0].name, body),)
    model = TorqueModel(replace(robot, links=links), _DRIVE)
    time = np.arange(600) / 30.0
    w = 2 * np.pi * np.array([0.1, 0.23, 0.41])
    angle = w * time[:, None] + [0.0, 1.0, 2.0]
    q, dq, ddq = (
        0.8 * np.sum(x, axis=1, keepdims=True)
        for x in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle))
    )
    motion = Recording(robot.joint_names, time, q, dq, ddq)
    truth = np.append(body.vector, [0.5, 1.0, 0.1])
    rng = np.random.default_rng(0)
    log = simulate_torque(model, truth, motion, noise=0.02, rng=rng)
    return model, replace(log, position=log.position - turned)


def slow_log(model, velocity_scale):
    """Return a log of slow motion, most of whose torque is gravity and friction."""
    rng, time = np.random.default_rng(1), np.arange(3000) / 100.0
    w = 2.0 * np.pi * rng.uniform(0.02, 0.08, (4, 3, 1))
    angle = w * time + rng.uniform(0.0, 6.0, (4, 3, 1))
    q, dq, ddq = (
        0.3 * part.sum(axis=1).T
        for part in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle))
    )
    drive = DriveTerms(
        viscous=True, coulomb="tanh", velocity_scale=velocity_scale, offset=True
    )
    truth = [*np.ravel(reference_bodies(model.robot)), *[2.0, 8.0, 0.3] * 4]
    motion = Recording(model.robot.joint_names, time, q, dq, ddq)
    true_model = replace(model, drive=drive)
    return simulate_torque(true_model, np.array(truth), motion, noise=0.1, rng=rng)
