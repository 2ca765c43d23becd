"""Joint states, and fields of other topics, from ROS bags.

A bag that may be larger than memory is decoded
once, into a file with a row of numbers for each sample; any window of it can then be
read (`SpooledStates`).
"""

from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.column_names import DOUBTFUL, doubt
from consistent_id.recordings.column_words import is_of_another
from consistent_id.recordings.readers.bag_file import decoder_of, opened_bag
from consistent_id.recordings.readers.columns import Columns
from consistent_id.recordings.readers.jointstate import (
    CONTROLLER_KIND,
    FIELDS,
    LOG_TIME,
    STATE_KIND,
    STATE_KINDS,
    BagContent,
    JointMessage,
    joint_message,
    joint_state_fields,
    joint_states,
    message_conversion,
    samples_of,
)
from consistent_id.recordings.readers.recording_file import reader_of
from consistent_id.recordings.readers.topics import (
    Merged,
    TopicField,
    seconds,
    signals_of,
    topic_field,
)
from consistent_id.recordings.recording import Recording
from consistent_id.robot.parameters import did_you_mean

_AT_ONCE = 2**14  # messages
# Messages that are read to know the joints of topics: in all, and of each.
_LOOKED_AT, _OF_A_TOPIC = 20_000, 50
_LATE = 10**9  # ns between messages of one stamp, at most
_ROWS = 2**16  # rows whose times are read at a time


class StateTopic(NamedTuple):
    """A topic of joint states, by its first messages.

    Parameters
    ----------
    joints : tuple of str
        Names in these messages, in their order.
    fields : tuple of str
        Fields that have a value of every name, and a finite one of the robot's joints.
    others : tuple of str
        The bag's other topics of joint states.
    with_effort : tuple of str
        Topics of the same joints that have the effort, if this one has none.
    """

    name: str
    joints: tuple[str, ...]
    fields: tuple[str, ...] = FIELDS
    others: tuple[str, ...] = ()
    with_effort: tuple[str, ...] = ()


def read_messages(
    path: Path,
    topic: str | None,
    beside: Sequence[str] = (),
    joints: Sequence[str] = (),
) -> BagContent:
    """Return the joint states of a topic; by default of `chosen_topic`.

    Parameters
    ----------
    beside : sequence of str
        Other fields to read, as ``TOPIC.FIELD``.
    joints : sequence of str
        The log's names of the robot's joints.

    Raises
    ------
    RecordingError
        If the file is not a bag, or there is no such topic.
    """
    wanted = [topic_field(name, str(path)) for name in beside]
    with opened_bag(path) as bag:
        return _content(path, bag, _topic(path, bag, topic, joints), wanted)


def chosen_topic(path: Path, topic: str | None, joints: Sequence[str]) -> StateTopic:
    """Return a topic of joint states; by default the one that names most of the joints.

    Parameters
    ----------
    joints : sequence of str
        The log's names of the robot's joints.

    Raises
    ------
    RecordingError
        If the file is not a bag, has no such topic, or several name as many joints.
    """
    with opened_bag(path) as bag:
        chosen = _topic(path, bag, topic, joints)
        states = {c.topic for c in bag.connections if c.msgtype == STATE_KIND}
        (found,) = _named(path, bag, [chosen], joints)
        found = found._replace(others=tuple(sorted(states - {chosen})))
        if "effort" in found.fields:
            return found
        every = {c.topic for c in bag.connections if c.msgtype in STATE_KINDS} - {
            chosen
        }
        named = _named(path, bag, sorted(every), joints) if every else []
        mine = {*found.joints} & {*joints}
        alike = [t for t in named if "effort" in t.fields and mine <= {*t.joints}]
        return found._replace(with_effort=tuple(topic.name for topic in alike))


def _each_message(
    path: Path, topic: str | None, joints: Sequence[str]
) -> Iterator[JointMessage]:
    """Yield the joint states of a topic in the order of the log, one at a time.

    Parameters and errors are those of `read_messages`.
    """
    with opened_bag(path) as bag:
        chosen = _topic(path, bag, topic, joints)
        connections = [c for c in bag.connections if c.topic == chosen]
        decode = decoder_of(path, connections)
        for connection, log_time, raw in bag.messages(connections=connections):
            yield joint_message(log_time, decode(raw, connection.msgtype))


