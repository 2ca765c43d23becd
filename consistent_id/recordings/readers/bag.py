"""Joint states from ROS bags: folders, and bare MCAP, SQLite and ROS 1 files."""

import struct
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.inputs import require_regular
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.jointstate import FIELDS, JointMessage
from consistent_id.recordings.readers.mcap_lint import check_mcap
from consistent_id.robot.parameters import did_you_mean

_TYPE = "sensor_msgs/msg/JointState"
# What the library lets through when a file is cut or overwritten.
_UNREADABLE = (
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
    AssertionError,
    OSError,
    EOFError,
    OverflowError,
    MemoryError,
    RuntimeError,
    struct.error,
    zlib.error,
)
_STORAGE = {
    "sqlite3": "Error",
    "apsw": "Error",
    "zstandard": "ZstdError",
    "backports.zstd": "ZstdError",
    "compression.zstd": "ZstdError",
}


def read_messages(path: Path, topic: str | None) -> list[JointMessage]:
    """Return the joint states of a topic; of the only one if `topic` is None.

    Raises
    ------
    RecordingError
        If the file is no bag, or there is no such topic.
    """
    import rosbags.rosbag1
    import rosbags.rosbag2
    from rosbags.serde import SerdeError
    from rosbags.typesys import Stores, get_typestore

    if path.is_dir() and not (path / "metadata.yaml").is_file():
        raise RecordingError(f"{path}: a folder without metadata.yaml is no bag")
    for file in (path,) if path.is_file() else sorted(path.glob("*.mcap")):
        if file.suffix.lower() == ".mcap":
            require_regular(file, RecordingError)
            check_mcap(file)
    old = path.suffix.lower() == ".bag" and path.is_file()
    types = get_typestore(Stores.ROS1_NOETIC if old else Stores.ROS2_HUMBLE)
    decode = types.deserialize_ros1 if old else types.deserialize_cdr
    library: Any = rosbags.rosbag1 if old else rosbags.rosbag2
    try:
        with library.Reader(path) as bag:
            return _taken(path, bag, topic, decode)
    except (library.ReaderError, SerdeError, *_UNREADABLE, *_of_storage()) as cause:
        raise RecordingError(f"{path}: not readable as ROS bag: {cause}") from None


def _of_storage() -> tuple[type[Exception], ...]:
    """Return the errors of the libraries with which rosbags reads what is stored."""
    return tuple(
        getattr(sys.modules[module], error)
        for module, error in _STORAGE.items()
        if module in sys.modules
    )


def _taken(
    path: Path, bag: Any, topic: str | None, decode: Callable[[bytes, str], Any]
) -> list[JointMessage]:
    chosen = _topic(path, bag, topic)
    connections = [c for c in bag.connections if c.topic == chosen]
    messages = []
    for _, log_time, raw in bag.messages(connections=connections):
        state = decode(raw, _TYPE)
        stamp = state.header.stamp
        messages.append(
            JointMessage(
                log_time,
                stamp.sec * 10**9 + stamp.nanosec,
                state.name,
                {field: np.asarray(getattr(state, field)) for field in FIELDS},
            )
        )
    if not messages:
        raise RecordingError(f"{path}: topic {chosen!r} has no message")
    return messages


def _topic(path: Path, bag: Any, topic: str | None) -> str:
    """Return the topic asked for, or the only one with joint states."""
    kinds: dict[str, str] = {c.topic: c.msgtype for c in bag.connections}
    states = [name for name, kind in kinds.items() if kind == _TYPE]
    if topic is not None:
        if topic not in kinds:
            near = did_you_mean(topic, states or kinds)
            raise RecordingError(f"{path}: no topic {topic!r}; {near}")
        if kinds[topic] != _TYPE:
            raise RecordingError(
                f"{path}: topic {topic!r} is of {kinds[topic]}, expected {_TYPE}"
            )
        return topic
    if len(states) != 1:
        raise RecordingError(
            f"{path}: {len(states)} topics of {_TYPE} ({', '.join(states) or 'none'}), "
            "expected one; say which by topic"
        )
    return states[0]
