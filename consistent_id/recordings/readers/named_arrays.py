"""A recording from named arrays of a file.

A name may select some columns of an array, counted from 0: ``qpos[7:19]``.
"""

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from consistent_id._support.arrays import (
    Array,
    Matrix,
    Vector,
    frozen,
)
from consistent_id.errors import RecordingError
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers.beside_columns import BesideColumns
from consistent_id.recordings.readers.columns import WantedChannels
from consistent_id.recordings.readers.units import (
    Units,
    clock_columns,
    factors,
    fraction_unit,
    needs_gain,
    rate_of,
)
from consistent_id.recordings.readers.used_rows import (
    MISSING_ADVICE,
    OMIT_MISSING,
    UsedRows,
    broken_samples,
    complete,
    distinct,
    kept,
    of_one_clock,
    omit_advice,
)
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.time_stamps import (
    LEAST_STEP,
    SampleError,
    unit_option,
)

_log = logging.getLogger(__name__)

Arrays = Mapping[str, NDArray[Any]]


_LYING = 10  # columns over rows, from which on columns are samples
_PART = re.compile(r"(?P<name>.+)\[(?P<first>\d*):(?P<end>\d*)\]")


class LogName(NamedTuple):
    """The name of a log.

    Parameters
    ----------
    name : str
        Name of the recording.
    where : str
        The log's name in messages: a path, or the same.
    """

    name: str
    where: str

    @staticmethod
    def of(path: Path) -> "LogName":
        """Return the name of a file's recording."""
        return LogName(path.name, str(path))


class Conversion(NamedTuple):
    """The conversion of a log's numbers to SI units.

    Parameters
    ----------
    units : mapping of str to str
        By channel.
    torque_gain : array_like, shape () or (joints,)
        Factor from the torque channel to torque.
    without_torque : sequence of int
        Places of the joints whose torque the log does not have; it becomes zero.
    """

    units: Units
    torque_gain: ArrayLike = 1.0
    without_torque: Sequence[int] = ()

    def recording(
        self,
        joints: tuple[str, ...],
        time: Vector,
        channels: dict[str, Matrix],
        name: str,
    ) -> Recording:
        """Return the recording of a log's channels."""
        units, torque_gain = self.units, self.torque_gain
        if np.ndim(torque_gain) == 0 and torque_gain == 1.0:
            require_gain(units, name)
        time = time * factors(units, "time", joints[:1])
        channels = {
            channel: _times(values, factors(units, channel, joints))
            for channel, values in channels.items()
        }
        if "torque" in channels:
            shape = (len(joints),) if np.ndim(torque_gain) else ()
            gain = frozen(torque_gain, shape, "torque_gain", RecordingError)
            torque = channels["torque"] * gain
            torque[:, list(self.without_torque)] = 0.0
            channels = channels | {"torque": torque}
        return Recording(joints, time, name=name, **cast(dict[str, Any], channels))


def _require_seconds(log: Recording, time: Vector, unit: str) -> None:
    """Refuse a clock in hours or days, whose steps no filter could resolve.

    Parameters
    ----------
    time : ndarray, shape (samples,)
        As written.
    unit : str
        The stated one; empty for seconds.
    """
    step = float(np.median(np.diff(log.time)))
    if step >= LEAST_STEP:
        return
    option = unit_option(time) or "--units time=s"
    unit_word = _CLOCK_UNITS[option.rpartition("=")[2]]
    said = f"with times in {unit}, as stated, " if unit else ""
    raise RecordingError(
        f"{log.name}: {said}samples are {step:.3g} s apart, more than any robot logs; "
        f"they look like {unit_word}: {option} (or another of s, min, h and day)",
        options=option,
    )


_CLOCK_UNITS = {
    "s": "seconds",
    "ms": "milliseconds",
    "us": "microseconds",
    "ns": "nanoseconds",
    "100ns": "steps of 100 ns",
    "min": "minutes",
    "h": "hours",
    "day": "days",
}


