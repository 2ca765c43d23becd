"""Variables of a MATLAB file; fields of structures by paths such as ``log.q``.

SciPy trusts the stated type and length of an element: for a damaged file it may read
outside of memory, which crashes the interpreter.  So `_damage` first checks whether the
elements of the file are consistent.
"""

import math
import re
import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from consistent_id._support.files import require_unpacked
from consistent_id.errors import RecordingError
from consistent_id.recordings.log_formats import HDF5
from consistent_id.recordings.readers.named_arrays import Arrays
from consistent_id.robot.parameters import require_known

_HDF5 = b"\x89HDF\r\n\x1a\n"
# Exceptions of SciPy for files that are cut or overwritten.
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

_MOST_STRUCTURES = 100  # of an array, of which each has its arrays; more are samples
_MOST_ITEMS = 100  # of a sample's value
_MATRIX, _COMPRESSED = 14, 15
_TYPES = {*range(1, 8), 9, *range(12, 19)}
_HEADER = 128
_DEEPEST = 64  # most levels of nested cells and structures
_SHAPE, _FLAGS = 5, 6
_SPARSE, _COMPLEX = 5, 0x0800
_CLASSES, _NUMERIC_CLASSES = range(1, 18), range(6, 16)
_NUMBERS = {*range(1, 8), 9, 12, 13}


def read_arrays(path: Path, names: Sequence[str]) -> Arrays:
    """Return the named variables of a file of any version.

    Raises
    ------
    RecordingError
        If the file is not MATLAB's, or a name is missing or not an array of numbers.
    """
    if in_pieces(path):
        arrays: Arrays = HDF5.reader(path).read_matlab_73(path, names)
        return arrays
    if fault := _damage(path.read_bytes(), path):
        raise RecordingError(f"{path}: not readable as MATLAB file: {fault}")
    first = [_variable(name.replace("/", ".").split(".")[0]) for name in names]
    variables = _loaded(path, first)
    return {name: _field(path, variables, name) for name in names}


def array_names(path: Path) -> tuple[str, ...]:
    """Return the names of arrays of numbers and of lists of texts.

    Those in single structures have their path as name.

    Raises
    ------
    RecordingError
        If the file is not MATLAB's.
    """
    if in_pieces(path):
        inside: tuple[str, ...] = HDF5.reader(path).array_names(path)
        return tuple(name.replace("/", ".") for name in inside)
    if fault := _damage(path.read_bytes(), path):
        raise RecordingError(f"{path}: not readable as MATLAB file: {fault}")
    variables = _loaded(path, None).items()
    every = (_inside(n, v) for n, v in variables if not n.startswith("__"))
    return tuple(name for names in every for name in names)


def _inside(name: str, value: Any) -> list[str]:
    """Return the names of the arrays of numbers in a value, perhaps a structure."""
    value = _structures(value)
    fields = getattr(getattr(value, "dtype", None), "names", None)
    if fields and value.size > _MOST_STRUCTURES:
        rows = {field: _side_by_side(value[field]) for field in fields}
        return [n for field in fields for n in _inside(f"{name}.{field}", rows[field])]
    if fields and 1 <= value.size <= _MOST_STRUCTURES:
        parts = [name] if value.size == 1 else [f"{name}({k})" for k in _keys(value)]
        return [
            inner
            for part, one in zip(parts, value.reshape(-1), strict=True)
            for field in fields
            for inner in _inside(f"{part}.{field}", one[field])
        ]
    numeric = isinstance(value, np.ndarray) and value.dtype.kind in "iufb"
    return [name] if numeric or len(_texts(value)) > 1 else []


def _structures(value: Any) -> Any:
    """Return the structures in cells as an array of them; other values as they are."""
    if not isinstance(value, np.ndarray) or value.dtype != object or not value.size:
        return value
    cells = [np.asarray(cell) for cell in value.reshape(-1)]
    fields = cells[0].dtype.names
    alike = all(c.dtype.names == fields and c.size == 1 for c in cells)
    return np.concatenate([c.reshape(-1) for c in cells]) if fields and alike else value


def _side_by_side(cells: NDArray[Any]) -> NDArray[Any]:
    """Return a field of a structure for each sample as an array with a row for each.

    As it is, if it is not of the same kind and size in all.
    """
    found = _structures(cells)
    if found.dtype.names:
        return np.asarray(found)
    each = [np.asarray(cell).reshape(-1) for cell in cells.reshape(-1)]
    # Longer values are runs, not samples.
    numeric = all(one.dtype.kind in "iufb" and one.size <= _MOST_ITEMS for one in each)
    if not numeric or len({one.size for one in each}) != 1:
        return cells
    rows = np.stack(each)
    return rows[:, 0] if rows.shape[1] == 1 else rows


