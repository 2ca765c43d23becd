"""Whether the records of an MCAP file hold together, and what its chunks unpack to.

A chunk states the size of its records before they were compressed; whoever unpacks it
asks for that much memory.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from consistent_id._support.inputs import require_unpacked
from consistent_id.errors import RecordingError

_MAGIC = b"\x89MCAP0\r\n"
_CHUNK, _DATA_END = 0x06, 0x0F
_BEFORE_SIZE = 16  # bytes of a chunk: its first and its last time


def check_mcap(path: Path) -> None:
    """Compare the sizes that a file states with the file.

    Raises
    ------
    RecordingError
        If a record ends after the file, or chunks unpack to much more than it.
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
