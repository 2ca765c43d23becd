"""A recording from messages of joint states, in any order of joints.

States of trajectory controllers, ``control_msgs/JointTrajectoryControllerState``, are
read, too: they name their joints, and have a point each for the reference, the measured
state, the error and the output.  The measured one is the joints' state.
"""

import logging
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from consistent_id._support.arrays import Matrix
from consistent_id.errors import RecordingError
from consistent_id.recordings.own_names import mapping_advice, mapping_option
from consistent_id.recordings.readers.columns import CHANNELS, Columns, at_least_one
from consistent_id.recordings.readers.named_arrays import Conversion, LogName
from consistent_id.recordings.readers.topics import (
    JointClock,
    Layout,
    Merged,
    TopicSignal,
    merged,
    seconds,
    with_topics,
)
from consistent_id.recordings.recording import Recording

FIELDS = ("position", "velocity", "effort")
STATE_KIND = "sensor_msgs/msg/JointState"
CONTROLLER_KIND = "control_msgs/msg/JointTrajectoryControllerState"
STATE_KINDS = (STATE_KIND, CONTROLLER_KIND)
"""Kinds of messages with states of named joints, the usual one first."""

STAMP, LOG_TIME = "header.stamp", "log_time"
_MEASURED = ("feedback", "actual")  # the latter before ROS 2 Humble
_EPOCH = 10**18  # ns, September 2001: clocks that show the date are later

_log = logging.getLogger(__name__)


class JointMessage(NamedTuple):
    """One ``sensor_msgs/JointState`` and the time at which it was logged [ns]."""

    log_time: int
    stamp: int
    names: Sequence[str]
    fields: Mapping[str, NDArray[np.float64]]


class NamedStates(NamedTuple):
    """States of joints as in ``sensor_msgs/JointState``; arrays may be empty."""

    header: Any
    name: Any
    position: Any
    velocity: Any
    effort: Any


def joint_states(message: Any) -> Any:
    """Return a message as joint states; those of that kind as they are."""
    if not hasattr(message, "joint_names"):
        return message
    point = next(getattr(message, field) for field in _measured_fields(message))
    return NamedStates(
        message.header,
        message.joint_names,
        point.positions,
        point.velocities,
        point.effort,
    )


def _measured_fields(message: Any) -> list[str]:
    """Return the measured fields that a message has; newer ones have both."""
    known = [field for field in _MEASURED if hasattr(message, field)]
    filled = [field for field in known if len(getattr(message, field).positions)]
    return filled or known


def joint_message(log_time: int, message: Any) -> JointMessage:
    """Return a decoded message, of one of `STATE_KINDS`, with its time of logging."""
    state = joint_states(message)
    stamp = state.header.stamp
    return JointMessage(
        log_time,
        stamp.sec * 10**9 + stamp.nanosec,
        state.name,
        {field: np.asarray(getattr(state, field)) for field in FIELDS},
    )


def joint_state_fields(
    columns: Columns, joints: Sequence[str], where: str
) -> dict[str, str]:
    """Return the message's field of each wanted channel.

    Raises
    ------
    RecordingError
        If there is no joint, or the columns name a field that joint states do not have.
    """
    at_least_one(joints, where)
    fields = {
        channel: name
        for channel in CHANNELS
        if (name := getattr(columns, channel)) is not None
    }
    strange = [name for name in fields.values() if name not in FIELDS]
    if columns.time not in (STAMP, LOG_TIME):
        strange.append(columns.time)
    if strange or columns.array_joints:
        raise RecordingError(
            f"{where}: {strange[0] if strange else 'array_joints'!r} in columns is "
            f"not a field of a JointState; its fields are {', '.join(FIELDS)}, its "
            f"clock is {STAMP} or {LOG_TIME}. Leave columns out, or start from "
            f"JOINT_STATE"
        )
    return fields


class BagContent(NamedTuple):
    """Content of a bag: joint states, and fields of other topics by name."""

    states: list[JointMessage]
    signals: dict[str, TopicSignal]


def recording_of_messages(
    content: BagContent,
    joints: Sequence[str],
    columns: Columns,
    log: LogName,
    torque_gain: ArrayLike,
) -> Recording:
    """Return the recording of messages, matched by the names of joints.

    Measurements beside the joints come from the signals of other topics. Messages of
    one stamp are merged; those without a required joint are ignored. Time counts from
    the first sample [s], because dates in nanoseconds do not fit a float.

    Raises
    ------
    RecordingError
        If a joint is missing, a value of it is missing or not finite, its clock runs
        backwards, or the joints hardly ever share a stamp.
    """
    (name, where), messages = log, content.states
    fields = joint_state_fields(columns, joints, where)
    stamps_are_zero = bool(messages) and not any(m.stamp for m in messages)
    if columns.time == STAMP and stamps_are_zero:
        _log.warning("%s: all stamps are zero, the time of logging is used", where)
        name = f"{name} (by time of logging)"
    by_log_time = columns.time == LOG_TIME or stamps_are_zero
    if by_log_time:
        messages = [message._replace(stamp=message.log_time) for message in messages]
    in_log = columns.in_log(joints)
    stamps, values = samples_of(messages, in_log, tuple(fields.values()), where)
    time = (stamps - stamps[0]) / 1e9
    channels = dict(zip(fields, values, strict=True))
    recording = message_conversion(columns, joints, torque_gain).recording(
        tuple(joints), time, channels, name
    )
    if not columns.beside:
        return recording
    clock = JointClock(int(stamps[0]), by_log_time)
    return with_topics(recording, clock, content.signals, columns.beside, where)


