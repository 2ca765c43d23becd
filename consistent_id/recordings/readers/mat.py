"""Variables of a MATLAB file; fields of structures by paths such as ``log.q``."""

import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from consistent_id.errors import RecordingError
from consistent_id.recordings.log_formats import HDF5
from consistent_id.recordings.readers.mat_lint import damage
from consistent_id.recordings.readers.named_arrays import Arrays
from consistent_id.robot.parameters import require_known

_HDF5 = b"\x89HDF\r\n\x1a\n"
# What SciPy lets through when a file is cut or overwritten.
_UNREADABLE = (
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    OSError,
    EOFError,
    NotImplementedError,
    OverflowError,
    MemoryError,
    struct.error,
    zlib.error,
    UserWarning,
)


def read_arrays(path: Path, names: Sequence[str]) -> Arrays:
    """Return the named variables of a file of any version.

    Raises
    ------
    RecordingError
        If the file is not MATLAB's, or a name is missing or no array of numbers.
    """
    if in_pieces(path):
        arrays: Arrays = HDF5.reader(path).read_matlab_73(path, names)
        return arrays
    if fault := damage(path.read_bytes(), path):
        raise RecordingError(f"{path}: not readable as MATLAB file: {fault}")
    variables = _loaded(path, [name.replace("/", ".").split(".")[0] for name in names])
    return {name: _field(path, variables, name) for name in names}


def in_pieces(path: Path) -> bool:
    """Return whether a file is of MATLAB 7.3, which can be read piece by piece."""
    with path.open("rb") as file:
        start = file.read(520)
    return _HDF5 in (start[:8], start[512:])


def read_batches(path: Path, names: Sequence[str], first: int) -> Iterator[Arrays]:
    """Yield the named variables from a sample on, a few samples at a time.

    Raises
    ------
    RecordingError
        If the file is not of MATLAB 7.3; else as `read_arrays`.
    """
    if not in_pieces(path):
        raise RecordingError(
            f"{path}: MATLAB files before version 7.3 cannot be read piece by piece; "
            "save with '-v7.3'"
        )
    places = {name.replace(".", "/"): name for name in names}
    for batch in HDF5.reader(path).read_batches(path, list(places), first):
        yield {places[place]: values for place, values in batch.items()}


def _loaded(path: Path, names: Sequence[str]) -> dict[str, Any]:
    import warnings

    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatReadError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            known = [name for name, _, _ in whosmat(path)]
            require_known(names, known, f"{path}: no variable", RecordingError)
            return dict(loadmat(path, variable_names=list(names)))
    except (MatReadError, *_UNREADABLE) as cause:
        raise RecordingError(f"{path}: not readable as MATLAB file: {cause}") from None


def _field(path: Path, variables: dict[str, Any], name: str) -> NDArray[Any]:
    first, *fields = name.replace("/", ".").split(".")
    value, seen = variables[first], first
    for field in fields:
        known = getattr(getattr(value, "dtype", None), "names", None) or ()
        require_known([field], known, f"{path}: {seen!r} has no field", RecordingError)
        if value.size != 1:
            raise RecordingError(
                f"{path}: {seen!r} is an array of {value.size} structures, expected one"
            )
        value, seen = value[field].reshape(-1)[0], f"{seen}.{field}"
    if not isinstance(value, np.ndarray) or value.dtype.names or value.dtype.hasobject:
        raise RecordingError(
            f"{path}: {seen!r} is no array of numbers. Save structures' fields, tables "
            "and timeseries as such arrays"
        )
    return value
