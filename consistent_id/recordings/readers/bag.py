"""Joint states, and fields of other topics, from ROS bags.

Bags are folders, and bare MCAP, SQLite and ROS 1 files.
"""

import struct
import sys
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.inputs import require_regular
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.jointstate import FIELDS, JointMessage
from consistent_id.recordings.readers.mcap_lint import check_mcap
from consistent_id.recordings.readers.topic_fields import (
    TopicField,
    TopicSignal,
    signals_of,
    topic_field,
)
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


class BagContent(NamedTuple):
    """What was read of a bag: joint states, and fields of other topics by name."""

    states: list[JointMessage]
    signals: dict[str, TopicSignal]


def read_messages(
    path: Path, topic: str | None, beside: Sequence[str] = ()
) -> BagContent:
    """Return the joint states of a topic; of the only one if `topic` is None.

    Parameters
    ----------
    beside : sequence of str
        What else is wanted, as ``TOPIC.FIELD``.

    Raises
    ------
    RecordingError
        If the file is no bag, or there is no such topic.
    """
    wanted = [topic_field(name, str(path)) for name in beside]
    with _opened(path) as bag:
        return _content(path, bag, topic, wanted)


def each_message(path: Path, topic: str | None) -> Iterator[JointMessage]:
    """Yield the joint states of a topic in the order of the log, one at a time.

    Parameters and errors are those of `read_messages`.
    """
    with _opened(path) as bag:
        chosen = _topic(path, bag, topic)
        connections = [c for c in bag.connections if c.topic == chosen]
        decode = _decoder(path, connections)
        for connection, log_time, raw in bag.messages(connections=connections):
            yield _state(log_time, decode(raw, connection.msgtype))


def topic_kinds(path: Path) -> dict[str, str]:
    """Return the kind of each topic's messages, such as ``sensor_msgs/msg/Imu``.

    Raises
    ------
    RecordingError
        If the file is no bag.
    """
    with _opened(path) as bag:
        return {c.topic: c.msgtype for c in bag.connections}


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Yield a bag to read, whatever the library says of a faulty one."""
    import rosbags.rosbag1
    import rosbags.rosbag2
    from rosbags.serde import SerdeError
    from rosbags.typesys.base import TypesysError

    if path.is_dir() and not (path / "metadata.yaml").is_file():
        raise RecordingError(f"{path}: a folder without metadata.yaml is no bag")
    for file in (path,) if path.is_file() else sorted(path.glob("*.mcap")):
        if file.suffix.lower() == ".mcap":
            require_regular(file, RecordingError)
            check_mcap(file)
    library: Any = rosbags.rosbag1 if _is_old(path) else rosbags.rosbag2
    of_library = (library.ReaderError, SerdeError, TypesysError)
    try:
        with library.Reader(path) as bag:
            yield bag
    except (*of_library, *_UNREADABLE, *_of_storage()) as cause:
        raise RecordingError(f"{path}: not readable as ROS bag: {cause}") from None


def _is_old(path: Path) -> bool:
    """Return whether a bag is of ROS 1."""
    return path.suffix.lower() == ".bag" and path.is_file()


def _of_storage() -> tuple[type[Exception], ...]:
    """Return the errors of the libraries with which rosbags reads what is stored."""
    return tuple(
        getattr(sys.modules[module], error)
        for module, error in _STORAGE.items()
        if module in sys.modules
    )


def _content(
    path: Path, bag: Any, topic: str | None, wanted: Sequence[TopicField]
) -> BagContent:
    chosen = _topic(path, bag, topic)
    known = {c.topic for c in bag.connections}
    for name in wanted:
        if name.topic not in known:
            near = did_you_mean(name.topic, known)
            raise RecordingError(f"{path}: no topic {name.topic!r}; {near}")
    topics = {chosen, *(name.topic for name in wanted)}
    connections = [c for c in bag.connections if c.topic in topics]
    decode = _decoder(path, connections)
    logged: dict[str, list[tuple[int, Any]]] = {name: [] for name in topics}
    for connection, log_time, raw in bag.messages(connections=connections):
        message = decode(raw, connection.msgtype)
        logged[connection.topic].append((log_time, message))
    if not logged[chosen]:
        raise RecordingError(f"{path}: topic {chosen!r} has no message")
    states = [_state(log_time, message) for log_time, message in logged[chosen]]
    return BagContent(states, signals_of(wanted, logged, str(path)))


def _decoder(path: Path, connections: Sequence[Any]) -> Callable[[bytes, str], Any]:
    """Return what decodes messages; kinds that ROS does not have, the bag defines."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    old = _is_old(path)
    types = get_typestore(Stores.ROS1_NOETIC if old else Stores.ROS2_HUMBLE)
    for connection in connections:
        if connection.msgtype in types.types:
            continue
        stated = connection.msgdef
        if stated.format != MessageDefinitionFormat.MSG:
            raise RecordingError(
                f"{path}: topic {connection.topic!r} is of {connection.msgtype}, which "
                "neither ROS nor the bag defines; record it as a standard kind, such "
                "as geometry_msgs/WrenchStamped"
            )
        defined = get_types_from_msg(stated.data, connection.msgtype)
        new = {kind: d for kind, d in defined.items() if kind not in types.types}
        types.register(new)
    decode: Callable[[bytes, str], Any] = (
        types.deserialize_ros1 if old else types.deserialize_cdr
    )
    return decode


def _state(log_time: int, state: Any) -> JointMessage:
    stamp = state.header.stamp
    return JointMessage(
        log_time,
        stamp.sec * 10**9 + stamp.nanosec,
        state.name,
        {field: np.asarray(getattr(state, field)) for field in FIELDS},
    )


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
