"""Positions that jump by whole turns, as those of encoders that count from 0 to 360."""

from dataclasses import replace

import numpy as np

from consistent_id.recordings.recording import Recording

TURN = 2.0 * np.pi
"""Size of a jump that is undone [rad]."""


def unwrapped(recording: Recording) -> Recording:
    """Return a recording whose positions do not jump by whole turns.

    To each position the multiple of a turn is added with which it is nearest to the one
    before, starting from the first.  Commands of position get the one that is nearest
    to the position.  Dynamics of revolute joints do not depend on whole turns.

    Parameters
    ----------
    recording : Recording
        As it was read; joints move by less than half a turn between samples.

    Examples
    --------
    >>> log = Recording(("a",), [0.0, 1.0, 2.0], [[3.0], [-3.1], [-2.9]])
    >>> unwrapped(log).position[:, 0].round(3).tolist()
    [3.0, 3.183, 3.383]
    """
    position = np.unwrap(recording.position, axis=0)
    command = recording.position_command
    if command is not None:
        command = command + TURN * np.round((position - command) / TURN)
    return replace(recording, position=position, position_command=command)
