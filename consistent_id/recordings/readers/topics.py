"""Topics of a bag: fields by name, merged messages, on the clock of the joints.

A name such as ``/imu/data.angular_velocity`` is a topic, a dot, and a field of its
messages, or a field of a field.  All numbers there are columns, in the order of the
message: x, y, z of a vector, x, y, z, w of a quaternion, force and torque of a wrench.
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from consistent_id._support.arrays import Array, BoolArray, IntArray, Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.beside_columns import BesideColumns
from consistent_id.recordings.readers.named_arrays import (
    parts_of,
    stored_name,
    with_beside,
)
from consistent_id.recordings.recording import Recording, instant
from consistent_id.recordings.signals.base_signals import SHORTEST, stretches
from consistent_id.recordings.signals.clocks import (
    cubic_spline,
    is_uniform,
    own_rate,
    resampled,
)
from consistent_id.recordings.signals.filters import low_passed
from consistent_id.recordings.signals.tracks import ALIAS, ORDER, SAME
from consistent_id.robot.parameters import did_you_mean

# Complete samples per sample of the rarest joint. Two topics or publishers that share a
# clock reach nearly 1; by chance, stamps of nanoseconds hardly ever meet.
_SHARED = 0.5

_log = logging.getLogger(__name__)

# s; a filter rings for some ten periods of a cut-off, so shorter parts are unusable.
_SHORTEST = 1.0


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
    """A field of a topic's messages over time.

    Parameters
    ----------
    log_times : ndarray of int, shape (messages,), [ns]
        Times of logging.
    stamps : ndarray of int, shape (messages,), [ns], optional
        Stamps of the header, if the messages have one.
    values : ndarray, shape (messages, columns)
    kind : {"numbers", "flag", "quaternion"}
        A flag is constant until the next; q and -q are the same rotation.
    """

    log_times: NDArray[np.int64]
    stamps: NDArray[np.int64] | None
    values: Matrix
    kind: str


def topic_field(name: str, where: str) -> TopicField:
    """Return the topic and field of a column name, without a part ``[first:end]``.

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
        If a topic is empty, has no such field, or the field is not numeric.
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


class Layout(NamedTuple):
    """Messages that name the same joints in the same order.

    Parameters
    ----------
    order : ndarray of int, shape (messages,)
        Place of each in the log.
    stamps : ndarray of int, shape (messages,), [ns]
    joints : ndarray of int, shape (columns,)
        Places of their joints among the wanted ones.
    values : ndarray, shape (fields, messages, columns)
    """

    order: IntArray
    stamps: NDArray[np.int64]
    joints: IntArray
    values: Array


class Merged(NamedTuple):
    """Complete samples: stamps [ns], and values of shape (fields, samples, joints)."""

    stamps: NDArray[np.int64]
    values: Array


def merged(layouts: Sequence[Layout], joints: Sequence[str], where: str) -> Merged:
    """Return the increasing stamps with values of all joints, and these values.

    A message that was logged twice is used once.

    Raises
    ------
    RecordingError
        If two messages of one stamp differ in a value, or if most samples of the rarest
        joint lack another joint.
    """
    stamps = np.unique(np.concatenate([layout.stamps for layout in layouts]))
    fields = len(layouts[0].values)
    values = np.full((fields, len(stamps), len(joints)), np.nan)
    seen = np.zeros((len(stamps), len(joints)), dtype=bool)
    for layout in layouts:
        rows = np.searchsorted(stamps, layout.stamps)
        cells = np.ix_(np.arange(fields), rows, layout.joints)
        fresh = ~seen[np.ix_(rows, layout.joints)]
        values[cells] = np.where(fresh, layout.values, values[cells])
        seen[np.ix_(rows, layout.joints)] = True
        differs = (values[cells] != layout.values).any(axis=0)
        if differs.any():
            message, column = np.argwhere(differs)[0]
            raise RecordingError(
                f"{where}: joint {joints[layout.joints[column]]!r} has two values "
                f"at {seconds(layout.stamps[message])} s; repair the log"
            )
    full: BoolArray = np.all(seen, axis=1)
    least = int(seen.sum(axis=0).argmin())
    if full.sum() < _SHARED * seen[:, least].sum():
        apart = int(seen[seen[:, least]].sum(axis=0).argmin())
        raise RecordingError(
            f"{where}: joints {joints[least]!r} and {joints[apart]!r} come in messages "
            f"that hardly ever share a stamp: {full.sum()} of "
            f"{seen[:, least].sum()} samples have all joints. Read them one by one and "
            "resample them onto one clock"
        )
    if not full.all():
        _log.warning(
            "%s: %d of %d samples lack a joint and are left out",
            where,
            len(full) - full.sum(),
            len(full),
        )
    return Merged(stamps[full], values[:, full])


def seconds(stamp: int) -> str:
    """Return a stamp [ns] in seconds, to its last digit."""
    whole, rest = divmod(int(stamp), 10**9)
    return f"{whole}.{rest:09d}"


@dataclass(frozen=True, slots=True)
class JointClock:
    """Sampling times of joint states, and their clock.

    Parameters
    ----------
    start : int, [ns]
        Start of the first sample.
    by_log_time : bool
        Whether stamps are times of logging.
    """

    start: int
    by_log_time: bool


class _OnClock(NamedTuple):
    """Values at the joints' samples, and where they are known."""

    values: Matrix
    known: BoolArray


