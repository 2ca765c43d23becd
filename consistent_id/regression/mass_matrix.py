"""The joint-space mass matrix, as an estimate has it, over random poses."""

from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.regression.regressor import TorqueModel

POSES = 10_000
"""Random poses at which mass matrices are examined."""


def random_poses(model: TorqueModel, count: int, seed: int) -> Array:
    """Return random positions within the joints' limits, shape (count, joints)."""
    rng = np.random.default_rng(seed)
    lower, upper = [], []
    for joint in model.robot.joints:
        reach = 1.0 if joint.kind == "prismatic" else np.pi
        low, high = joint.limits.lower, joint.limits.upper
        low = low if np.isfinite(low) else min(-reach, high - reach)
        lower.append(low)
        upper.append(high if np.isfinite(high) else max(reach, low + reach))
    return rng.uniform(lower, upper, (count, len(model.robot)))


def mass_matrices(model: TorqueModel, parameters: Vector, q: Array) -> Array:
    """Return mass matrices, shape (poses, joints, joints), [kg m^2 or kg].

    Column ``j`` is what a unit acceleration of joint ``j`` adds to the torque at rest;
    rotor inertia and couplings are part of it.
    """
    robot = replace(model.robot, gravity=np.zeros(3))
    still = replace(model, robot=robot, torque_joints=())
    rest = np.zeros_like(q)
    at_rest = still.predict(parameters, q, rest, rest)
    columns = [
        still.predict(parameters, q, rest, np.tile(unit, (len(q), 1))) - at_rest
        for unit in np.eye(len(model.robot))
    ]
    return np.stack(columns, axis=2)


def least_mass_eigenvalue(model: TorqueModel, parameters: Vector, q: Array) -> float:
    """Return the smallest eigenvalue of the mass matrix over poses."""
    M = mass_matrices(model, parameters, q)
    return float(np.linalg.eigvalsh((M + M.transpose(0, 2, 1)) / 2).min())
