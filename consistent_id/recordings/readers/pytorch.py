"""Tensors of a file of ``torch.save``: a tensor, or dictionaries of them.

PyTorch is not needed, and nothing is unpickled: the list of operations in the file is
read, and those that build tensors, dictionaries, lists and plain values are followed.
Any other one is an error.
"""

import pickletools
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from consistent_id._support.files import require_unpacked
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.columns import require
from consistent_id.recordings.readers.named_arrays import Arrays

_TYPES = {
    "DoubleStorage": "f8",
    "FloatStorage": "f4",
    "HalfStorage": "f2",
    "LongStorage": "i8",
    "IntStorage": "i4",
    "ShortStorage": "i2",
    "CharStorage": "i1",
    "ByteStorage": "u1",
    "BoolStorage": "?",
}
_WHOLE = "tensor"  # the name of a file's only tensor
_DEEPEST = 16  # dictionaries in dictionaries
_LONGEST = 1000  # characters of a tensor's path
_SHARED = 4  # values, of dictionaries that stand in several places too, per byte
_MOST_AXES = 32
# Exceptions of zipfile and pickletools for files that are cut or overwritten.
_UNREADABLE = (
    zipfile.BadZipFile,
    zlib.error,
    OSError,
    EOFError,
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    RuntimeError,
    MemoryError,
    OverflowError,
    RecursionError,
    UnicodeDecodeError,
)


def read_arrays(path: Path, names: Sequence[str]) -> Arrays:
    """Return the named tensors; those in dictionaries are named by their path.

    Raises
    ------
    RecordingError
        If the file is not PyTorch's, or there is no such tensor.
    """
    tensors = _tensors(path)
    require(str(path), names, tuple(tensors))
    return {name: tensors[name] for name in names}


def array_names(path: Path) -> tuple[str, ...]:
    """Return the names of the tensors."""
    return tuple(_tensors(path))


