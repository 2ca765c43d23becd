"""The joint-space mass matrix, as an estimate has it, over random poses."""

from dataclasses import replace

import numpy as np

from consistent_id._arrays import Array, Vector
from consistent_id.regressor import TorqueModel

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

    Column ``j`` is the torque of a unit acceleration of joint ``j`` from rest without
    gravity, friction or offsets; rotor inertia is part of it.
    """
    still = replace(model.robot, gravity=np.zeros(3))
    drive = tuple(replace(terms, offset=False) for terms in model.terms)
    bare = TorqueModel(still, drive)
    x = np.array([parameters[model.layout.index(name)] for name in bare.layout.names])
    n = len(model.robot)
    columns = [
        bare.predict(x, q, np.zeros_like(q), np.tile(unit, (len(q), 1)))
        for unit in np.eye(n)
    ]
    return np.stack(columns, axis=2)


def least_mass_eigenvalue(model: TorqueModel, parameters: Vector, q: Array) -> float:
    """Return the smallest eigenvalue of the mass matrix over poses."""
    M = mass_matrices(model, parameters, q)
    return float(np.linalg.eigvalsh((M + M.transpose(0, 2, 1)) / 2).min())