def with_topics(
    recording: Recording,
    clock: JointClock,
    signals: Mapping[str, TopicSignal],
    beside: BesideColumns,
    where: str,
) -> Recording:
    """Return a recording of joints with base and contacts from topics.

    Each topic is interpolated onto the joints' samples; a faster one is filtered
    before, to 0.8 of the joints' Nyquist frequency.  Samples in a gap of a topic, or
    before or after all its messages, are left out, with a warning.

    Parameters
    ----------
    recording : Recording
        Its time counts from `clock.start`.
    signals : mapping of str to TopicSignal
        By topic and field.

    Raises
    ------
    RecordingError
        If stamps of a topic go back, or no sample is left.
    """
    keep = np.ones(len(recording), dtype=np.bool_)
    values: dict[str, Matrix] = {}
    for name, signal in signals.items():
        time = _times(name, signal, clock, where)
        found = _on_clock(name, signal, time, recording, where)
        _say(name, time, found.known, recording, where)
        keep &= found.known
        values[name] = found.values
    for stretch in stretches(recording.time[keep]):
        if stretch.stop - stretch.start < SHORTEST:
            keep[np.flatnonzero(keep)[stretch]] = False
    if not keep.any():
        raise RecordingError(
            f"{where}: no joint state lies within the messages of "
            f"{', '.join(signals)}. If their stamps are of different clocks, take "
            "time = 'log_time' in columns"
        )
    kept = recording.samples(np.flatnonzero(keep))
    arrays = {name: array[keep] for name, array in values.items()}
    return with_beside(kept, parts_of(arrays, beside.names, where), beside, where)


def _times(name: str, signal: TopicSignal, clock: JointClock, where: str) -> Vector:
    """Return the times of messages, in the time of the recording [s]."""
    stamps = signal.log_times if clock.by_log_time else signal.stamps
    if stamps is None or not stamps.any():
        _log.warning("%s: %s has no stamps, the time of logging is used", where, name)
        stamps = signal.log_times
    steps = np.diff(stamps)
    if (steps < 0).any():
        bad = int(np.argmax(steps < 0))
        raise RecordingError(
            f"{where}: the stamp of {name} goes from {seconds(stamps[bad])} s back to "
            f"{seconds(stamps[bad + 1])} s. Cut the log there, or take "
            "time = 'log_time'"
        )
    return np.asarray((stamps - clock.start) / 1e9)


def _on_clock(
    name: str, signal: TopicSignal, time: Vector, recording: Recording, where: str
) -> _OnClock:
    # A message that was logged twice is used once
    fresh = np.append(True, np.diff(time) > 0.0)
    time, values = time[fresh], signal.values[fresh]
    if signal.kind == "quaternion":
        values = values * _signs(values)[:, None]
    at = recording.time
    found, known = np.zeros((len(at), values.shape[1])), np.zeros(len(at), np.bool_)
    if signal.kind == "flag":
        known = (at >= time[0]) & (at <= time[-1])
        place = np.searchsorted(time, at[known], side="right") - 1
        found[known] = values[place]
        return _OnClock(found, known)
    for part in _parts(name, time, values, own_rate(recording), where):
        inside = (at >= part.time[0]) & (at <= part.time[-1])
        found[inside] = cubic_spline(part.time, part.position, at[inside])
        known |= inside
    if signal.kind == "quaternion":
        norms = np.linalg.norm(found, axis=1, keepdims=True)
        found = found / np.where(norms > 0.0, norms, 1.0)
    return _OnClock(found, known)


def _parts(
    name: str, time: Vector, values: Matrix, rate: float, where: str
) -> Iterator[Recording]:
    """Yield the parts between gaps, filtered if they are faster than the joints."""
    columns = tuple(map(str, range(values.shape[1])))
    for stretch in stretches(time):
        if time[stretch][-1] - time[stretch][0] < _SHORTEST:
            continue
        part = Recording(columns, time[stretch], values[stretch], name=name)
        own = own_rate(part)
        if own > SAME * rate:
            part = part if is_uniform(part) else resampled(part, own)
            part = low_passed(part, motion_cutoff=ALIAS * rate / 2.0, order=ORDER)
        elif own < rate / SAME:
            _log.warning(
                "%s: %s comes %.4g times a second, joint states %.4g times: filter the "
                "motion and torque below %.3g Hz",
                where,
                name,
                own,
                rate,
                ALIAS * own / 2.0,
            )
        yield part


def _signs(quaternions: Matrix) -> Vector:
    """Return signs that make successive quaternions continuous; both are valid."""
    along = np.einsum("ij,ij->i", quaternions[1:], quaternions[:-1])
    turns = np.where(along < 0.0, -1.0, 1.0)
    return np.asarray(np.cumprod(np.append(1.0, turns)))


def _say(
    name: str, time: Vector, known: BoolArray, recording: Recording, where: str
) -> None:
    """Warn of samples without messages of a topic."""
    missing = np.flatnonzero(~known)
    if not len(missing):
        return
    outside = (recording.time < time[0]) | (recording.time > time[-1])
    silent = np.flatnonzero(~known & ~outside)
    gap = ""
    if len(silent):
        at = instant(recording.time[silent[0]], recording.time)
        gap = f"; the first gap is at t = {at} s"
    _log.warning(
        "%s: %s has no message around %d of %d joint states, which are left out: %d "
        "before or after all its messages, %d in gaps%s",
        where,
        name,
        len(missing),
        len(known),
        len(missing) - len(silent),
        len(silent),
        gap,
    )