def _tensors(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with zipfile.ZipFile(path) as members:
            sizes = sum(member.file_size for member in members.infolist())
            require_unpacked(path, sizes, path.stat().st_size, RecordingError)
            every = members.namelist()
            pickled = next((n for n in every if n.endswith("/data.pkl")), None)
            if pickled is None:
                raise RecordingError(f"{path}: holds no data.pkl, as torch.save writes")
            folder = pickled.removesuffix("data.pkl")
            order = f"{folder}byteorder"
            if order in every and members.read(order) != b"little":
                raise RecordingError(
                    f"{path}: saved on a machine with big-endian numbers"
                )
            operations = members.read(pickled)
            content = _TensorReading(path, members, folder).value(operations)
            return _named(content, _SHARED * len(operations))
    except _UNREADABLE as cause:
        raise RecordingError(
            f"{path}: not readable as tensors of torch.save ({cause}). Save a "
            "dictionary of tensors, or an NPZ file (numpy.savez)"
        ) from None


def _named(content: Any, most: int) -> dict[str, NDArray[Any]]:
    """Return the tensors in a value by their paths.

    Dictionaries of dictionaries that stand in several places would make much of little:
    no more than so many values are looked at.
    """
    found: dict[str, NDArray[Any]] = {}
    for count, (name, value) in enumerate(_inside("", content)):
        if count > most or len(name) > _LONGEST:
            raise ValueError("its dictionaries contain each other too often")
        if isinstance(value, np.ndarray):
            found[name or _WHOLE] = value
    return found


def _inside(name: str, value: Any, depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Yield a value and all in it, with their paths."""
    yield name, value
    if depth > _DEEPEST or not isinstance(value, dict | list | tuple):
        return
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in items:
        yield from _inside(f"{name}.{key}" if name else str(key), inner, depth + 1)


@dataclass(frozen=True, slots=True)
class _GlobalName:
    """The name of a class or a function; it stands for itself and is never called."""

    module: str
    name: str

    def __str__(self) -> str:
        return f"{self.module}.{self.name}"


_TENSOR = _GlobalName("torch._utils", "_rebuild_tensor_v2")
_ORDERED = _GlobalName("collections", "OrderedDict")
_SIZE = _GlobalName("torch", "Size")
_MARK = object()
_EMPTY = {"EMPTY_DICT": dict, "EMPTY_LIST": list, "EMPTY_TUPLE": tuple}
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_PLAIN = (
    *("BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"),
    *("BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT"),
)
_TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
_KEPT = ("BINPUT", "LONG_BINPUT")
_FETCHED = ("BINGET", "LONG_BINGET")


@dataclass
class _TensorReading:
    """The value that the operations of a file build, on a stack.

    Parameters
    ----------
    path : Path
    members : zipfile.ZipFile
    folder : str
        Folder of the archive's members, with a slash.
    size : int, [bytes]
        Size of all tensors so far.
    """

    path: Path
    members: zipfile.ZipFile
    folder: str
    size: int = 0
    storages: dict[str, bytes] = field(default_factory=dict)
    stack: list[Any] = field(default_factory=list)
    memo: dict[int, Any] = field(default_factory=dict)

    def value(self, operations: bytes) -> Any:
        """Return the value that operations build."""
        for operation, argument, _ in pickletools.genops(operations):
            if operation.name == "STOP":
                break
            self._follow(operation.name, argument)
        return self.stack.pop()

    def _follow(self, name: str, argument: Any) -> None:
        """Follow one operation."""
        stack = self.stack
        if name in _EMPTY:
            stack.append(_EMPTY[name]())
        elif name in _CONSTANTS:
            stack.append(_CONSTANTS[name])
        elif name in _PLAIN:
            stack.append(argument)
        elif name == "MARK":
            stack.append(_MARK)
        elif name == "GLOBAL":
            stack.append(_GlobalName(*argument.split(" ", 1)))
        elif name in _KEPT:
            self.memo[argument] = stack[-1]
        elif name in _FETCHED:
            stack.append(self.memo[argument])
        elif name in _TUPLES:
            stack[-_TUPLES[name] :] = [tuple(stack[-_TUPLES[name] :])]
        elif name == "TUPLE":
            stack.append(tuple(self._marked()))
        elif name in ("APPEND", "APPENDS"):
            added = [stack.pop()] if name == "APPEND" else self._marked()
            stack[-1].extend(added)
        elif name in ("SETITEM", "SETITEMS"):
            added = (
                [stack.pop(-2), stack.pop()] if name == "SETITEM" else self._marked()
            )
            if not all(isinstance(key, str | int | float) for key in added[::2]):
                raise ValueError("it holds a key that is no name or number")
            stack[-1].update(zip(added[::2], added[1::2], strict=True))
        elif name == "BINPERSID":
            stack.append(self._storage(*stack.pop()))
        elif name == "REDUCE":
            arguments, called = stack.pop(), stack.pop()
            stack.append(self._built(called, arguments))
        elif name != "PROTO":
            raise ValueError(f"it holds the operation {name}")

    def _marked(self) -> list[Any]:
        """Return the values on the stack after the last mark, and remove them."""
        found: list[Any] = []
        while (value := self.stack.pop()) is not _MARK:
            found.append(value)
        return found[::-1]

    def _built(self, called: Any, arguments: tuple[Any, ...]) -> Any:
        if called == _TENSOR:
            return self._tensor(*arguments[:4])
        if called == _SIZE and len(arguments) == 1 and isinstance(arguments[0], tuple):
            return arguments[0]
        if called == _ORDERED and not arguments:
            return {}
        raise ValueError(f"it holds a {_shown(called)}")

    def _storage(
        self, _: Any, kind: _GlobalName, key: str, place: Any, count: int
    ) -> NDArray[Any]:
        """Return the numbers of a storage."""
        if kind.module != "torch" or kind.name not in _TYPES:
            raise ValueError(f"it holds a {kind}")
        if not isinstance(key, str) or not isinstance(count, int):
            raise ValueError("a storage has no name or no length")
        if key not in self.storages:  # each is read once, whoever refers to it
            self.storages[key] = self.members.read(f"{self.folder}data/{key}")
        numbers = np.frombuffer(
            self.storages[key], dtype=np.dtype(_TYPES[kind.name]).newbyteorder("<")
        )
        if len(numbers) != count:
            raise ValueError(f"storage {key} has {len(numbers)} numbers, not {count}")
        return numbers

    def _tensor(
        self,
        storage: NDArray[Any],
        offset: int,
        size: tuple[int, ...],
        stride: tuple[int, ...],
    ) -> NDArray[Any]:
        """Return a tensor on a storage, copied."""
        stated = (offset, *size, *stride)
        if not all(isinstance(n, int) for n in stated) or len(size) > _MOST_AXES:
            raise ValueError("a tensor's shape and strides are no numbers")
        last = offset + sum((n - 1) * s for n, s in zip(size, stride, strict=True))
        if min((offset, *stride, *size), default=0) < 0:
            raise ValueError(f"a tensor of shape {size} has strides {stride}")
        if 0 in size:
            return np.empty(size, storage.dtype)
        if last >= len(storage):
            raise ValueError(f"a tensor of shape {size} is larger than its storage")
        step = storage.itemsize
        # Strides of zero, and tensors on one storage, would make much of little.
        self.size += step * prod(size)
        stored = self.path.stat().st_size
        require_unpacked(self.path, self.size, stored, RecordingError)
        view = np.lib.stride_tricks.as_strided(
            storage[offset:], size, [step * s for s in stride]
        )
        return view.copy()


def _shown(value: Any) -> str:
    """Return a name for a message; other values may be too long for one."""
    return (
        str(value)
        if isinstance(value, _GlobalName)
        else "call of something that is not a function"
    )
