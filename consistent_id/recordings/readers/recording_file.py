"""Recordings from files, the names of a file's arrays, and rows of large logs.

A file may state units of its arrays, for example as attributes of HDF5 datasets; they
are used if no unit is given.  `LogRows` reads a log that may be larger than memory in
windows, in ascending order.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from consistent_id._support.arrays import IntArray, Vector
from consistent_id._support.files import (
    GIBIBYTE,
    memory_of_this_computer,
    require_regular,
)
from consistent_id._support.run import current_run
from consistent_id.errors import RecordingError
from consistent_id.recordings.log_formats import LOG_FORMATS, log_format
from consistent_id.recordings.readers.columns import (
    JOINT_STATE,
    Columns,
    WantedChannels,
    wanted,
)
from consistent_id.recordings.readers.jointstate import (
    joint_state_fields,
    recording_of_messages,
)
from consistent_id.recordings.readers.named_arrays import (
    Arrays,
    LogName,
    parts_of,
    read_parts,
    recording_of,
    stored_name,
    stored_names,
    vector_of,
)
from consistent_id.recordings.readers.units import (
    KNOWN,
    clock_columns,
    factors,
    is_other_unit,
    standard_unit,
)
from consistent_id.recordings.readers.used_rows import Duplicates, Missing, UsedRows
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.tracks import Channel, Track, track

_COPIES = 2  # least memory for reading a file as a whole, relative to its size


def read_recording(
    path: str | Path,
    joints: Sequence[str],
    columns: Columns | None = None,
    *,
    torque_gain: ArrayLike = 1.0,
    topic: str | None = None,
    omit: Sequence[int] = (),
    duplicates: Duplicates = "refuse",
    missing: Missing = "refuse",
) -> Recording:
    """Read a recording from a file, or a folder of a ROS 2 bag or LeRobot data set.

    Parameters
    ----------
    path : str or Path
        CSV (``.csv``, ``.tsv``, ``.txt``, ``.dat``, ``.asc``, ``.log``, ``.lvm``,
        ``.prn``; comma, semicolon, tab or spaces; a decimal comma where the comma does
        not separate; printed messages, also ``.yaml``, ``.yml``, ``.xml``), Parquet
        (``.parquet``), a LeRobot data set (its folder, or a file of it), Feather
        (``.feather``, ``.arrow``), NPZ (``.npz``), NPY (``.npy``), JSON (``.json``,
        ``.jsonl``, ``.ndjson``), HDF5 (``.h5``, ``.hdf5``), MATLAB (``.mat``), PyTorch
        (``.pt``, ``.pth``: tensors of ``torch.save``); a folder of tables with one
        clock, side by side; a ROS bag with ``sensor_msgs/JointState`` (``.mcap``,
        ``.db3``, ``.bag`` or a folder). `BesideColumns` name fields of other topics as
        ``TOPIC.FIELD``, such as ``"/imu/data.angular_velocity"``.
    joints : sequence of str
        Names of the joints to read.
    columns : Columns
        Names of the columns, in SI units (s, rad, m, N m, N) or in the units that it
        states; attributes ``units`` of HDF5 datasets are read. By default ``Columns()``
        and, for a bag, `JOINT_STATE`.
    torque_gain : array_like, shape () or (joints,)
        Factor from the torque column to torque, such as a drive's N m per ampere.
    topic : str
        Topic of a bag; by default that of joint states which names most of the joints.
    omit : sequence of int
        Broken rows to leave out, counted from 1.  Not for bags.
    duplicates : {"refuse", "first", "last"}
        The row that is used if several have one time stamp.  Not for bags.
    missing : {"refuse", "omit"}
        Whether rows with empty or NaN values are left out.  Not for bags.

    Raises
    ------
    RecordingError
        If the file, a column or a value is missing or faulty; with file, row, column.

    Examples
    --------
    >>> import consistent_id as ci
    >>> import tempfile
    >>> from pathlib import Path
    >>> file = Path(tempfile.mkdtemp(), "log.csv")
    >>> lines = ["time,q_elbow", "0.0,0.1", "0.1,0.2", "0.2,0.3"]
    >>> _ = file.write_text(chr(10).join(lines))
    >>> log = ci.read_recording(file, ["elbow"], ci.Columns(position="q_{joint}"))
    >>> log.rate, log.position.ravel()
    (10.0, array([0.1, 0.2, 0.3]))
    """
    path = Path(path)
    if log_format(path).holds == "joint states":
        if len(omit) or duplicates != "refuse" or missing != "refuse":
            raise RecordingError(
                f"{path}: omit, duplicates and missing are for rows of tables; bags "
                "have messages, not rows"
            )
        columns = columns or JOINT_STATE
        joint_state_fields(columns, joints, str(path))  # before a long read
        _require_room(path)
        content = reader_of(path).read_messages(
            path, topic, columns.beside.names, columns.in_log(joints)
        )
        return recording_of_messages(
            content, joints, columns, LogName.of(path), torque_gain
        )
    if topic is not None:
        raise RecordingError(
            f"{path}: topic {topic!r} is given, but only bags have topics"
        )
    want = wanted_of(path, columns or Columns(), joints)
    reader = reader_of(path)
    if log_format(path).in_pieces(path):
        _require_room(path)
    rows = UsedRows(omit, duplicates, missing)
    return recording_of(
        read_parts(reader, path, want.names, rows),
        want,
        LogName.of(path),
        torque_gain=torque_gain,
        rows=rows,
    )


def read_track(
    path: str | Path,
    joints: Sequence[str],
    channel: Channel,
    column: str,
    *,
    time: str = "time",
    torque_gain: ArrayLike = 1.0,
) -> Track:
    """Read a separate file of one sensor, such as accelerations.

    `aligned` brings it to the clock of a recording; `estimate_delay` estimates its
    delay.

    Parameters
    ----------
    path : str or Path
        See `read_recording`.
    joints : sequence of str
    channel : {"position", "velocity", "acceleration", "torque"}
    column : str
        Names of the columns, with ``{joint}`` or ``{number}``; in SI units.
    time : str
        Name of the column of stamps.
    torque_gain : array_like, shape () or (joints,)
        Conversion factor of a torque.

    Raises
    ------
    RecordingError
        As `read_recording`.
    """
    # A recording needs a position; here this field contains the track's channel.
    columns = Columns(time, column)
    columns = replace(columns, **{channel: column})  # type: ignore[arg-type]
    recording = read_recording(path, joints, columns, torque_gain=torque_gain)
    return track(recording, channel)


def column_names(path: Path) -> tuple[str, ...]:
    """Return the names of a log's columns or arrays, in the file's order.

    Raises
    ------
    RecordingError
        If the file cannot be read, or names cannot be listed in its format.
    """
    if not log_format(path).lists_names:
        listed = ", ".join(known.name for known in LOG_FORMATS if known.lists_names)
        raise RecordingError(
            f"{path}: columns can be found only in files of {listed}; name them "
            f"(--position, --torque; in Python, Columns)"
        )
    names: tuple[str, ...] = reader_of(path).array_names(path)
    if not any(names):
        raise RecordingError(
            f"{path}: no column or array of numbers: it is empty, or no table"
        )
    return names


class RowSource(Protocol):
    """A source of rows of a log."""

    @property
    def path(self) -> Path:
        """The log."""

    def times(self) -> Iterator[Vector]:
        """Yield the times of all rows, in pieces [s]."""

    def windows(self, rows: Iterable[tuple[int, int]]) -> Iterator[Recording]:
        """Yield the recording of each range of rows, ``first <= row < last``.

        Neither the first nor the last rows of the ranges may decrease.
        """


@dataclass(frozen=True)
class LogRows:
    """A log on disk, and the data to read from it.

    Parameters
    ----------
    path : Path
        File of a format with `LogFormat.streams`.
    torque_gain : array_like, shape () or (joints,)
    omit : tuple of int
        Rows that are left out, counted from 1; other rows are counted without them.
    """

    path: Path
    joints: tuple[str, ...]
    columns: Columns
    torque_gain: ArrayLike = 1.0
    omit: tuple[int, ...] = ()

    def times(self) -> Iterator[Vector]:
        """Yield the times of all rows, in pieces [s]."""
        name = self.columns.time
        want = wanted_of(self.path, self.columns, self.joints)
        (unit,) = set(factors(want.units, "time", self.joints[:1]).tolist())
        names = [name] if clock_columns(name) else want.names
        for arrays in self._batches(names, 0):
            yield vector_of(arrays, name, str(self.path)) * unit

    def windows(self, rows: Iterable[tuple[int, int]]) -> Iterator[Recording]:
        """Yield the recording of each range of rows, ``first <= row < last``.

        Neither the first nor the last rows of the ranges may decrease.
        """
        want = wanted_of(self.path, self.columns, self.joints)
        held: deque[Arrays] = deque()
        batches: Iterator[Arrays] | None = None
        begin = end = 0
        for first, last in rows:
            if batches is None:
                batches, begin, end = self._batches(want.names, first), first, first
            while held and begin + _rows(held[0]) <= first:
                begin += _rows(held.popleft())
            while end < last and (batch := next(batches, None)) is not None:
                if end + _rows(batch) > first:
                    held.append(batch)
                else:
                    begin += _rows(batch)
                end += _rows(batch)
            part = slice(first - begin, last - begin)
            arrays = {
                name: np.concatenate([batch[name] for batch in held])[part]
                for name in want.names
            }
            yield recording_of(
                arrays,
                want,
                LogName.of(self.path),
                torque_gain=self.torque_gain,
                rows=UsedRows(numbers=self._numbers(first, last)),
            )

    def _numbers(self, first: int, last: int) -> IntArray:
        """Return the numbers in the file, from 1; `first` counts no omitted rows."""
        numbers = np.arange(first + 1, last + 1)
        for row in sorted(set(self.omit)):
            numbers += row <= numbers
        return numbers

    def _batches(self, names: list[str], first: int) -> Iterator[Arrays]:
        """Yield the named arrays from a row on, without the rows to omit."""
        at = first
        omitted = np.array(sorted(row - 1 for row in self.omit), dtype=int)
        for row in omitted:
            at += row <= at
        stored = stored_names(names)
        given = (self.omit,) if log_format(self.path).is_text else ()
        reader = reader_of(self.path)
        for batch in reader.read_batches(self.path, stored, at, *given):
            arrays = parts_of(batch, names, self.path, at)
            rows = _rows(arrays)
            if len(omitted):
                keep = ~np.isin(np.arange(at, at + rows), omitted)
                arrays = {name: values[keep] for name, values in arrays.items()}
            at += rows
            if _rows(arrays):
                yield arrays
        if len(omitted) and omitted[-1] >= at:
            raise RecordingError(
                f"{self.path}: omit names row {omitted[-1] + 1}, but there are {at}, "
                "counted from 1"
            )


def reader_of(path: Path) -> Any:
    """Return the module that reads a log.

    Raises
    ------
    RecordingError
        If there is no such file, or its reader is not installed.
    """
    known = log_format(path)
    if not path.exists():
        raise RecordingError(f"{path}: no such file")
    for file in path.iterdir() if path.is_dir() else [path]:
        if not file.is_dir():
            require_regular(file, RecordingError)
    return known.reader(path)


def read_whole(path: Path, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Return named arrays of a log, without dimensions of one beside two others.

    Raises
    ------
    RecordingError
        If the file cannot be read, or there is no such array.
    """
    return read_parts(reader_of(path), path, names, UsedRows())


