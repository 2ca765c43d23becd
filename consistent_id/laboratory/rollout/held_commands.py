"""Commands as drives feel them: held, late, and averaged over each time step."""

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains


def drive_commands(
    log: Recording, gains: PDGains, step: float, steps: int, delay: float = 0.0
) -> Matrix:
    """Return ``kp q_command + kd dq_command + tau_command`` for each time step.

    A command holds from its sample to the next.  A time step in which it changes has
    the mean, so that a motion depends smoothly on the delay.

    Parameters
    ----------
    log : Recording
        With a command of position.
    gains : PDGains
        One each.
    step : float, [s]
    delay : float, [s]

    Returns
    -------
    ndarray, shape (steps, joints), [N m or N]
    """
    command = gains.kp * _known(log.position_command)
    command = command + gains.kd * _known(log.velocity_command)
    command = command + _known(log.torque_command)
    edges = log.time[0] + np.arange(steps + 1) * step - delay
    return np.diff(_integral(log.time, command, edges), axis=0) / step


def _known(values: Matrix | None) -> Matrix:
    return np.zeros((1, 1)) if values is None else values


def _integral(time: Vector, values: Matrix, until: Vector) -> Matrix:
    """Return the integral of held values from the first time on."""
    whole = np.cumsum(values[:-1] * np.diff(time)[:, None], axis=0)
    whole = np.vstack([np.zeros(values.shape[1]), whole])
    place = np.searchsorted(time, until, side="right") - 1
    place = np.clip(place, 0, len(time) - 1)
    return np.asarray(whole[place] + values[place] * (until - time[place])[:, None])
