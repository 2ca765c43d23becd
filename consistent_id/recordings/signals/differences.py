"""Velocity and acceleration by central differences."""

from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import uniform_rate


def differentiated(recording: Recording) -> Recording:
    """Fill in what is missing of velocity and acceleration by central differences.

    A measured velocity is kept and differentiated once; without it, position is
    differentiated twice, the second time by the three-point second difference.  Filter
    first: differences amplify noise.

    Raises
    ------
    RecordingError
        If the clock is not uniform or there are fewer than four samples.
    """
    step = 1.0 / uniform_rate(recording)
    if len(recording) < 4:
        raise RecordingError(
            f"{recording.name}: {len(recording)} samples, expected 4 or more to "
            "differentiate"
        )
    velocity, acceleration = recording.velocity, recording.acceleration
    if acceleration is None:
        acceleration = (
            _second_difference(recording.position, step)
            if velocity is None
            else np.gradient(velocity, step, axis=0, edge_order=2)
        )
    if velocity is None:
        velocity = np.gradient(recording.position, step, axis=0, edge_order=2)
    return replace(recording, velocity=velocity, acceleration=acceleration)


def _second_difference(position: Matrix, step: float) -> Matrix:
    inner = (position[2:] - 2.0 * position[1:-1] + position[:-2]) / step**2
    first = 2.0 * inner[:1] - inner[1:2]
    last = 2.0 * inner[-1:] - inner[-2:-1]
    return np.vstack([first, inner, last])
