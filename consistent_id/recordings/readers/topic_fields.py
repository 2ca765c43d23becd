"""Numbers of ROS messages by name: ``/imu/data.angular_velocity`` is three columns.

A name is a topic, a dot, and a field of its messages, or a field of a field.  Whatever
numbers stand there are columns, in the order of the message: x, y, z of a vector, x, y,
z, w of a quaternion, force and torque of a wrench.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from consistent_id._support.arrays import Matrix
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.array_parts import stored_name
from consistent_id.robot.parameters import did_you_mean


class TopicField(NamedTuple):
    """A field of a topic's messages.

    Parameters
    ----------
    topic, field : str
        The field with dots between a field and its own.
    """

    topic: str
    field: str

    def __str__(self) -> str:
        return f"{self.topic}.{self.field}"


class TopicSignal(NamedTuple):
    """What the messages of a topic say over time.

    Parameters
    ----------
    log_times : ndarray of int, shape (messages,), [ns]
        When each was logged.
    stamps : ndarray of int, shape (messages,), [ns], optional
        Of the header, if the messages have one.
    values : ndarray, shape (messages, columns)
    kind : {"numbers", "flag", "quaternion"}
        A flag holds until the next; q and -q are the same turn.
    """

    log_times: NDArray[np.int64]
    stamps: NDArray[np.int64] | None
    values: Matrix
    kind: str


def topic_field(name: str, where: str) -> TopicField:
    """Return what a name of columns means; a part ``[first:end]`` aside.

    Raises
    ------
    RecordingError
        If it has no field.
    """
    topic, dot, field = stored_name(name).partition(".")
    if not dot or not topic or not field:
        raise RecordingError(
            f"{where}: {name!r} names no field of a topic's messages; expected such as "
            "'/imu/data.angular_velocity', '/odom.pose.pose.orientation' or "
            "'/left_sole.wrench'"
        )
    return TopicField(topic, field)


def signals_of(
    wanted: Sequence[TopicField],
    messages: Mapping[str, Sequence[tuple[int, Any]]],
    where: str,
) -> dict[str, TopicSignal]:
    """Return the wanted fields, by their names.

    Parameters
    ----------
    messages : mapping of str to sequence of (int, message)
        By topic, with the time of logging [ns].

    Raises
    ------
    RecordingError
        If a topic is empty, has no such field, or it holds no numbers.
    """
    found = {}
    for name in wanted:
        logged = messages.get(name.topic, ())
        if not logged:
            raise RecordingError(f"{where}: topic {name.topic!r} has no message")
        found[str(name)] = _signal(name, logged, where)
    return found


def _signal(
    name: TopicField, logged: Sequence[tuple[int, Any]], where: str
) -> TopicSignal:
    first = _field_of(logged[0][1], name, where)
    leaves = list(_leaves(first, name, where))
    read = _reader(name.field, leaves)
    rows = [np.hstack(read(message)) for _, message in logged]
    if len({len(row) for row in rows}) > 1:
        raise RecordingError(
            f"{where}: {name} has {len(rows[0])} numbers in one message and another "
            "number of them in others"
        )
    stamps = None
    if hasattr(logged[0][1], "header"):
        times = (message.header.stamp for _, message in logged)
        stamps = np.array([t.sec * 10**9 + t.nanosec for t in times], dtype=np.int64)
    values = np.array(rows)
    kind = "flag" if values.dtype == np.bool_ else "numbers"
    if str(getattr(first, "__msgtype__", "")).endswith("/Quaternion"):
        kind = "quaternion"
    log_times = np.array([at for at, _ in logged], dtype=np.int64)
    return TopicSignal(log_times, stamps, values.astype(np.float64), kind)


def _field_of(message: Any, name: TopicField, where: str) -> Any:
    value, path = message, name.topic
    for part in name.field.split("."):
        known = _names(value)
        if part not in known:
            near = did_you_mean(part, known) if known else "it has no fields"
            raise RecordingError(f"{where}: {path} has no field {part!r}; {near}")
        value, path = getattr(value, part), f"{path}.{part}"
    return value


def _leaves(value: Any, name: TopicField, where: str) -> Iterator[str]:
    """Yield the paths from a field to its numbers; the empty one to itself."""
    if is_dataclass(value):
        for own in _names(value):
            for rest in _leaves(getattr(value, own), name, where):
                yield f"{own}.{rest}".rstrip(".")
    elif isinstance(value, bool | int | float | np.number | np.bool_):
        yield ""
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        yield ""
    else:
        raise RecordingError(
            f"{where}: {name} holds {type(value).__name__}, expected numbers; name "
            "one of its fields, such as '/odom.pose.pose.position'"
        )


def _names(message: Any) -> list[str]:
    """Return the names of a message's fields; a number has none."""
    every = fields(message) if is_dataclass(message) else ()
    return [field.name for field in every if not field.name.startswith("__")]


def _reader(field: str, leaves: Sequence[str]) -> Callable[[Any], Any]:
    paths = [f"{field}.{leaf}".rstrip(".") for leaf in leaves]
    read = attrgetter(*paths)
    return read if len(paths) > 1 else lambda message: (read(message),)
