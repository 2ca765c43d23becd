"""One channel of a log, on a clock of its own."""

from dataclasses import dataclass, replace
from typing import Any, Literal, Self

import numpy as np

from consistent_id._support.arrays import Matrix, Vector, freeze
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording

Channel = Literal["position", "velocity", "acceleration", "torque"]
CHANNELS: tuple[Channel, ...] = ("position", "velocity", "acceleration", "torque")


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """What one sensor wrote of several joints, with its own stamps.

    Parameters
    ----------
    channel : {"position", "velocity", "acceleration", "torque"}
    joints : tuple of str
    time : array_like, shape (samples,), [s]
        Strictly increasing.
    values : array_like, shape (samples, joints)
    name : str
        Where it comes from; used in messages.

    Raises
    ------
    RecordingError
        As a `Recording` would.

    Examples
    --------
    >>> time = np.arange(300) / 300.0
    >>> Track("acceleration", ("elbow",), time, np.cos(time)[:, None]).name
    'track'
    """

    channel: Channel
    joints: tuple[str, ...]
    time: Vector
    values: Matrix
    name: str = "track"

    def __post_init__(self) -> None:
        if self.channel not in CHANNELS:
            raise RecordingError(
                f"{self.name}: channel is {self.channel!r}, expected one of "
                f"{', '.join(CHANNELS)}"
            )
        if self.values is None:
            raise RecordingError(f"{self.name} has no {self.channel}")
        channels: dict[str, Any] = {"position": np.zeros(np.shape(self.values))}
        channels[self.channel] = self.values
        checked = Recording(self.joints, self.time, **channels, name=self.name)
        freeze(
            self,
            joints=checked.joints,
            time=checked.time,
            values=getattr(checked, self.channel),
        )

    def of(self, joints: tuple[str, ...]) -> Self:
        """Return the named joints' values, in the given order."""
        recording = self.recording().of(joints)
        return replace(self, joints=recording.joints, values=recording.position)

    def recording(self) -> Recording:
        """Return a recording that carries the values as its position."""
        return Recording(self.joints, self.time, self.values, name=self.name)


def track(recording: Recording, channel: Channel) -> Track:
    """Return one channel of a recording by itself.

    Raises
    ------
    RecordingError
        If the recording has no such channel.
    """
    values: Matrix = getattr(recording, channel, None)  # type: ignore[assignment]
    return Track(channel, recording.joints, recording.time, values, recording.name)
