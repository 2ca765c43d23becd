"""Arrays of an NPZ file, or the columns of an NPY file; nothing is ever unpickled.

Columns of a plain two-dimensional array are called ``column1``, ``column2`` and so on,
those of a structured one by their fields.
"""

import math
import struct
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import IO

import numpy as np

from consistent_id._support.files import require_unpacked
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.columns import require
from consistent_id.recordings.readers.named_arrays import Arrays

_SINGLE = ".npy"

# Exceptions of zipfile and NumPy for files that are cut or overwritten.
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
        If the file is not NPZ, or an array is missing or contains pickled objects.
    """
    if path.suffix.lower() == _SINGLE:
        columns = _columns(path)
        require(str(path), names, tuple(columns))
        return {name: columns[name] for name in names}
    require(str(path), names, array_names(path))
    try:
        _require_sizes(path, names)
        with np.load(path, allow_pickle=False) as file:
            return {name: _array(path, file, name) for name in names}
    except _UNREADABLE as cause:
        raise RecordingError(f"{path}: not readable as NPZ: {cause}") from None


def array_names(path: Path) -> tuple[str, ...]:
    """Return the names of the arrays."""
    if path.suffix.lower() == _SINGLE:
        return tuple(_columns(path))
    try:
        with zipfile.ZipFile(path) as members:
            return tuple(name.removesuffix(".npy") for name in members.namelist())
    except _UNREADABLE as cause:
        raise RecordingError(f"{path}: not readable as NPZ: {cause}") from None


def _columns(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a file with one array; the longer axis is that of time."""
    try:
        whole = np.load(path, mmap_mode="r", allow_pickle=False)
    except _UNREADABLE as cause:
        raise RecordingError(f"{path}: not readable as NPY: {cause}") from None
    if whole.dtype.names:
        return {name: np.asarray(whole[name]) for name in whole.dtype.names}
    if whole.ndim != 2 or whole.dtype.kind not in "iuf":
        raise RecordingError(
            f"{path}: one array of {whole.dtype} with shape {whole.shape}, expected "
            "numbers in rows and columns; numpy.savez keeps several arrays by name"
        )
    upright = whole if whole.shape[0] >= whole.shape[1] else whole.T
    return {f"column{k}": np.asarray(c) for k, c in enumerate(upright.T, start=1)}


def _require_sizes(path: Path, names: Sequence[str]) -> None:
    """Refuse arrays with wrong stated sizes, or with sizes beyond the file."""
    unpacked = 0
    with zipfile.ZipFile(path) as members:
        known = {name.removesuffix(".npy"): name for name in members.namelist()}
        for name in names:
            member = members.getinfo(known[name])
            try:
                with members.open(member) as file:
                    shape, kind, begin = _stated(file)
            except ValueError as cause:
                raise _unread(path, name, cause) from None
            entries, data = math.prod(shape), member.file_size - begin
            if entries * kind.itemsize != data and not kind.hasobject:
                raise RecordingError(
                    f"{path}: array {name!r} states shape {shape} of {kind}, "
                    f"{entries * kind.itemsize} bytes, but has {data}; save it again"
                )
            unpacked += max(8 * entries, member.file_size)
    require_unpacked(path, unpacked, path.stat().st_size, RecordingError)


def _stated(file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype, int]:
    """Return the shape, the type and the place of an array's data."""
    version = np.lib.format.read_magic(file)
    form = np.lib.format
    old = version == (1, 0)
    read = form.read_array_header_1_0 if old else form.read_array_header_2_0
    shape, _, kind = read(file)
    return shape, kind, file.tell()


def _array(path: Path, file: np.lib.npyio.NpzFile, name: str) -> np.ndarray:
    try:
        array = file[name]
    except ValueError as cause:
        raise _unread(path, name, cause) from None
    return np.asarray(array)


def _unread(path: Path, name: str, cause: ValueError) -> RecordingError:
    return RecordingError(
        f"{path}: array {name!r} cannot be read ({cause}). Save plain arrays of "
        "numbers, and names as names.astype(str); pickled objects are not loaded, "
        "since they can run any code"
    )
