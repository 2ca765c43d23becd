"""What topics beside the joint states say, on the clock of the joint states."""

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import BoolArray, Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.array_parts import parts_of
from consistent_id.recordings.readers.beside_columns import BesideColumns
from consistent_id.recordings.readers.merging import seconds
from consistent_id.recordings.readers.named_arrays import with_beside
from consistent_id.recordings.readers.topic_fields import TopicSignal
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.alignment import ALIAS, ORDER, SAME
from consistent_id.recordings.signals.base_stretches import SHORTEST, stretches
from consistent_id.recordings.signals.clocks import is_uniform, own_rate, resampled
from consistent_id.recordings.signals.filters import low_passed
from consistent_id.recordings.signals.spline import cubic_spline

# s; a filter rings for some ten periods of a cut-off, and what is shorter is all ends.
_SHORTEST = 1.0

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class JointClock:
    """When joint states were sampled, and by which of the two clocks.

    Parameters
    ----------
    start : int, [ns]
        Of the first sample.
    by_log_time : bool
        Whether stamps are times of logging.
    """

    start: int
    by_log_time: bool


class _OnClock(NamedTuple):
    """Values at the joints' samples, and at which of them they are known."""

    values: Matrix
    known: BoolArray


def with_topics(
    recording: Recording,
    clock: JointClock,
    signals: Mapping[str, TopicSignal],
    beside: BesideColumns,
    where: str,
) -> Recording:
    """Return a recording of joints with what topics say of base and contacts.

    Each is interpolated onto the joints' samples; one that is faster is filtered
    before, to 0.8 of the joints' Nyquist frequency.  Samples in a gap of a topic, or
    before or after all its messages, are left out, and a warning says so.

    Parameters
    ----------
    recording : Recording
        Its time counts from `clock.start`.
    signals : mapping of str to TopicSignal
        By topic and field.

    Raises
    ------
    RecordingError
        If stamps of a topic go back, or nothing is left.
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
    """Return when messages are of, in the time of the recording [s]."""
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
    fresh = np.append(True, np.diff(time) > 0.0)  # logged twice, it counts once
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
    """Yield what lies between gaps, filtered where it is faster than the joints."""
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
    """Return signs that make quaternions follow each other, which mean the same."""
    along = np.einsum("ij,ij->i", quaternions[1:], quaternions[:-1])
    turns = np.where(along < 0.0, -1.0, 1.0)
    return np.asarray(np.cumprod(np.append(1.0, turns)))


def _say(
    name: str, time: Vector, known: BoolArray, recording: Recording, where: str
) -> None:
    """Warn of samples at which a topic is silent."""
    missing = np.flatnonzero(~known)
    if not len(missing):
        return
    outside = (recording.time < time[0]) | (recording.time > time[-1])
    silent = np.flatnonzero(~known & ~outside)
    gap = ""
    if len(silent):
        gap = f"; the first gap is at t = {recording.time[silent[0]]:.6g} s"
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
