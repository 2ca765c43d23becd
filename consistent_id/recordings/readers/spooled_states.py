"""Joint states of a bag that may be larger than memory: decoded once, into a file.

The file has a row of numbers for each sample, so that windows are read from anywhere.
"""

from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.bag import each_message
from consistent_id.recordings.readers.columns import Columns
from consistent_id.recordings.readers.jointstate import (
    LOG_TIME,
    JointMessage,
    joint_state_fields,
    samples_of,
)
from consistent_id.recordings.readers.merging import Merged, seconds
from consistent_id.recordings.readers.named_arrays import gained
from consistent_id.recordings.readers.recording_file import reader_of
from consistent_id.recordings.recording import Recording

_AT_ONCE = 2**14  # messages
_LATE = 10**9  # ns by which messages of one stamp may come after each other
_ROWS = 2**16  # whose times are read at a time


@dataclass(frozen=True)
class SpooledStates:
    """Joint states of a bag, of which windows are read; like `LogRows`.

    Parameters
    ----------
    path : Path
        Of the bag, for messages.
    file : Path
        Rows of time and of each channel's joints, 8 bytes each.
    joints : tuple of str
    channels : tuple of str
        In the order of the columns.
    columns : Columns
    torque_gain : array_like, shape () or (joints,)
    """

    path: Path
    file: Path
    joints: tuple[str, ...]
    channels: tuple[str, ...]
    columns: Columns
    torque_gain: ArrayLike = 1.0

    def times(self) -> Iterator[Vector]:
        """Yield the times of all rows, some at a time [s]."""
        total = self.file.stat().st_size // (8 * self._width)
        for first in range(0, total, _ROWS):
            yield self._rows(first, min(first + _ROWS, total))[:, 0]

    def windows(self, rows: Iterable[tuple[int, int]]) -> Iterator[Recording]:
        """Yield the recording of each range of rows, ``first <= row < last``."""
        units = self.columns.units.items()
        for first, last in rows:
            time, *values = np.split(self._rows(first, last), self._starts, axis=1)
            yield gained(
                self.joints,
                time[:, 0],
                dict(zip(self.channels, values, strict=True)),
                torque_gain=self.torque_gain,
                name=self.path.name,
                without_torque=self.columns.without_torque(self.joints),
                units={channel: unit for channel, unit in units if channel != "time"},
            )

    @property
    def _starts(self) -> range:
        return range(1, self._width, len(self.joints))

    @property
    def _width(self) -> int:
        return 1 + len(self.channels) * len(self.joints)

    def _rows(self, first: int, last: int) -> Matrix:
        width = self._width
        numbers = np.fromfile(
            self.file, "<f8", count=(last - first) * width, offset=8 * first * width
        )
        return numbers.reshape(-1, width)


def spooled_states(
    path: Path,
    joints: Sequence[str],
    columns: Columns,
    file: Path,
    *,
    torque_gain: ArrayLike = 1.0,
    topic: str | None = None,
) -> SpooledStates:
    """Decode the joint states of a bag into a file.

    Parameters
    ----------
    path, joints, columns, torque_gain, topic
        See `read_recording`.
    file : Path
        To write.

    Raises
    ------
    RecordingError
        As `read_recording`.
    """
    where = str(path)
    reader_of(path)  # it is there, and so is what reads it
    fields = joint_state_fields(columns, joints, where)
    in_log, names = columns.in_log(joints), tuple(fields.values())
    messages = each_message(path, topic)
    start = None
    with file.open("wb") as written:
        for stamps, values in _pieces(messages, columns, in_log, names, where):
            start = stamps[0] if start is None else start
            time = (stamps - start) / 1e9
            np.column_stack([time, *values]).astype("<f8").tofile(written)
    if start is None:
        raise RecordingError(f"{where}: no joint state has all joints")
    return SpooledStates(path, file, tuple(joints), tuple(fields), columns, torque_gain)


def _pieces(
    messages: Iterator[JointMessage],
    columns: Columns,
    joints: Sequence[str],
    fields: Sequence[str],
    where: str,
) -> Iterator[Merged]:
    """Yield samples, some at a time; messages of one stamp are not torn apart."""
    by_log_time, last = columns.time == LOG_TIME, None
    held: list[JointMessage] = []
    while new := list(islice(messages, _AT_ONCE)):
        if last is None and not held:
            by_log_time |= not any(message.stamp for message in new)
        held += _on_its_clock(new, columns, by_log_time, where)
        until = max(message.stamp for message in held) - _LATE
        early = [message for message in held if message.stamp <= until]
        held = [message for message in held if message.stamp > until]
        if early:
            last = yield from _samples(early, joints, fields, where, last)
    if held:
        yield from _samples(held, joints, fields, where, last)


def _on_its_clock(
    messages: list[JointMessage], columns: Columns, by_log_time: bool, where: str
) -> list[JointMessage]:
    """Return messages with the time of logging for a stamp, if that is their clock."""
    if not by_log_time:
        return messages
    if columns.time != LOG_TIME and any(message.stamp for message in messages):
        raise RecordingError(
            f"{where}: the first stamps are zero, later ones are not. Repair the log, "
            f"or take time = {LOG_TIME!r}"
        )
    return [message._replace(stamp=message.log_time) for message in messages]


def _samples(
    messages: Sequence[JointMessage],
    joints: Sequence[str],
    fields: Sequence[str],
    where: str,
    last: int | None,
) -> Generator[Merged, None, int | None]:
    """Yield the samples of messages, if any; return the last of all stamps."""
    found = samples_of(messages, joints, fields, where)
    if not len(found.stamps):
        return last
    if last is not None and found.stamps[0] <= last:
        raise RecordingError(
            f"{where}: a stamp goes from {seconds(last)} s back to "
            f"{seconds(int(found.stamps[0]))} s. Cut the log there, or take time = "
            f"{LOG_TIME!r}"
        )
    yield found
    return int(found.stamps[-1])