def wanted_of(path: Path, columns: Columns, joints: Sequence[str]) -> WantedChannels:
    """Return the data to read from a file of arrays, in the units that it states.

    Raises
    ------
    RecordingError
        As `wanted` and `_in_stated_units`.
    """
    want = wanted(columns, joints, str(path))
    if not log_format(path).states_units:
        return want
    plain = [name for name in want.names if clock_columns(name) == (name,)]
    stored = {name: stored_name(name) for name in plain}
    said = reader_of(path).array_units(path, list(dict.fromkeys(stored.values())))
    of_names = {name: said[at] for name, at in stored.items() if at in said}
    return _in_stated_units(want, of_names, str(path))


def does_not_fit(path: Path) -> str:
    """Return why a log is too large to be read as a whole; empty if it is not.

    Parameters
    ----------
    path : Path
        A file, or the folder of a bag.
    """
    files = path.iterdir() if path.is_dir() else [path]
    size = sum(file.stat().st_size for file in files if file.is_file())
    room = memory_of_this_computer()
    if room is None or _COPIES * size <= room or current_run().large_files:
        return ""
    return (
        f"{path}: {size / GIBIBYTE:.1f} GiB is too large to be read as a whole with "
        f"{room / GIBIBYTE:.1f} GiB of memory"
    )


