"""How joints follow their commands, frequency by frequency."""

from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.recordings.recording import Recording

_SEGMENTS = 8  # of a log, each half over the next (Welch)
_POWER = 0.01  # of the command's largest, below which a frequency was not commanded


class FrequencyResponse(NamedTuple):
    """Position over its command.

    Parameters
    ----------
    frequency : ndarray, shape (frequencies,), [Hz]
    response : ndarray of complex, shape (frequencies, joints)
        NaN where the command has too little power.
    """

    frequency: Vector
    response: Array


def frequency_response(log: Recording, position: Array) -> FrequencyResponse:
    """Return the response of a motion to the commands of a log (Welch's method).

    Parameters
    ----------
    log : Recording
        With commands of position, on a uniform clock.
    position : ndarray, shape (samples, joints)
        What followed them: the robot, or a model.
    """
    from scipy.signal import csd, welch

    length = max(2 * len(log) // (_SEGMENTS + 1), 16)
    command = log.position_command
    options = {"fs": log.rate, "nperseg": min(length, len(log)), "axis": 0}
    frequency, power = welch(command, **options)
    cross = csd(command, position, **options)[1]
    power[0] = 0.0  # the mean is no motion
    excited = power >= _POWER * power.max(axis=0)
    response = np.full(cross.shape, np.nan + 0j)
    np.divide(cross, power, out=response, where=excited)
    return FrequencyResponse(frequency, response)
