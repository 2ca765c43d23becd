"""Trajectories to files and back; the ending determines the format.

Samples are columns in CSV and Parquet, and arrays in NPZ.  Messages for ROS 2 can have
few points, which a controller joins: from positions, velocities and accelerations at
two points, ``h`` seconds apart, it computes a quintic.  The error of the quintic is at
most ``h^6 max |q^(6)| / 46080``, Hermite's remainder with both ends as triple nodes.
"""

import csv
import io
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from consistent_id._support.arrays import Vector, number
from consistent_id._support.extras import needed
from consistent_id._support.files import write_atomically
from consistent_id._support.given_values import require_type
from consistent_id.errors import ProblemError, RecordingError
from consistent_id.motion.files.document import (
    ExactPath,
    content_of,
    json_of,
    npz_of,
    path_of_json,
    path_of_npz,
    require_names,
    require_rest,
)
from consistent_id.motion.files.robot_formats import (
    CYCLES,
    franka_of,
    message_of,
    rsi_of,
    samples_of_message,
    urscript_of,
)
from consistent_id.motion.proofs.extremes import smooth_pieces
from consistent_id.recordings.joint_paths import JointPath, sampled
from consistent_id.recordings.readers import Columns, read_recording
from consistent_id.recordings.readers.recording_file import column_names
from consistent_id.recordings.recording import Recording

TRAJECTORY_COLUMNS = Columns(velocity="dq_{joint}", acceleration="ddq_{joint}")
"""Names of the columns of written trajectories: ``time``, ``q_``, ``dq_``, ``ddq_``."""


def columns_of(samples: Recording) -> dict[str, Vector]:
    """Return time, positions, velocities and accelerations by name."""
    columns = {"time": samples.time}
    channels = (samples.position, samples.velocity, samples.acceleration)
    for prefix, channel in zip(("q", "dq", "ddq"), channels, strict=True):
        if channel is not None:
            names = [f"{prefix}_{joint}" for joint in samples.joints]
            columns |= dict(zip(names, channel.T, strict=True))
    return columns


def csv_of(samples: Recording) -> str:
    """Return samples as CSV; numbers come back to the last bit."""
    columns = columns_of(samples)
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(columns)
    rows = np.column_stack(list(columns.values())).tolist()
    text.writelines(",".join(map(repr, row)) + "\n" for row in rows)
    return text.getvalue()


def parquet_of(samples: Recording) -> bytes:
    """Return samples as the content of a Parquet file."""
    pa = needed("pyarrow", "parquet", "writing Parquet")
    pq = needed("pyarrow.parquet", "parquet")
    file = io.BytesIO()
    table = pa.table(columns_of(samples))
    mark = {"generator": "consistent-id: samples of a trajectory"}
    pq.write_table(table.replace_schema_metadata(mark), file)
    return file.getvalue()


def samples_of_table(path: Path) -> Recording:
    """Return the samples in a CSV or Parquet file, of all joints that it names.

    Raises
    ------
    RecordingError
        If it cannot be read, or no joint has all of ``q_``, ``dq_`` and ``ddq_``.
    """
    names = column_names(path)
    joints = [
        name.removeprefix("q_")
        for name in names
        if name.startswith("q_") and {f"d{name}", f"dd{name}"} <= set(names)
    ]
    if not joints:
        raise RecordingError(
            f"{path}: its columns are {list(names)[:8]}, expected time and, of each "
            "joint, q_NAME, dq_NAME and ddq_NAME; use read_recording for other names"
        )
    return read_recording(path, joints, TRAJECTORY_COLUMNS)


Format = Literal["json", "npz", "csv", "parquet", "ros", "urscript", "rsi", "franka"]
FORMAT_OF_ENDING: dict[str, Format] = {
    ".json": "json",
    ".npz": "npz",
    ".csv": "csv",
    ".parquet": "parquet",
    ".yaml": "ros",
    ".yml": "ros",
    ".script": "urscript",
    ".urscript": "urscript",
    ".rsi": "rsi",
    ".franka": "franka",
}
"""Format of each ending."""

_OF_CONTROLLERS = {"urscript": urscript_of, "rsi": rsi_of, "franka": franka_of}

_REMAINDER = 720.0 * 2.0**6
"""Denominator of the remainder: ``((t - a) (b - t))^3 / 6!`` is at most
``(h / 2)^6 / 6!``.
"""
_LEAST = 1e-6  # rad or m; messages round times to nanoseconds


class _Probe(msgspec.Struct):
    """The keys that distinguish kinds of JSON."""

    format: str | None = None
    joint_names: list[str] | None = None


