"""Arrays of an NPZ file; nothing in it is ever unpickled."""

import struct
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.columns import require
from consistent_id.recordings.readers.named_arrays import Arrays

# What zipfile and NumPy let through when a file is cut or overwritten.
_UNREADABLE = (
    zipfile.BadZipFile,
    zlib.error,
    OSError,
    EOFError,
    ValueError,
    TypeError,
    KeyError,
    RuntimeError,
    MemoryError,
    OverflowError,
    struct.error,
)


def read_arrays(path: Path, names: Sequence[str]) -> Arrays:
    """Return the named arrays.

    Raises
    ------
    RecordingError
        If the file is not NPZ, or an array is missing or holds pickled objects.
    """
    require(str(path), names, array_names(path))
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: _array(path, file, name) for name in names}
    except _UNREADABLE as cause:
        raise RecordingError(f"{path}: not readable as NPZ: {cause}") from None


def array_names(path: Path) -> tuple[str, ...]:
    """Return the names of the arrays."""
    try:
        with zipfile.ZipFile(path) as members:
            return tuple(name.removesuffix(".npy") for name in members.namelist())
    except _UNREADABLE as cause:
        raise RecordingError(f"{path}: not readable as NPZ: {cause}") from None


def _array(path: Path, file: np.lib.npyio.NpzFile, name: str) -> np.ndarray:
    try:
        array = file[name]
    except ValueError as cause:
        raise RecordingError(
            f"{path}: array {name!r} cannot be read ({cause}). Save plain arrays of "
            "numbers; pickled objects are not loaded, since they can run any code"
        ) from None
    return np.asarray(array)