def message_conversion(
    columns: Columns, joints: Sequence[str], torque_gain: ArrayLike
) -> Conversion:
    """Return the conversion of messages, whose times are in seconds already."""
    units = {channel: u for channel, u in columns.units.items() if channel != "time"}
    return Conversion(units, torque_gain, columns.without_torque(joints))


def samples_of(
    messages: Sequence[JointMessage],
    joints: Sequence[str],
    fields: Sequence[str],
    where: str,
) -> Merged:
    """Return the samples of messages, with the fields of the joints.

    Raises
    ------
    RecordingError
        See `recording_of_messages`.
    """
    layouts = _layouts(messages, joints, fields, where)
    _check_clocks(layouts, joints, where)
    return merged(layouts, joints, where)


def _layouts(
    messages: Sequence[JointMessage],
    joints: Sequence[str],
    fields: Sequence[str],
    where: str,
) -> list[Layout]:
    """Return the messages by their order of names, without those of other joints."""
    members = defaultdict(list)
    for place, message in enumerate(messages):
        members[tuple(message.names)].append(place)
    _check_names(joints, list(members), where)
    layouts = []
    for names, places in members.items():
        here = [k for k, joint in enumerate(joints) if joint in names]
        if not here:
            continue
        columns = [names.index(joints[k]) for k in here]
        group = [messages[place] for place in places]
        values = [_values(group, field, names, columns, where) for field in fields]
        stamps = np.array([message.stamp for message in group])
        layouts.append(
            Layout(np.array(places), stamps, np.array(here), np.array(values))
        )
    return layouts


def _values(
    group: Sequence[JointMessage],
    field: str,
    names: Sequence[str],
    columns: Sequence[int],
    where: str,
) -> Matrix:
    """Return a field of messages of one layout, shape (messages, columns)."""
    for message in group:
        if len(message.fields[field]) != len(names):
            raise RecordingError(
                f"{where}: no {field} of joint {names[columns[0]]!r} at "
                f"{seconds(message.stamp)} s ({len(message.fields[field])} values, "
                f"{len(names)} names). Leave {field} out of columns if it was not "
                "recorded"
            )
    values = np.array([message.fields[field] for message in group])[:, columns]
    if not np.isfinite(values).all():
        row, column = np.argwhere(~np.isfinite(values))[0]
        raise RecordingError(
            f"{where}: {field} of joint {names[columns[column]]!r} is "
            f"{values[row, column]} at {seconds(group[row].stamp)} s. Leave {field} "
            "out of columns if it was not recorded; else repair the log"
        )
    return values


def _check_names(
    joints: Sequence[str], layouts: Sequence[Sequence[str]], where: str
) -> None:
    seen = list(dict.fromkeys(name for names in layouts for name in names))
    if not set(joints) & set(seen):
        raise RecordingError(
            f"{where}: no message names a joint of {', '.join(joints)}."
            f"{mapping_advice(seen, joints)} (names of [data.columns])",
            options=mapping_option(seen, joints),
        )
    for joint in joints:
        if joint not in seen:
            others = [name for name in seen if name not in joints]
            raise RecordingError(
                f"{where}: no message names joint {joint!r}; other names in the log: "
                f"{', '.join(others) or 'none'}. If one of these is meant: --names "
                f"NAME={joint} ... (names of [data.columns]); joints that the log "
                f"lacks: --lock {joint} ..."
            )
        if any(list(names).count(joint) > 1 for names in layouts):
            raise RecordingError(f"{where}: a message names joint {joint!r} twice")


def _check_clocks(layouts: Sequence[Layout], joints: Sequence[str], where: str) -> None:
    """Refuse a joint whose stamps go back, or are first zero and then a date."""
    for k, joint in enumerate(joints):
        mine = [layout for layout in layouts if k in layout.joints]
        order = np.argsort(np.concatenate([layout.order for layout in mine]))
        stamps = np.concatenate([layout.stamps for layout in mine])[order]
        if (np.diff(stamps) < 0).any():
            bad = int(np.argmax(np.diff(stamps) < 0))
            raise RecordingError(
                f"{where}: the stamp of joint {joint!r} goes from "
                f"{seconds(stamps[bad])} s back to {seconds(stamps[bad + 1])} s. Cut "
                f"the log there, or take time = {LOG_TIME!r}"
            )
        if stamps[0] == 0 and stamps[-1] > _EPOCH:
            raise RecordingError(
                f"{where}: some stamps of joint {joint!r} are zero, others show a "
                f"date. Repair the log, or take time = {LOG_TIME!r}"
            )