def recording_of(
    arrays: Arrays,
    want: WantedChannels,
    log: LogName,
    *,
    torque_gain: ArrayLike,
    rows: UsedRows,
) -> Recording:
    """Return the recording of the wanted arrays.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        Columns of shape (samples,), (samples, 1) or (1, samples); two-dimensional
        arrays of shape (samples, width) or its transpose, by the length of time.
    log : LogName
    torque_gain : array_like, shape () or (joints,)
    rows : UsedRows

    Raises
    ------
    RecordingError
        If there is no such row, an array does not contain numbers, or shapes do not
        fit.
    """
    where = log.where
    time = vector_of(arrays, want.time, where)
    channels = _wanted_channels(arrays, want, len(time), where)
    keep = kept(len(time), rows.omit, where)
    if rows.missing == "omit":
        keep &= complete(time, channels, want.joints, where)
    keep[keep] = distinct(time[keep], rows.duplicates)
    second = 1.0 / float(factors(want.units, "time", want.joints[:1])[0])
    time = of_one_clock(time, keep, second, where)
    beside = {n: _by_sample(arrays[n], len(time))[keep] for n in want.beside.names}
    if not keep.all():
        channels = {name: values[keep] for name, values in channels.items()}
    try:
        in_si = Conversion(want.units, torque_gain, want.without_torque)
        recording = in_si.recording(want.joints, time[keep], channels, log.name)
        if rate_of(want.time) is None:
            _require_seconds(recording, time[keep], str(want.units.get("time", "")))
        if want.beside:
            recording = with_beside(recording, beside, want.beside, where)
    except SampleError as cause:
        seconds = time[keep] * factors(want.units, "time", want.joints[:1])
        broken = broken_samples(seconds, [*channels.values(), *beside.values()])
        numbers = rows.numbers
        numbers = np.arange(1, len(time) + 1) if numbers is None else numbers
        faulty = numbers[keep][broken].tolist()
        advice = omit_advice(faulty, len(seconds))
        options = cause.options or f"--omit {','.join(map(str, faulty))}" * bool(advice)
        if any(np.isnan(values).any() for values in channels.values()):
            advice = f"{advice}{MISSING_ADVICE}"
            options = f"{cause.options} {OMIT_MISSING}".strip()
        raise RecordingError(f"{cause}{advice}", options=options) from None
    return recording


def _wanted_channels(
    arrays: Arrays, want: WantedChannels, samples: int, where: str
) -> dict[str, Matrix]:
    """Return the wanted channels, shape (samples, joints), in the log's units."""
    channels: dict[str, Matrix] = {}
    for channel, array in want.arrays.items():
        channels[channel] = _matrix(arrays, array, samples, want, where)
    for channel, group in want.columns.items():
        nothing = np.zeros(samples)
        columns = [vector_of(arrays, c, where) if c else nothing for c in group]
        for column, values in zip(group, columns, strict=True):
            if len(values) != samples:
                raise RecordingError(
                    f"{where}: column {column!r} has {len(values)} values, time "
                    f"{want.time!r} has {samples}"
                )
        channels[channel] = np.column_stack(columns)
    return channels


def _by_sample(values: NDArray[Any], samples: int) -> NDArray[Any]:
    """Return an array whose first axis is that of samples, if one is."""
    flat = values.reshape(-1) if values.ndim == 2 and 1 in values.shape else values
    return flat.T if flat.ndim == 2 and len(flat) != samples else flat


def with_beside(
    recording: Recording, arrays: Arrays, beside: BesideColumns, where: str
) -> Recording:
    """Add the base's motion, contacts and wrenches, of arrays by name."""
    time = recording.time
    base = None if beside.base is None else beside.base.motion(arrays, time, where)
    return replace(
        recording,
        base=base,
        contacts=tuple(c.flags(arrays, time, where) for c in beside.contacts),
        wrenches=tuple(w.wrench(arrays, time, where) for w in beside.wrenches),
    )


def require_gain(units: Units, where: str) -> None:
    """Refuse a torque in a unit that only a gain converts.

    Raises
    ------
    RecordingError
        With the option that states the gain.
    """
    if unit := needs_gain(units):
        raise RecordingError(
            f"{where}: torque is in {unit}, without a gain. Give the conversion to "
            f"torque at each joint, gear ratio included, the rated torque in N m or "
            f"N m per ampere: --torque-gain NUMBER ... (torque_gain)"
        )


def _times(values: Matrix, factor: Vector) -> Matrix:
    """Return values times a factor for each joint; no copy where all are 1."""
    return values if (factor == 1.0).all() else values * factor


def _numbers(arrays: Arrays, name: str, where: str) -> Array:
    raw = arrays[name]
    if np.ma.isMaskedArray(raw) or raw.dtype.kind not in "iuf":
        kind = "a masked array" if np.ma.isMaskedArray(raw) else raw.dtype
        hint = ""
        if raw.dtype.kind in "mM":
            hint = f". Take the seconds: ({name} - {name}[0]) / np.timedelta64(1, 's')"
        raise RecordingError(
            f"{where}: column {name!r} holds {kind}, expected numbers in SI units{hint}"
        )
    return raw.astype(np.float64, copy=False)  # a recording has its own copy


