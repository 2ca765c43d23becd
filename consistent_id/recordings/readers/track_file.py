"""One channel from a file of its own, with its own clock."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from numpy.typing import ArrayLike

from consistent_id.recordings.readers.columns import Columns
from consistent_id.recordings.readers.recording_file import read_recording
from consistent_id.recordings.signals.track import Channel, Track, track


def read_track(
    path: str | Path,
    joints: Sequence[str],
    channel: Channel,
    column: str,
    *,
    time: str = "time",
    torque_gain: ArrayLike = 1.0,
) -> Track:
    """Read what one sensor wrote into a file of its own, such as accelerations.

    Bring it to the clock of the rest with `aligned`, its delay with `estimate_delay`.

    Parameters
    ----------
    path : str or Path
        See `read_recording`.
    joints : sequence of str
    channel : {"position", "velocity", "acceleration", "torque"}
    column : str
        Name of the columns, with ``{joint}`` or ``{number}``; in SI units.
    time : str
        Name of the column of stamps.
    torque_gain : array_like, shape () or (joints,)
        Factor to torque, of a torque.

    Raises
    ------
    RecordingError
        As `read_recording`.
    """
    # A recording has a position; here it stands for whatever was written.
    columns = Columns(time, column)
    columns = replace(columns, **{channel: column})  # type: ignore[arg-type]
    recording = read_recording(path, joints, columns, torque_gain=torque_gain)
    return track(recording, channel)