def write_trajectory(
    path: ExactPath,
    file: str | Path,
    *,
    rate: float | None = None,
    tolerance: float | None = None,
    format: Format | None = None,
) -> Path:
    """Write a trajectory, whole or not at all; return the file.

    Parameters
    ----------
    path : FourierTrajectory, PolynomialPath or Move
    file : str or Path
    rate : float, [Hz]
        Rate of the samples; only ``json`` needs none.
    tolerance : float, [rad or m]
        For ``ros``, instead of the rate: as few points as possible, see `thinned`.
    format : str, optional
        By default that of the file's ending:

        - ``json`` (``.json``): exact coefficients;
        - ``npz`` (``.npz``): exact coefficients, and samples;
        - ``csv``, ``parquet``: samples; see `TRAJECTORY_COLUMNS`;
        - ``ros`` (``.yaml``, ``.yml``): a ``trajectory_msgs/JointTrajectory``, in YAML
          that is also JSON;
        - ``urscript`` (``.script``, ``.urscript``): a program for a Universal Robot, at
          125 or 500 Hz;
        - ``rsi`` (``.rsi``): axis angles [degrees] for KUKA RSI, at 250 or 83.3 Hz;
        - ``franka`` (``.franka``): joint positions for libfranka, at 1000 Hz.

    Raises
    ------
    ProblemError
        If the ending is unknown, the rate is missing or wrong, or the file cannot be
        written.  Formats for robots require a motion from rest to rest.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from consistent_id.recordings import FourierTrajectory
    >>> path = FourierTrajectory(("elbow",), [0.5], [0.1], [[0.2]], [[0.0]], 2.0)
    >>> with TemporaryDirectory() as folder:
    ...     file = write_trajectory(path, f"{folder}/path.json")
    ...     again = read_trajectory(file)
    >>> again.sine.tolist()
    [[0.2]]
    """
    require_type(path, JointPath, "path")
    file = Path(file)
    chosen = format or _format_of(file)
    if chosen not in FORMAT_OF_ENDING.values():
        known = ", ".join(dict.fromkeys(FORMAT_OF_ENDING.values()))
        raise ProblemError(f"{file}: format {chosen!r}, expected one of {known}")
    require_names(path.joints, file)
    if chosen == "json":
        return write_atomically(file, json_of(path))
    if tolerance is not None:
        if chosen != "ros":
            raise ProblemError(
                f"{file}: only ROS messages are thinned to a tolerance; give a rate"
            )
        require_rest(path, file)
        return write_atomically(file, message_of(thinned(path, tolerance)))
    if rate is None:
        raise ProblemError(f"{file}: samples of a trajectory; give their rate [Hz]")
    return write_atomically(file, _content(path, file, rate, chosen))


def _content(path: ExactPath, file: Path, rate: float, chosen: Format) -> str | bytes:
    if chosen == "ros" or chosen in CYCLES:
        require_rest(path, file)
    if chosen in _OF_CONTROLLERS:
        return _OF_CONTROLLERS[chosen](path, rate, file)
    samples = sampled(path, rate)
    if chosen == "npz":
        return npz_of(path, columns_of(samples))
    if chosen == "csv":
        return csv_of(samples)
    return parquet_of(samples) if chosen == "parquet" else message_of(samples)


def read_trajectory(file: str | Path) -> ExactPath | Recording:
    """Read a file of `write_trajectory`, or any ROS trajectory.

    Parameters
    ----------
    file : str or Path
        ``.json``, ``.npz``, ``.csv``, ``.parquet``, ``.yaml`` or ``.yml``.

    Returns
    -------
    FourierTrajectory, PolynomialPath or Move
        Equal to the last bit, for files with coefficients.
    Recording
        For files with only samples.

    Raises
    ------
    ProblemError, RecordingError
        If the file cannot be read; with the key, or the row and column, of the fault.
        Nothing in it is run or unpickled.
    """
    file = Path(file)
    chosen = _format_of(file)
    if chosen in CYCLES:
        raise ProblemError(
            f"{file}: a program or table of a controller is not read back; write the "
            "trajectory as .json besides"
        )
    if chosen == "npz":
        return path_of_npz(file)
    if chosen in ("csv", "parquet"):
        return samples_of_table(file)
    content = content_of(file)
    if chosen == "ros" or _is_message(content):
        return samples_of_message(content, file)
    return path_of_json(content, file)


def _is_message(content: bytes) -> bool:
    try:
        probe = msgspec.json.decode(content, type=_Probe)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return False
    return probe.format is None and probe.joint_names is not None


def _format_of(file: Path) -> Format:
    if file.suffix.lower() not in FORMAT_OF_ENDING:
        raise ProblemError(
            f"{file}: {file.suffix or 'no ending'}, expected one of "
            f"{', '.join(FORMAT_OF_ENDING)}"
        )
    return FORMAT_OF_ENDING[file.suffix.lower()]


def thinned(path: JointPath, tolerance: float, name: str = "trajectory") -> Recording:
    """Return points between which quintics follow a path within a tolerance.

    In each smooth piece they have equal steps; points are also at the junctions of
    pieces.  A quintic, such as a run-in, needs only its two ends.

    Parameters
    ----------
    tolerance : float, [rad or m]
        Largest error of a joint at any time, proven by a bound of the path's sixth
        derivative.

    Raises
    ------
    ProblemError
        If the tolerance is below a millionth.

    Examples
    --------
    >>> from consistent_id.motion.bernstein import PolynomialPath
    >>> quintic = [[0.0], [0.0], [0.0], [1.0], [1.0], [1.0]]
    >>> thinned(PolynomialPath(("elbow",), quintic, duration=2.0), 1e-4).time.tolist()
    [0.0, 2.0]
    """
    if not _LEAST <= number(tolerance, "tolerance") < np.inf:
        raise ProblemError(
            f"tolerance is {tolerance} rad or m, expected {_LEAST:g} or more"
        )
    times = [np.array([path.start])]
    for piece in smooth_pieces(path):
        times.append(piece.start + _steps(piece, tolerance))
    time = np.concatenate(times)
    q, dq, ddq = path.evaluate(time)
    return Recording(path.joints, time, q, dq, ddq, name=name)


def _steps(piece: JointPath, tolerance: float) -> Vector:
    """Return the times of the points after the first, since the piece's start."""
    bend = float(piece.derivative_bound(6).max())
    longest = (_REMAINDER * tolerance / bend) ** (1.0 / 6.0) if bend > 0.0 else np.inf
    count = max(1, int(np.ceil(piece.duration / longest)))
    return np.asarray(piece.duration * np.arange(1, count + 1) / count)
