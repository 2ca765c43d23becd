"""Recordings from files: the ending, and where it leaves doubt the content, decide."""

from collections.abc import Callable, Sequence
from pathlib import Path

from numpy.typing import ArrayLike

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.arrays import Arrays, recording_of
from consistent_id.recordings.readers.bag import BAGS, read_bag
from consistent_id.recordings.readers.columns import JOINT_STATE, Columns, wanted
from consistent_id.recordings.readers.csv import read_csv
from consistent_id.recordings.readers.hdf5 import read_hdf5
from consistent_id.recordings.readers.mat import read_mat
from consistent_id.recordings.readers.npz import read_npz
from consistent_id.recordings.readers.parquet import read_parquet
from consistent_id.recordings.recording import Recording

_READERS: dict[str, Callable[[Path, Sequence[str]], Arrays]] = {
    ".csv": read_csv,
    ".tsv": read_csv,
    ".parquet": read_parquet,
    ".npz": read_npz,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".mat": read_mat,
}


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
        ``.csv`` and ``.tsv`` (comma, semicolon or tab; a decimal comma where the comma
        does not separate), ``.parquet``, ``.npz``, ``.h5`` and ``.hdf5``, ``.mat``;
        of bags with ``sensor_msgs/JointState`` a folder, ``.mcap``, ``.db3``, ``.bag``.
    joints : sequence of str
        Names of the joints to read.
    columns : Columns
        Names of the columns, in SI units (s, rad, m, N m, N); by default
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
    if path.is_dir() or path.suffix.lower() in BAGS:
        if len(omit):
            raise RecordingError(
                f"{path}: omit counts the rows of tables; messages of bags have none"
            )
        columns = columns or JOINT_STATE
        return read_bag(path, joints, columns, torque_gain=torque_gain, topic=topic)
    if topic is not None:
        raise RecordingError(
            f"{path}: topic {topic!r} is asked for, but only bags have topics"
        )
    want = wanted(columns or Columns(), joints, str(path))
    arrays = _reader(path)(path, want.names)
    return recording_of(
        arrays,
        want,
        where=str(path),
        name=path.name,
        torque_gain=torque_gain,
        omit=omit,
    )


def _reader(path: Path) -> Callable[[Path, Sequence[str]], Arrays]:
    if path.suffix.lower() not in _READERS:
        raise RecordingError(
            f"{path}: cannot read {path.suffix or 'files without an ending'}, "
            f"expected {', '.join(_READERS)}, {', '.join(BAGS)} or a bag's folder"
        )
    if not path.is_file():
        raise RecordingError(f"{path}: no such file")
    return _READERS[path.suffix.lower()]
