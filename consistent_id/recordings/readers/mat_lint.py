"""Whether the elements of a MATLAB 5 file hold together.

SciPy trusts the type and the length that an element says it has: on a damaged file it
may read outside of memory, which ends the interpreter.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

from consistent_id._support.inputs import require_unpacked
from consistent_id.errors import RecordingError

_MATRIX, _COMPRESSED = 14, 15
_TYPES = {*range(1, 8), 9, *range(12, 19)}
_HEADER = 128
_DEEPEST = 64  # cells and structures in one another
_SHAPE, _FLAGS = 5, 6
_SPARSE, _COMPLEX = 5, 0x0800
_CLASSES, _NUMERIC_CLASSES = range(1, 18), range(6, 16)
_NUMBERS = {*range(1, 8), 9, 12, 13}


class _Element(NamedTuple):
    kind: int
    data: memoryview


def damage(content: bytes, where: object = "file") -> str | None:
    r"""Return what is wrong with the elements of a file, None if nothing is.

    Files of version 4, which have no header, are not looked into.

    Raises
    ------
    RecordingError
        If compressed elements state much more data than the file has bytes; the
        message begins with `where`.

    Examples
    --------
    >>> damage(b" " * 124 + b"\x00\x01IM" + bytes([99, 0, 0, 0, 0, 0, 0, 0]))
    'an element is of type 99, which there is not'
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


def _walk(data: memoryview, order: str, depth: int = 0) -> None:
    if depth > _DEEPEST:
        raise ValueError(f"arrays are nested deeper than {_DEEPEST}")
    for element in _elements(data, order):
        if element.kind == _COMPRESSED:
            if depth:
                raise ValueError("a compressed element stands in another element")
            _walk(_inflated(element, order), order, depth + 1)
        elif element.kind == _MATRIX:
            _check_array(element.data, order)
            _walk(element.data, order, depth + 1)


def _inflated_size(element: _Element, order: str) -> int:
    """Return how many bytes an element says that it has when it is not compressed."""
    if element.kind != _COMPRESSED:
        return 0
    tag = zlib.decompressobj().decompress(element.data, 8)
    if len(tag) < 8:
        raise ValueError("a compressed element is cut")
    kind, length = struct.unpack(order + "II", tag)
    return 8 if kind >> 16 else 8 + int(length)


def _inflated(element: _Element, order: str) -> memoryview:
    size = _inflated_size(element, order)
    inflate = zlib.decompressobj()
    data = inflate.decompress(element.data, size)
    if len(data) < size or (
        inflate.unconsumed_tail and inflate.decompress(inflate.unconsumed_tail, 1)
    ):
        raise ValueError(f"a compressed element has not the {size} bytes that it says")
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
        raise ValueError(f"an array is of class {flags & 0xFF}, which there is not")
    if flags & 0xFF in _NUMERIC_CLASSES:
        values = parts[3:]  # after class, shape and name
        expected = 2 if flags & _COMPLEX else 1
        if len(values) != expected or any(v.kind not in _NUMBERS for v in values):
            raise ValueError(
                "an array of numbers has not the parts that it should have"
            )


def _elements(data: memoryview, order: str) -> Iterator[_Element]:
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
            raise ValueError(f"an element is of type {kind}, which there is not")
        if length > padded or begin + length > len(data):
            raise ValueError(f"an element of {length} bytes is cut")
        yield _Element(kind, data[begin : begin + length])
        start = begin + padded
