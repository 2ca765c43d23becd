"""Files that are read: regular ones, and no larger than what they are for.

A file of a stranger may be a device that never ends, or state sizes that it does not
have; what it states is compared with what it is before memory is asked for.
"""

import os
import stat
from pathlib import Path

from consistent_id._support.run import current_run, note_input
from consistent_id.errors import ConsistentIdError

MEBIBYTE = 2**20
GIBIBYTE = 2**30
LARGEST_MODEL = 32 * MEBIBYTE  # bytes; URDF and MJCF of robots have less than 1 MiB
LARGEST_PROBLEM = MEBIBYTE  # bytes; the longest of this repository has 8 kB
LARGEST_TREE = 1000  # joints and bodies; a humanoid with two hands has about 150
MOST_KEYS = 10_000  # of a TOML file; the longest of this repository has 300
MOST_DOTS = 32  # before a line's "="; TOML's tables in tables take quadratic time
# Measured signals have noise, and no compression makes them 16 times smaller; small
# files may be made of zeros, and 256 MiB fit into any computer.  A recording takes
# three to four times the memory of its numbers while it is read.
_RATIO = 16
_UNPACKED = 256 * MEBIBYTE
_RAISE = (
    "say --large-files (in Python: with consistent_id.large_files()) if it is meant"
)


def memory_of_this_computer() -> int | None:
    """Return its memory in bytes, or None where the system does not tell."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None


def require_regular(path: Path, error: type[ConsistentIdError]) -> int:
    """Return a file's size in bytes; note it as an input of the run.

    Raises
    ------
    ConsistentIdError
        An exception of the class `error`, if the path is missing, or is a folder, a
        device or a pipe.
    """
    try:
        status = path.stat()
    except (OSError, ValueError) as cause:
        reason = getattr(cause, "strerror", None) or cause
        raise error(f"{path}: cannot be read ({reason})") from None
    if stat.S_ISDIR(status.st_mode):
        raise error(f"{path}: cannot be read (Is a directory)")
    if not stat.S_ISREG(status.st_mode):
        raise error(f"{path}: a device or a pipe, expected a regular file; copy it")
    note_input(status)
    return status.st_size


def read_input(path: Path, error: type[ConsistentIdError], largest: int) -> bytes:
    """Return the content of a regular file of at most `largest` bytes.

    Raises
    ------
    ConsistentIdError
        An exception of the class `error`.
    """
    require_size(path, require_regular(path, error), error, largest)
    try:
        with path.open("rb") as file:
            # It may have grown since; a size of 0 is that of files in /proc.
            require_size(path, os.fstat(file.fileno()).st_size, error, largest)
            return file.read()
    except OSError as cause:
        raise error(f"{path}: cannot be read ({cause.strerror})") from None


def require_size(
    where: object, size: int, error: type[ConsistentIdError], largest: int
) -> None:
    """Refuse more bytes than a file of its kind has."""
    if size > largest and not current_run().large_files:
        raise error(
            f"{where}: {size / MEBIBYTE:.1f} MiB, expected at most "
            f"{largest / MEBIBYTE:g} MiB; {_RAISE}"
        )


def require_count(
    where: object, count: int, most: int, what: str, error: type[ConsistentIdError]
) -> None:
    """Refuse more things of a kind than a file for a robot has."""
    if count > most and not current_run().large_files:
        raise error(f"{where}: {count} {what}, expected at most {most}; {_RAISE}")


def require_unpacked(
    where: object, unpacked: int, stored: int, error: type[ConsistentIdError]
) -> None:
    """Refuse data that unpack to much more than a file has bytes.

    Parameters
    ----------
    where : object
        The beginning of the message.
    unpacked : int
        Bytes that the data would need, by what the file states; a number needs 8.
    stored : int
        Bytes of the file.
    """
    most = max(_UNPACKED, _RATIO * stored)
    if unpacked > most and not current_run().large_files:
        raise error(
            f"{where}: {stored} bytes that state {unpacked / MEBIBYTE:.0f} MiB of "
            f"data, expected at most {most / MEBIBYTE:.0f} MiB; {_RAISE}"
        )
