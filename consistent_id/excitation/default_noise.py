"""Noise of joints of which only the effort limits are known."""

from dataclasses import replace

import numpy as np

from consistent_id.excitation.aims import Aim
from consistent_id.motion.limits import MotionLimits
from consistent_id.regression.regressor import TorqueModel

_SHARE = 0.005  # of the effort limit; 0.4 to 0.7 % in a UR10e's six joints


def with_default_noise(aim: Aim, model: TorqueModel, limits: MotionLimits) -> Aim:
    """Return the aim with the noise of each joint, where nothing states it.

    Nothing changes if noise is stated, if a condition number is asked for, which weighs
    nothing by itself, if earlier recordings count, or if an effort limit is missing.
    """
    asked = "condition" in aim.objectives or aim.recordings
    if aim.noise is not None or asked:
        return aim
    places = [limits.joints.index(name) for name in model.torque_joints]
    effort = limits.effort[places]
    if not np.isfinite(effort).all():
        return aim
    return replace(aim, noise=_SHARE * effort, assumed_noise=True)