def _keys(structures: Any) -> list[str]:
    """Return the labels of structures, as of the signals of Simulink; or numbers."""
    said = list[str]()
    for field in ("label", "name", "blockName"):
        if field in structures.dtype.names and not said:
            each = [
                np.asarray(one[field]).reshape(-1) for one in structures.reshape(-1)
            ]
            said = [str(t[0]) for t in each if len(t) == 1 and t.dtype.kind == "U"]
    distinct = len({*said}) == structures.size
    if distinct and all(re.fullmatch(r"\w+", label) for label in said):
        return said
    return [str(k) for k in range(1, structures.size + 1)]


def labels(path: Path, name: str) -> tuple[str, ...]:
    """Return the texts of a cell array or of the rows of a char array; else none."""
    if in_pieces(path):
        found: tuple[str, ...] = HDF5.reader(path).matlab_texts(path, name)
        return found
    if fault := _damage(path.read_bytes(), path):
        raise RecordingError(f"{path}: not readable as MATLAB file: {fault}")
    first, *_ = name.split(".")
    return _texts(_value(path, _loaded(path, [_variable(first)]), name))


def _texts(value: Any) -> tuple[str, ...]:
    """Return the texts of a list of them, without the blanks that fill char arrays."""
    if not isinstance(value, np.ndarray):
        return ()
    cells = value.reshape(-1)
    if value.dtype.kind == "O":
        inner = [np.asarray(cell).reshape(-1) for cell in cells]
        texts = [c[0] for c in inner if len(c) == 1 and c.dtype.kind == "U"]
    else:
        texts = list(cells) if value.dtype.kind == "U" else []
    return tuple(str(t).strip() for t in texts) if len(texts) == value.size else ()


def in_pieces(path: Path) -> bool:
    """Return whether a file is of MATLAB 7.3, which can be read piece by piece."""
    with path.open("rb") as file:
        start = file.read(520)
    return _HDF5 in (start[:8], start[512:])


