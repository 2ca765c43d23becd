"""Noise of the motion in the regressor: a warning before other causes are blamed."""

from collections.abc import Callable

import numpy as np

from consistent_id.diagnosis.findings import LogFinding
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import is_uniform
from consistent_id.recordings.signals.derivatives import noise_gain
from consistent_id.recordings.signals.smoother import ORDERS, motion_noise
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.column_noise import column_noise
from consistent_id.regression.regressor import TorqueModel

SHARE = 0.01
"""Of a column's power: noise beyond this is worth a warning.

Least squares takes a parameter for smaller by about this share.
"""

_STRETCH = 2000  # samples from which the readings' noise is estimated
_NAMED = 3  # columns that a finding names


def motion_noise_findings(
    model: TorqueModel,
    log: Recording,
    prepare: Callable[[Recording], Recording],
    base: BaseParameters,
    *,
    prepared: Recording | None = None,
) -> list[LogFinding]:
    """Return a warning if noise of the positions is left in the regressor.

    The readings' noise is the smoother's own estimate (`motion_noise`), and no less
    than the encoder's step allows.

    Parameters
    ----------
    log : Recording
        As recorded, with torque; without a uniform clock nothing is said.
    prepare : callable
        Returns it with velocity and acceleration.
    prepared : Recording, optional
        What `prepare` makes of `log`, if that is known.
    """
    log = log.of(model.robot.joint_names)
    if log.acceleration is not None or not is_uniform(log):
        return []
    if len(log) < 8 * ORDERS[-1]:
        return []  # too short for a smoother
    first = max((len(log) - _STRETCH) // 2, 0)
    sigma = motion_noise(log.samples(slice(first, first + _STRETCH))).position
    ready = prepare(log) if prepared is None else prepared
    gain = noise_gain(log, prepare, prepared=ready)
    noise = column_noise(model, ready, gain * (sigma**2)[:, None, None], base)
    largest = noise.noisiest[0][1]
    if largest <= SHARE:
        return []
    named = ", ".join(
        f"{name} {100.0 * share:.2g} %"
        for name, share in noise.noisiest[:_NAMED]
        if share > SHARE
    )
    return [
        LogFinding(
            "motion noise",
            "warning",
            "all joints",
            f"noise of the positions ({np.median(sigma):.2g} rad or m) is part of the "
            f"regressor's columns: {named}; by this least squares errs in the torque "
            f"by some {100.0 * noise.torque_error:.2g} %",
            "lower the cut-off of the motion or smooth it, or use "
            "instrumental_variables with the commanded motion",
            largest / SHARE,
        )
    ]