def vector_of(arrays: Arrays, name: str, where: str) -> Vector:
    """Return the array of one value per sample.

    Raises
    ------
    RecordingError
        If it does not contain numbers, or has another shape.
    """
    values = _numbers(arrays, name, where)
    if values.ndim == 2 and 1 in values.shape:
        return values.reshape(-1)  # the vectors of MATLAB
    if values.ndim != 1:
        raise RecordingError(
            f"{where}: column {name!r} has shape {values.shape}, expected one value "
            "per sample. If it is an array of all joints, list the joints of its "
            "columns in array_joints, and leave {joint} and {number} out of its name"
        )
    return values


def _matrix(
    arrays: Arrays, name: str, samples: int, want: WantedChannels, where: str
) -> Matrix:
    values = _numbers(arrays, name, where)
    if values.ndim == 1 and want.width == 1:
        values = values[:, None]
    upright, lying = (samples, want.width), (want.width, samples)
    if upright == lying:
        raise RecordingError(
            f"{where}: array {name!r} has shape {values.shape} with as many samples as "
            "joints: the axis of time is ambiguous. Name single columns instead"
        )
    if values.shape not in (upright, lying):
        raise RecordingError(
            f"{where}: array {name!r} has shape {values.shape}, expected {upright} or "
            f"{lying}: time {want.time!r} has {samples} samples, array_joints "
            f"{want.width} joints"
        )
    values = values if values.shape == upright else values.T
    return values[:, list(want.places)]


def stored_name(name: str) -> str:
    """Return the name of the array that a name denotes, as a whole or in part."""
    part = _PART.fullmatch(name)
    return name if part is None else part["name"]


def read_parts(
    reader: Any, path: Path, names: Sequence[str], rows: UsedRows
) -> dict[str, NDArray[Any]]:
    """Return named arrays, and parts of arrays, by the requested names.

    Parameters
    ----------
    reader : module
        Reader of a format, see `LogFormat`.
    rows : UsedRows
        Rows that are used afterwards; of text, others may hold anything.

    Raises
    ------
    RecordingError
        If there is no such array, or it has no such columns.
    """
    given = (rows.omit, rows.missing) if log_format(path).is_text else ()
    arrays = dict(reader.read_arrays(path, stored_names(names), *given))
    for name, values in arrays.items():
        if values.ndim > 2:  # such as 6 x 1 x samples, of Simulink
            arrays[name] = values.squeeze()
    for name in {stored_name(part) for part in names if _PART.fullmatch(part)}:
        arrays[name] = upright(arrays[name])
    return parts_of(arrays, names, path)


def upright(values: NDArray[Any]) -> NDArray[Any]:
    """Return an array with samples in rows; Drake's logs have them in columns."""
    lies = values.ndim == 2 and values.shape[1] > _LYING * len(values)
    return values.T if lies else values


def stored_names(names: Sequence[str]) -> list[str]:
    """Return the names of the arrays that are requested as a whole or in part."""
    parts = (part for name in names for part in clock_columns(name))
    return list(dict.fromkeys(map(stored_name, parts)))


def parts_of(
    arrays: Mapping[str, NDArray[Any]],
    names: Sequence[str],
    where: Path | str,
    first: int = 0,
) -> dict[str, NDArray[Any]]:
    """Return the requested arrays and parts of arrays, which begin at a row.

    Raises
    ------
    RecordingError
        If an array has no such columns.
    """
    found: dict[str, NDArray[Any]] = {}
    for name in names:
        if clock_columns(name) != (name,):
            found[name] = _clock(name, arrays, str(where), first)
            continue
        part, whole = _PART.fullmatch(name), arrays[stored_name(name)]
        found[name] = (
            whole if part is None else _columns(whole, part, f"{where}: {name}")
        )
    return found


def _clock(name: str, arrays: Arrays, where: str, first: int) -> Vector:
    """Return a clock of two columns, or of a rate, from a row on."""
    if rate := rate_of(name):
        sizes = [max(values.shape, default=0) for values in arrays.values()]
        rows = max(sizes, default=0)
        return np.asarray((first + np.arange(rows)) / rate)
    whole, fraction = clock_columns(name)
    unit = fraction_unit(where, fraction)
    return vector_of(arrays, whole, where) + unit * vector_of(arrays, fraction, where)


def _columns(whole: NDArray[Any], part: re.Match[str], where: str) -> NDArray[Any]:
    first, end = int(part["first"] or 0), int(part["end"] or 0)
    if whole.ndim != 2:
        raise RecordingError(
            f"{where}: {part['name']} has shape {whole.shape}, expected rows and "
            "columns"
        )
    end = end or whole.shape[1]
    if not first < end <= whole.shape[1]:
        raise RecordingError(
            f"{where}: {part['name']} has {whole.shape[1]} columns, counted from 0"
        )
    return np.asarray(whole[:, first:end])