def topic_kinds(path: Path) -> dict[str, str]:
    """Return the kind of each topic's messages, such as ``sensor_msgs/msg/Imu``.

    Raises
    ------
    RecordingError
        If the file is not a bag.
    """
    with opened_bag(path) as bag:
        return {c.topic: c.msgtype for c in bag.connections}


@dataclass(frozen=True)
class SpooledStates:
    """Joint states of a bag, read in windows, like `LogRows`.

    Parameters
    ----------
    path : Path
        Path of the bag, for messages.
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
        """Yield the times of all rows, in pieces [s]."""
        total = self.file.stat().st_size // (8 * self._width)
        for first in range(0, total, _ROWS):
            yield self._rows(first, min(first + _ROWS, total))[:, 0]

    def windows(self, rows: Iterable[tuple[int, int]]) -> Iterator[Recording]:
        """Yield the recording of each range of rows, ``first <= row < last``."""
        in_si = message_conversion(self.columns, self.joints, self.torque_gain)
        for first, last in rows:
            time, *values = np.split(self._rows(first, last), self._starts, axis=1)
            channels = dict(zip(self.channels, values, strict=True))
            yield in_si.recording(self.joints, time[:, 0], channels, self.path.name)

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
    topic: str | None = None,
) -> SpooledStates:
    """Decode the joint states of a bag into a file.

    Parameters
    ----------
    path, joints, columns, topic
        See `read_recording`.
    file : Path
        To write.

    Raises
    ------
    RecordingError
        As `read_recording`.
    """
    where = str(path)
    reader_of(path)  # file and library exist
    fields = joint_state_fields(columns, joints, where)
    in_log, names = columns.in_log(joints), tuple(fields.values())
    messages = _each_message(path, topic, in_log)
    start = None
    with file.open("wb") as written:
        for stamps, values in _pieces(messages, columns, in_log, names, where):
            start = stamps[0] if start is None else start
            time = (stamps - start) / 1e9
            np.column_stack([time, *values]).astype("<f8").tofile(written)
    if start is None:
        raise RecordingError(f"{where}: no joint state has all joints")
    return SpooledStates(path, file, tuple(joints), tuple(fields), columns)


def _content(
    path: Path, bag: Any, chosen: str, wanted: Sequence[TopicField]
) -> BagContent:
    known = {c.topic for c in bag.connections}
    for name in wanted:
        if name.topic not in known:
            near = did_you_mean(name.topic, known)
            raise RecordingError(f"{path}: no topic {name.topic!r}; {near}")
    topics = {chosen, *(name.topic for name in wanted)}
    connections = [c for c in bag.connections if c.topic in topics]
    decode = decoder_of(path, connections)
    logged: dict[str, list[tuple[int, Any]]] = {name: [] for name in topics}
    for connection, log_time, raw in bag.messages(connections=connections):
        message = decode(raw, connection.msgtype)
        logged[connection.topic].append((log_time, message))
    if not logged[chosen]:
        raise RecordingError(f"{path}: topic {chosen!r} has no message")
    states = [joint_message(log_time, message) for log_time, message in logged[chosen]]
    return BagContent(states, signals_of(wanted, logged, str(path)))


def _topic(path: Path, bag: Any, topic: str | None, joints: Sequence[str]) -> str:
    """Return the requested topic, or the one that names most joints."""
    kinds: dict[str, str] = {c.topic: c.msgtype for c in bag.connections}
    states = [name for name, kind in kinds.items() if kind == STATE_KIND]
    of_controllers = [n for n, kind in kinds.items() if kind == CONTROLLER_KIND]
    if topic is not None:
        if topic not in kinds:
            near = did_you_mean(topic, states or kinds)
            raise RecordingError(f"{path}: no topic {topic!r}; {near}")
        if kinds[topic] not in STATE_KINDS:
            raise RecordingError(
                f"{path}: topic {topic!r} is of {kinds[topic]}, expected {STATE_KIND}"
            )
        return topic
    if of_controllers:  # only for joints that no joint state names
        every = _named(path, bag, [*states, *of_controllers], joints)
        shared = [len(set(joints) & set(one.joints)) for one in every]
        if max(shared[len(states) :]) > max(shared[: len(states)], default=0):
            states = of_controllers
    if not states:
        seen = ", ".join(f"{name} ({kind})" for name, kind in kinds.items())
        raise RecordingError(
            f"{path}: no topic of {STATE_KIND}; the bag has {seen or 'no topic at all'}"
        )
    if len(states) == 1:
        return states[0]
    found = _named(path, bag, states, joints)
    counts = [len(set(joints) & set(one.joints)) for one in found]
    most = max(counts)
    likely = [t for t, count in zip(found, counts, strict=True) if count == most]
    with_effort = [
        t for t in likely if "effort" in t.fields and not _is_of_another(t.name)
    ]
    if most == 0 or (len(likely) > 1 and len(with_effort) != 1):
        listed = "; ".join(f"{t.name}: {', '.join(t.joints) or 'none'}" for t in found)
        first, *_ = with_effort or likely
        option = f"--topic {first.name}"
        raise RecordingError(
            f"{path}: {len(states)} topics of {STATE_KIND} name joints ({listed}), "
            f"{len(likely)} of them {most} of {', '.join(joints)}; name one: "
            f"{option} (topic)",
            options=option,
        )
    return likely[0].name if len(likely) == 1 else with_effort[0].name


def _is_of_another(topic: str) -> bool:
    """Return whether the name of a topic says a command, a simulation or the like.

    Examples
    --------
    >>> _is_of_another("/sim/joint_states"), _is_of_another("/arm/joint_states")
    (True, False)
    """
    return is_of_another(topic) or doubt("torque", topic) >= DOUBTFUL


def _named(
    path: Path, bag: Any, topics: Sequence[str], joints: Sequence[str]
) -> list[StateTopic]:
    """Return topics with the names in their first messages."""
    connections = [c for c in bag.connections if c.topic in topics]
    decode = decoder_of(path, connections)
    names: dict[str, dict[str, None]] = {topic: {} for topic in topics}
    fields = {topic: set(FIELDS) for topic in topics}
    seen = dict.fromkeys(topics, 0)
    messages = bag.messages(connections=connections)
    for connection, _, raw in islice(messages, _LOOKED_AT):
        if seen[connection.topic] < _OF_A_TOPIC:
            message = joint_states(decode(raw, connection.msgtype))
            names[connection.topic] |= dict.fromkeys(message.name)
            if not set(joints).isdisjoint(message.name):  # not a gripper's message
                recorded = {f for f in FIELDS if _is_recorded(message, f, joints)}
                fields[connection.topic] &= recorded
        seen[connection.topic] += 1
        if min(seen.values()) >= _OF_A_TOPIC:
            break
    return [
        StateTopic(topic, tuple(found), tuple(f for f in FIELDS if f in fields[topic]))
        for topic, found in names.items()
    ]


def _is_recorded(message: Any, field: str, joints: Sequence[str]) -> bool:
    """Return whether a field has a value of every name, finite of the joints."""
    values = np.asarray(getattr(message, field))
    if len(values) != len(message.name):
        return False
    return bool(np.isfinite(values[[name in joints for name in message.name]]).all())


def _pieces(
    messages: Iterator[JointMessage],
    columns: Columns,
    joints: Sequence[str],
    fields: Sequence[str],
    where: str,
) -> Iterator[Merged]:
    """Yield samples in pieces; messages of one stamp are kept together."""
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
    """Return messages with the time of logging as stamp, if that is their clock."""
    if not by_log_time:
        return messages
    if columns.time != LOG_TIME and any(message.stamp for message in messages):
        raise RecordingError(
            f"{where}: the first stamps are zero, later ones are not. Repair the "
            f"log, or use time = {LOG_TIME!r}"
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
            f"{seconds(int(found.stamps[0]))} s. Cut the log there, or use time = "
            f"{LOG_TIME!r}"
        )
    yield found
    return int(found.stamps[-1])
