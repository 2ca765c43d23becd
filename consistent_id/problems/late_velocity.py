"""Velocities that come later than the positions of the same log.

Drives and drivers filter the velocity that they log, some by much: then friction and
acceleration belong to another instant than gravity.  The derivative of the position,
filtered without phase, has no such lag.
"""

from collections.abc import Iterable
from dataclasses import replace

from consistent_id.errors import RecordingError
from consistent_id.problems.robot_logs import RobotLogs
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import Delay, Track, estimate_delay
from consistent_id.recordings.signals.clocks import own_rate

_SURE = 5.0  # standard errors of the delay
_SAMPLES = 1.0  # sampling periods; less is within what the stamps say


def on_time(logs: RobotLogs, training: Iterable[Recording]) -> RobotLogs:
    """Return how logs are read, without a velocity that comes late.

    Parameters
    ----------
    training : iterable of Recording
        As they were read; one late velocity suffices.
    """
    for raw in training:
        delay = velocity_delay(raw)
        if delay is not None:
            note = (
                f"the velocity of {raw.name} comes {1e3 * delay.seconds:.3g} ms after "
                "the position: it is not read, and positions are differentiated; "
                "name the column (--velocity) to read it all the same"
            )
            columns = replace(logs.columns, velocity=None)
            return replace(logs, columns=columns, notes=(*logs.notes, note))
    return logs


def velocity_delay(recording: Recording) -> Delay | None:
    """Return by how much the velocity comes late; None if it does not, or has none."""
    if recording.velocity is None:
        return None
    joints, time, name = recording.joints, recording.time, recording.name
    position = Track("position", joints, time, recording.position, name)
    velocity = Track("velocity", joints, time, recording.velocity, name)
    try:
        delay = estimate_delay(position, velocity)
    except RecordingError:
        return None  # not of one motion: the diagnosis says what it is instead
    period = _SAMPLES / own_rate(recording)
    late = delay.seconds > max(period, _SURE * delay.standard_error)
    return delay if late else None
