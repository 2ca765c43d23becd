"""Noise that nobody has stated: of joints by their effort limits, of a sensor."""

from dataclasses import replace

import numpy as np

from consistent_id.excitation.aims import Aim
from consistent_id.motion.limits import MotionLimits
from consistent_id.regression.row_model import RowModel
from consistent_id.regression.rows.sensor_rows import SensorRows

_SHARE = 0.005  # of the effort limit; 0.4 to 0.7 % in a UR10e's six joints
# N and N m: what shakes and hysteresis leave of sensors for arms of 3 to 20 kg.  Their
# ratio, which decides what a motion is good for, is a lever as long as a tool, 0.1 m.
_SENSOR = (0.2,) * 3 + (0.02,) * 3


def with_default_noise(aim: Aim, model: RowModel, limits: MotionLimits) -> Aim:
    """Return the aim with the noise of each row, where nothing states it.

    Nothing changes if noise is stated or if earlier recordings count.  Nor does it for
    joints if a condition number is asked for, which weighs nothing by itself, or if an
    effort limit is missing; the rows of a sensor differ in their units.
    """
    if aim.noise is not None or aim.recordings:
        return aim
    if isinstance(model, SensorRows):
        return replace(aim, noise=np.array(_SENSOR), assumed_noise=True)
    if "condition" in aim.objectives:
        return aim
    places = [limits.joints.index(name) for name in model.torque_joints]
    effort = limits.effort[places]
    if not np.isfinite(effort).all():
        return aim
    return replace(aim, noise=_SHARE * effort, assumed_noise=True)


def assumed_noise(model: RowModel) -> str:
    """Say what `with_default_noise` takes noise to be."""
    if isinstance(model, SensorRows):
        return f"{_SENSOR[0]:g} N and {_SENSOR[-1]:g} N m"
    return f"{100.0 * _SHARE:g} % of each effort limit"
