"""Recordings that a robot of known parameters would have written."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import frozen
from consistent_id.errors import ProblemError
from consistent_id.recordings.recording import Recording, states
from consistent_id.regression.regressor import TorqueModel


def simulate_torque(
    model: TorqueModel,
    parameters: ArrayLike,
    motion: Recording,
    *,
    noise: ArrayLike = 0.0,
    rng: np.random.Generator | None = None,
) -> Recording:
    """Return a motion with the torques of known parameters, and white noise on them.

    All joints get their torque, also those whose torque the model does without.

    Parameters
    ----------
    model : TorqueModel
    parameters : array_like, shape (parameters,)
    motion : Recording
        With velocity and acceleration.
    noise : array_like, shape () or (joints,), [N m or N]
        Standard deviation.
    rng : numpy.random.Generator, optional
        Needed for noise.
    """
    motion = motion.of(model.robot.joint_names)
    torque = replace(model, torque_joints=()).predict(parameters, *states(motion))
    shape = torque.shape[1:] if np.ndim(noise) else ()
    sigma = frozen(noise, shape, "noise")
    if sigma.any():
        if rng is None:
            raise ProblemError("noise needs a random generator; pass rng=")
        torque = torque + rng.normal(size=torque.shape) * sigma
    return replace(motion, torque=torque, name=f"{motion.name} (simulated)")