def _require_room(path: Path) -> None:
    """Refuse a log that is too large for this computer, but can be streamed."""
    if path.exists() and (reason := does_not_fit(path)):
        raise RecordingError(
            f"{reason}; read it piece by piece: "
            "consistent-id identify PROBLEM --streamed, or consistent-id compress (in "
            "Python: stream_estimate, stream_regression); or use --large-files (in "
            "Python: with consistent_id.large_files()) if it fits into memory"
        )


def _in_stated_units(
    want: WantedChannels, said: Mapping[str, str], where: str
) -> WantedChannels:
    """Return the data to read, in the file's stated units if no others are given.

    Parameters
    ----------
    said : mapping of str to str
        Unit by name of an array; words that are not units are ignored.
    where : str
        The file.

    Raises
    ------
    RecordingError
        If an array's unit does not fit its channel, or differs from the given one.
    """
    units = dict(want.units)
    for channel, names in _names(want).items():
        found = [_unit(channel, name, said, where) for name in names]
        if not any(found):
            continue
        alone = channel == "time" or channel in want.arrays
        if channel not in units:
            units[channel] = found[0] if alone else tuple(found)
            continue
        given = units[channel]
        each = [given] * len(names) if isinstance(given, str) else list(given)
        for name, own, other in zip(names, found, each, strict=False):
            if own and own != other:
                raise RecordingError(
                    f"{where}: column {name!r} is in {own!r} according to the file, "
                    f"and in {other!r} according to the units of {channel}: leave "
                    f"one of them out"
                )
    for name in want.beside.names:
        if is_other_unit(said.get(name, "")):
            raise RecordingError(
                f"{where}: column {name!r} is in {said[name]!r} according to the "
                f"file; motion of a base, contacts and forces are read in SI units. "
                f"Convert them "
                "first: recording_from takes arrays"
            )
    return replace(want, units=units)


def _names(want: WantedChannels) -> dict[str, Sequence[str]]:
    arrays = {channel: (name,) for channel, name in want.arrays.items()}
    channels = {"time": (want.time,), **arrays, **want.columns}
    return {c: names for c, names in channels.items() if c in KNOWN}


def _unit(channel: str, name: str, said: Mapping[str, str], where: str) -> str:
    """Return an array's unit as `KNOWN` spells it; empty if none is stated."""
    text = said.get(name, "").strip()
    try:
        return standard_unit(channel, text) if text else ""
    except RecordingError as cause:
        if is_other_unit(text):
            raise RecordingError(f"{where}: column {name!r}: {cause}") from None
        return ""


def _rows(arrays: Arrays) -> int:
    return len(next(iter(arrays.values())))
