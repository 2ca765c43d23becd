"""Recordings from files, and the names of what a file holds."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from consistent_id._support.inputs import (
    GIBIBYTE,
    memory_of_this_computer,
    require_regular,
)
from consistent_id._support.run import current_run
from consistent_id.errors import RecordingError
from consistent_id.recordings.log_formats import LOG_FORMATS, log_format
from consistent_id.recordings.readers.array_parts import read_parts, stored_name
from consistent_id.recordings.readers.columns import (
    JOINT_STATE,
    Columns,
    Wanted,
    wanted,
)
from consistent_id.recordings.readers.jointstate import (
    joint_state_fields,
    recording_of_messages,
)
from consistent_id.recordings.readers.named_arrays import recording_of
from consistent_id.recordings.readers.stated_units import in_stated_units
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.track import Channel, Track, track

_COPIES = 2  # of a file's size that reading it as a whole takes, at the least


def read_recording(
    path: str | Path,
    joints: Sequence[str],
    columns: Columns | None = None,
    *,
    torque_gain: ArrayLike = 1.0,
    topic: str | None = None,
    omit: Sequence[int] = (),
) -> Recording:
    """Read a recording from a file, or from the folder of a ROS 2 bag.

    Parameters
    ----------
    path : str or Path
        CSV (``.csv``, ``.tsv``; comma, semicolon or tab; a decimal comma where the
        comma does not separate), Parquet (``.parquet``), Feather (``.feather``,
        ``.arrow``), NPZ (``.npz``), HDF5 (``.h5``, ``.hdf5``), MATLAB (``.mat``); a ROS
        bag with ``sensor_msgs/JointState`` (``.mcap``, ``.db3``, ``.bag`` or a folder).
        Of its other topics, what `BesideColumns` name as ``TOPIC.FIELD``, such as
        ``"/imu/data.angular_velocity"``.
    joints : sequence of str
        Names of the joints to read.
    columns : Columns
        Names of the columns, in SI units (s, rad, m, N m, N) or in those that it
        states; attributes ``units`` of HDF5 datasets are read.  By default
        ``Columns()`` and, of a bag, `JOINT_STATE`.
    torque_gain : array_like, shape () or (joints,)
        Factor from the torque column to torque, such as a drive's N m per ampere.
    topic : str
        Of a bag; by default its only topic of joint states.
    omit : sequence of int
        Rows of samples to leave out, counted from 1: broken ones.  Not of bags.

    Raises
    ------
    RecordingError
        If the file, a column or a value is missing or faulty; with file, row, column.
    """
    path = Path(path)
    if log_format(path).holds == "joint states":
        if len(omit):
            raise RecordingError(
                f"{path}: omit counts the rows of tables; messages of bags have none"
            )
        columns = columns or JOINT_STATE
        joint_state_fields(columns, joints, str(path))  # before a long read
        _require_room(path)
        content = reader_of(path).read_messages(path, topic, columns.beside.names)
        return recording_of_messages(
            content.states,
            joints,
            columns,
            where=str(path),
            name=path.name,
            torque_gain=torque_gain,
            signals=content.signals,
        )
    if topic is not None:
        raise RecordingError(
            f"{path}: topic {topic!r} is asked for, but only bags have topics"
        )
    want = wanted_of(path, columns or Columns(), joints)
    reader = reader_of(path)
    if log_format(path).in_pieces(path):
        _require_room(path)
    return recording_of(
        read_parts(reader, path, want.names),
        want,
        where=str(path),
        name=path.name,
        torque_gain=torque_gain,
        omit=omit,
    )


def wanted_of(path: Path, columns: Columns, joints: Sequence[str]) -> Wanted:
    """Return what is wanted of a file of arrays, in the units that it states.

    Raises
    ------
    RecordingError
        As `wanted` and `in_stated_units`.
    """
    want = wanted(columns, joints, str(path))
    if not log_format(path).states_units:
        return want
    stored = {name: stored_name(name) for name in want.names}
    said = reader_of(path).array_units(path, list(dict.fromkeys(stored.values())))
    of_names = {name: said[at] for name, at in stored.items() if at in said}
    return in_stated_units(want, of_names, str(path))


def does_not_fit(path: Path) -> str:
    """Return how a log is too large to be read as a whole; empty if it is not.

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
        f"{path}: {size / GIBIBYTE:.1f} GiB, to be read as a whole into a computer "
        f"with {room / GIBIBYTE:.1f} GiB of memory"
    )


def _require_room(path: Path) -> None:
    """Refuse a log that is too large for this computer, but can be streamed."""
    if path.exists() and (reason := does_not_fit(path)):
        raise RecordingError(
            f"{reason}; read it piece by piece: "
            "consistent-id identify PROBLEM --streamed, or consistent-id compress (in "
            "Python: stream_estimate, stream_regression); or say --large-files (in "
            "Python: with consistent_id.large_files()) if it fits after all"
        )


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
            f"{path}: columns can be found in files of {listed} alone; say which they "
            "are (--position, --torque; in Python, Columns)"
        )
    names: tuple[str, ...] = reader_of(path).array_names(path)
    return names


def reader_of(path: Path) -> Any:
    """Return the module that reads a log.

    Raises
    ------
    RecordingError
        If there is no such file, or what reads it is not installed.
    """
    known = log_format(path)
    if not path.exists():
        raise RecordingError(f"{path}: no such file")
    if not path.is_dir():
        require_regular(path, RecordingError)
    return known.reader(path)


def read_track(
    path: str | Path,
    joints: Sequence[str],
    channel: Channel,
    column: str,
    *,
    time: str = "time",
    torque_gain: ArrayLike = 1.0,
) -> Track:
    """Read what one sensor wrote into a file of its own, such as accelerations.

    Bring it to the clock of the rest with `aligned`, its delay with `estimate_delay`.

    Parameters
    ----------
    path : str or Path
        See `read_recording`.
    joints : sequence of str
    channel : {"position", "velocity", "acceleration", "torque"}
    column : str
        Name of the columns, with ``{joint}`` or ``{number}``; in SI units.
    time : str
        Name of the column of stamps.
    torque_gain : array_like, shape () or (joints,)
        Factor to torque, of a torque.

    Raises
    ------
    RecordingError
        As `read_recording`.
    """
    # A recording has a position; here it stands for whatever was written.
    columns = Columns(time, column)
    columns = replace(columns, **{channel: column})  # type: ignore[arg-type]
    recording = read_recording(path, joints, columns, torque_gain=torque_gain)
    return track(recording, channel)
