"""ROS bags as files: whether they can be read, and what decodes their messages.

Bags are folders, and bare MCAP, SQLite and ROS 1 files.  A chunk of an MCAP file states
the size of its records before they were compressed; unpacking allocates this memory, so
`_check_mcap` checks the size first.
"""

import struct
import sys
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from consistent_id._support.files import require_regular, require_unpacked
from consistent_id.errors import RecordingError

# Exceptions of the library for files that are cut or overwritten.
_UNREADABLE = (
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
    AssertionError,
    OSError,
    EOFError,
    OverflowError,
    MemoryError,
    RuntimeError,
    struct.error,
    zlib.error,
)
_STORAGE = {
    "sqlite3": "Error",
    "apsw": "Error",
    "zstandard": "ZstdError",
    "backports.zstd": "ZstdError",
    "compression.zstd": "ZstdError",
}

_MAGIC = b"\x89MCAP0\r\n"
_CHUNK, _DATA_END = 0x06, 0x0F
_BEFORE_SIZE = 16  # bytes of a chunk: its first and its last time


@contextmanager
def opened_bag(path: Path) -> Iterator[Any]:
    """Yield a bag to read; convert the library's exceptions.

    Raises
    ------
    RecordingError
        If it is no bag, or one that is cut, overwritten or much larger unpacked.
    """
    import rosbags.rosbag1
    import rosbags.rosbag2
    from rosbags.serde import SerdeError
    from rosbags.typesys.base import TypesysError

    if path.is_dir() and not (path / "metadata.yaml").is_file():
        raise RecordingError(f"{path}: a folder without metadata.yaml is not a bag")
    for file in (path,) if path.is_file() else sorted(path.glob("*.mcap")):
        if file.suffix.lower() == ".mcap":
            require_regular(file, RecordingError)
            _check_mcap(file)
    library: Any = rosbags.rosbag1 if _is_old(path) else rosbags.rosbag2
    of_library = (library.ReaderError, SerdeError, TypesysError)
    try:
        with library.Reader(path) as bag:
            yield bag
    except (*of_library, *_UNREADABLE, *_of_storage()) as cause:
        raise RecordingError(f"{path}: not readable as ROS bag: {cause}") from None


def _is_old(path: Path) -> bool:
    """Return whether a bag is of ROS 1."""
    return path.suffix.lower() == ".bag" and path.is_file()


def _of_storage() -> tuple[type[Exception], ...]:
    """Return the errors of the libraries with which rosbags reads storage."""
    return tuple(
        getattr(sys.modules[module], error)
        for module, error in _STORAGE.items()
        if module in sys.modules
    )


def decoder_of(path: Path, connections: Sequence[Any]) -> Callable[[bytes, str], Any]:
    """Return a decoder of messages; the bag defines kinds that ROS does not have.

    Parameters
    ----------
    connections : sequence of rosbags.interfaces.Connection
        Those whose messages are decoded.

    Raises
    ------
    RecordingError
        If a kind of message is not defined.
    """
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    old = _is_old(path)
    types = get_typestore(Stores.ROS1_NOETIC if old else Stores.ROS2_HUMBLE)
    for connection in connections:
        if connection.msgtype in types.types:
            continue
        stated = connection.msgdef
        if stated.format != MessageDefinitionFormat.MSG:
            raise RecordingError(
                f"{path}: topic {connection.topic!r} is of {connection.msgtype}, which "
                "neither ROS nor the bag defines; record it as a standard kind, such "
                "as geometry_msgs/WrenchStamped"
            )
        defined = get_types_from_msg(stated.data, connection.msgtype)
        new = {kind: d for kind, d in defined.items() if kind not in types.types}
        types.register(new)
    decode: Callable[[bytes, str], Any] = (
        types.deserialize_ros1 if old else types.deserialize_cdr
    )
    return decode


def _check_mcap(path: Path) -> None:
    """Compare the sizes that a file states with the file.

    Raises
    ------
    RecordingError
        If a record ends after the file, or chunks unpack to much more than the file.
    """
    stored = path.stat().st_size
    with path.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise RecordingError(f"{path}: not readable as ROS bag: no MCAP file")
        unpacked = sum(_chunk_sizes(path, file, stored))
    require_unpacked(path, unpacked, stored, RecordingError)


def _chunk_sizes(path: Path, file: IO[bytes], stored: int) -> Iterator[int]:
    """Yield the size of each chunk's records, as it states it."""
    while len(head := file.read(9)) == 9:
        kind, length = struct.unpack("<BQ", head)
        begin = file.tell()
        if begin + length > stored:
            raise RecordingError(
                f"{path}: not readable as ROS bag: a record at byte {begin - 9} "
                f"states {length} bytes, the file ends before"
            )
        if kind == _CHUNK and length >= _BEFORE_SIZE + 8:
            file.seek(begin + _BEFORE_SIZE)
            yield struct.unpack("<Q", file.read(8))[0]
        if kind == _DATA_END:
            return
        file.seek(begin + length)