def read_batches(path: Path, names: Sequence[str], first: int) -> Iterator[Arrays]:
    """Yield the named variables from a sample on, in pieces.

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


def _loaded(path: Path, names: Sequence[str] | None) -> dict[str, Any]:
    """Return the named variables, or all."""
    import warnings

    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatReadError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            known = [name for name, _, _ in whosmat(path)]
            wanted = known if names is None else list(names)
            require_known(wanted, known, f"{path}: no variable", RecordingError)
            return dict(loadmat(path, variable_names=wanted))
    except (MatReadError, *_UNREADABLE) as cause:
        raise RecordingError(f"{path}: not readable as MATLAB file: {cause}") from None


def _field(path: Path, variables: dict[str, Any], name: str) -> NDArray[Any]:
    value = _value(path, variables, name)
    if not isinstance(value, np.ndarray) or value.dtype.names or value.dtype.hasobject:
        raise RecordingError(
            f"{path}: {name.replace('/', '.')!r} is not an array of numbers. Save "
            "structures' fields, tables and timeseries as such arrays"
        )
    return value


def _value(path: Path, variables: dict[str, Any], name: str) -> Any:
    """Return a variable, or a field of structures, of arrays of them by their key."""
    first, *parts = name.replace("/", ".").split(".")
    seen = _variable(first)
    value = _one_of(_structures(variables[seen]), first)
    for part in parts:
        field = _variable(part)
        known = getattr(getattr(value, "dtype", None), "names", None) or ()
        require_known([field], known, f"{path}: {seen!r} has no field", RecordingError)
        if value.size > _MOST_STRUCTURES:
            value, seen = _side_by_side(value[field]), f"{seen}.{part}"
            continue
        if value.size != 1:
            raise RecordingError(
                f"{path}: {seen!r} is an array of {value.size} structures, expected one"
            )
        value = _one_of(_structures(value[field].reshape(-1)[0]), part)
        seen = f"{seen}.{part}"
    return value


def _variable(part: str) -> str:
    """Return the name in a part of a path, without the key of a structure."""
    return part.partition("(")[0]


def _one_of(value: Any, part: str) -> Any:
    """Return the structure of an array with the key in a part; else the value."""
    key = part.partition("(")[2].removesuffix(")")
    if not key or getattr(getattr(value, "dtype", None), "names", None) is None:
        return value
    keys = _keys(value)
    return value.reshape(-1)[keys.index(key)].reshape(-1) if key in keys else value


def _damage(content: bytes, where: object = "file") -> str | None:
    r"""Return the fault of the elements of a file, None without one.

    Files of version 4, which have no header, are not checked.

    Raises
    ------
    RecordingError
        If compressed elements state much more data than the file has bytes; the
        message begins with `where`.

    Examples
    --------
    >>> _damage(b" " * 124 + b"\x00\x01IM" + bytes([99, 0, 0, 0, 0, 0, 0, 0]))
    'an element is of type 99, which does not exist'
    """
    mark = content[126:128]
    if 0 in content[:4] or mark not in (b"IM", b"MI"):
        return None
    order = "<" if mark == b"IM" else ">"
    data = memoryview(content)[_HEADER:]
    try:
        # An entry of one byte may become a number of eight.
        unpacked = 8 * sum(_inflated_size(e, order) for e in _elements(data, order))
        require_unpacked(where, unpacked, len(content), RecordingError)
        _walk(data, order)
    except (ValueError, zlib.error) as cause:
        return str(cause)
    return None


class _MatElement(NamedTuple):
    kind: int
    data: memoryview


def _walk(data: memoryview, order: str, depth: int = 0) -> None:
    if depth > _DEEPEST:
        raise ValueError(f"arrays are nested deeper than {_DEEPEST}")
    for element in _elements(data, order):
        if element.kind == _COMPRESSED:
            if depth:
                raise ValueError("a compressed element is inside another element")
            _walk(_inflated(element, order), order, depth + 1)
        elif element.kind == _MATRIX:
            _check_array(element.data, order)
            _walk(element.data, order, depth + 1)


def _inflated_size(element: _MatElement, order: str) -> int:
    """Return the stated number of bytes of an uncompressed element."""
    if element.kind != _COMPRESSED:
        return 0
    tag = zlib.decompressobj().decompress(element.data, 8)
    if len(tag) < 8:
        raise ValueError("a compressed element is cut")
    kind, length = struct.unpack(order + "II", tag)
    return 8 if kind >> 16 else 8 + int(length)


def _inflated(element: _MatElement, order: str) -> memoryview:
    size = _inflated_size(element, order)
    inflate = zlib.decompressobj()
    data = inflate.decompress(element.data, size)
    if len(data) < size or (
        inflate.unconsumed_tail and inflate.decompress(inflate.unconsumed_tail, 1)
    ):
        raise ValueError(f"a compressed element does not have its stated {size} bytes")
    return memoryview(data)


def _check_array(matrix: memoryview, order: str) -> None:
    """Refuse more entries than there are bytes, and numbers without their parts."""
    parts = list(_elements(matrix, order))
    if not parts:
        return  # an empty cell
    if parts[0].kind != _FLAGS or len(parts[0].data) != 8:
        raise ValueError("an array begins without its class")
    if len(parts) < 2 or parts[1].kind != _SHAPE or len(parts[1].data) % 4:
        raise ValueError("an array has no shape")
    (flags,) = struct.unpack_from(order + "I", parts[0].data)
    shape = struct.unpack(f"{order}{len(parts[1].data) // 4}i", parts[1].data)
    entries = math.prod(shape)
    if flags & 0xFF != _SPARSE and (
        min(shape, default=-1) < 0 or entries > len(matrix)
    ):
        raise ValueError(f"an array of shape {shape} has {len(matrix)} bytes")
    if flags & 0xFF not in _CLASSES:
        raise ValueError(f"an array is of class {flags & 0xFF}, which does not exist")
    if flags & 0xFF in _NUMERIC_CLASSES:
        values = parts[3:]  # after class, shape and name
        expected = 2 if flags & _COMPLEX else 1
        if len(values) != expected or any(v.kind not in _NUMBERS for v in values):
            raise ValueError("an array of numbers does not have its expected parts")


def _elements(data: memoryview, order: str) -> Iterator[_MatElement]:
    start = 0
    while start < len(data):
        if len(data) - start < 8:
            raise ValueError("an element is cut")
        kind, length = struct.unpack_from(order + "II", data, start)
        begin, padded = (
            start + 8,
            length if kind == _COMPRESSED else -(-length // 8) * 8,
        )
        if kind >> 16:  # up to four bytes are packed into the tag
            kind, length, begin, padded = kind & 0xFFFF, kind >> 16, start + 4, 4
        if kind not in _TYPES:
            raise ValueError(f"an element is of type {kind}, which does not exist")
        if length > padded or begin + length > len(data):
            raise ValueError(f"an element of {length} bytes is cut")
        yield _MatElement(kind, data[begin : begin + length])
        start = begin + padded
