"""Samples of a trajectory as columns: CSV, Parquet, and the arrays of NPZ."""

import csv
import io
from pathlib import Path

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers import Columns, read_recording
from consistent_id.recordings.readers.recording_file import column_names
from consistent_id.recordings.recording import Recording

TRAJECTORY_COLUMNS = Columns(velocity="dq_{joint}", acceleration="ddq_{joint}")
"""How written trajectories name their columns: ``time``, ``q_``, ``dq_``, ``ddq_``."""


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
    import pyarrow as pa
    import pyarrow.parquet as pq

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
