"""Files that are read and written.

Those that are written are there whole or not at all, several together, and never over
the files of others.  Those that are read are regular files, and not too large for their
purpose: a file of a stranger may be a device that never ends, or state sizes that it
does not have; its stated sizes are compared with the file before memory is allocated.
"""

import json
import logging
import os
import platform
import re
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

from consistent_id._support.extras import needed
from consistent_id._support.ownership import foreign, note_written, sealed
from consistent_id._support.run import current_run, is_input, note_input
from consistent_id.errors import ConsistentIdError, ProblemError, RecordingError

_log = logging.getLogger(__name__)

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
    """Return its memory in bytes, or None if the system does not state it."""
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


_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/{1,2}[^/]")


def local_path(text: str | Path) -> Path:
    """Return a path; of a URL that of a copy in the user's cache, fetched by fsspec.

    A path that was made of a URL has one of its two slashes.

    Raises
    ------
    RecordingError
        If fsspec is not installed, or cannot fetch it.
    """
    word = str(text)
    if _URL.match(word) is None or Path(word).exists():
        return Path(text)
    scheme, _, rest = word.partition(":")
    url = f"{scheme}://{rest.lstrip('/')}" if scheme != "file" else f"file:{rest}"
    library = needed("fsspec", "urls", url, RecordingError)
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    name = sha256(url.encode()).hexdigest()[:16]
    target = base / "consistent_id" / "logs" / name / (Path(rest).name or "log")
    try:
        source, place = library.url_to_fs(url)
        target.parent.mkdir(parents=True, exist_ok=True)
        source.get(place, str(target), recursive=source.isdir(place))
    except (OSError, ValueError, ImportError) as cause:
        raise RecordingError(
            f"{url}: cannot be fetched ({cause}). Copy it to this computer, and name "
            "the copy"
        ) from None
    _log.warning("%s was copied to %s", url, target)
    return target


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


_STAGED = ".consistent-id-staged."


@dataclass(frozen=True, slots=True)
class _Waiting:
    """Files to appear together, and what is done when they have."""

    files: dict[Path, bytes] = field(default_factory=dict)
    then: list[Callable[[], None]] = field(default_factory=list)


_waiting: ContextVar[_Waiting | None] = ContextVar("waiting", default=None)


def write_atomically(path: str | Path, content: str | bytes) -> Path:
    """Write a file whole or not at all, and return its path.

    Folders are made as needed.  A reader sees the old content or the new one.  Inside
    `together` the file appears when all are there.

    Raises
    ------
    ProblemError
        If the place cannot be written to; in the shell tool also as
        `require_replaceable`.
    """
    path = Path(path)
    data = sealed(path, content.encode() if isinstance(content, str) else content)
    require_replaceable(path, data)
    waiting = _waiting.get()
    if waiting is None:
        _place({path: data})
    else:
        waiting.files[path] = data
    return path


def write_json(path: Path, record: Any) -> Path:
    """Write plain values as JSON, whole or not at all, and return the path."""
    from msgspec.json import format as indented

    # Python's own indentation takes ten times as long as all the rest.
    compact = json.dumps(record, allow_nan=False).encode()
    return write_atomically(path, indented(compact, indent=1) + b"\n")


def relative_path(path: Path, folder: Path) -> str:
    """Return the name of a place relative to a folder."""
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()


@contextmanager
def together() -> Iterator[None]:
    """Let files that are written inside appear together, or none of them.

    They are written beside their places first, and then renamed.  A folder that was
    not there appears in one step; in one that was, files are renamed one by one, and
    back again if one of them fails.
    """
    if _waiting.get() is not None:
        yield
        return
    waiting = _Waiting()
    token = _waiting.set(waiting)
    try:
        yield
    finally:
        _waiting.reset(token)
    _place(waiting.files)
    for act in waiting.then:
        act()


def content_of(path: Path) -> bytes:
    """Return the future content of a file, with the files of `together`."""
    waiting = _waiting.get()
    if waiting is not None and path in waiting.files:
        return waiting.files[path]
    return path.read_bytes()


def when_written(act: Callable[[], None]) -> None:
    """Do something once the files of `together` are there; outside of it, now."""
    waiting = _waiting.get()
    if waiting is None:
        act()
    else:
        waiting.then.append(act)


def remove_when_written(paths: Iterable[Path]) -> None:
    """Remove files once those of `together` are there, except files among them."""
    waiting, gone = _waiting.get(), tuple(paths)

    def remove() -> None:
        for path in gone:
            if waiting is None or path not in waiting.files:
                try:
                    path.unlink(missing_ok=True)
                except OSError as cause:
                    _log.warning("%s was not removed: %s", path, cause.strerror)

    when_written(remove)


def has_content(path: Path, text: str) -> bool:
    """Return whether a file is as `write_atomically` would write it."""
    return _holds(path, sealed(path, text.encode()))


def require_replaceable(path: Path, content: bytes | None = None) -> None:
    """Refuse to write over an input of the run, or over a file that others wrote.

    Parameters
    ----------
    content : bytes, optional
        The bytes to write; a file that has them already may stay.

    Raises
    ------
    ProblemError
        Unless the user has said ``--force``.  Folders and devices are never replaced.
    """
    try:
        status = path.stat()
    except OSError:
        return  # not there; whatever else is wrong, writing will say
    if not stat.S_ISREG(status.st_mode):
        raise ProblemError(f"{path} is no regular file, expected a file to write")
    if current_run().force:
        return
    if is_input(status):
        raise ProblemError(
            f"{path} is an input of this run and would be overwritten; name another "
            "file, or say --force"
        )
    if content is not None and _holds(path, content):
        return
    if fault := foreign(path):
        raise ProblemError(f"{path} {fault}; name another place, or say --force")


def require_writable(folder: Path, names: Iterable[str] = ()) -> None:
    """Refuse a folder that cannot be written to, before hours of work for it.

    Nothing is left there.  All files that will be written are to be named, those in
    folders below such as ``"plots/a.svg"`` too: none that is there may be in the way.
    """
    files = [folder / name for name in names]
    for place in dict.fromkeys((folder, *(file.parent for file in files))):
        standing = next(p for p in (place, *place.absolute().parents) if p.exists())
        if not (standing.is_dir() and _takes_folders(standing)):
            raise ProblemError(f"{place}: cannot be written to; choose another folder")
    for file in files:
        require_replaceable(file)


def _takes_folders(folder: Path) -> bool:
    """Return whether a folder can be made in another, by making one.

    Permissions do not tell: nobody can write to ``/proc``, or to a full disk.
    """
    try:
        os.rmdir(tempfile.mkdtemp(prefix=".consistent-id-", dir=folder))
    except OSError:
        return False
    return True


def require_writable_file(file: Path) -> None:
    """Refuse a file that could not be written in the end, before work for it."""
    require_writable(file.parent, [file.name])


def _holds(path: Path, content: bytes) -> bool:
    try:
        return path.stat().st_size == len(content) and path.read_bytes() == content
    except OSError:
        return False


def _place(files: Mapping[Path, bytes]) -> None:
    """Write files beside their places, then rename all of them."""
    staged: list[Path] = []
    moves: list[tuple[Path, Path]] = []
    path = Path()
    try:
        folders = list(dict.fromkeys(path.parent for path in files))
        for folder in folders:
            own = {p: data for p, data in files.items() if p.parent == folder}
            path = next(iter(own))
            new = folders == [folder] and not folder.exists()
            beside = folder.parent if new else folder
            beside.mkdir(parents=True, exist_ok=True)
            staging = _staging(beside)
            staged.append(staging)
            for path, data in own.items():
                _write(staging / path.name, data)
            if new:
                os.chmod(staging, 0o755)
                moves.append((staging, folder))
            else:
                moves += [(staging / p.name, p) for p in own]
        _rename(moves)
    except OSError as cause:
        raise ProblemError(
            f"{path}: cannot be written ({cause.strerror}); choose another folder"
        ) from None
    finally:
        for staging in staged:
            shutil.rmtree(staging, ignore_errors=True)
    note_written(files)


def _rename(moves: list[tuple[Path, Path]]) -> None:
    """Rename all, or none: what stood in a place comes back if one fails."""
    done: list[tuple[Path, Path]] = []
    try:
        for source, target in moves:
            before = source.with_name(f"{source.name}.before")
            if target.is_file():
                with suppress(OSError):  # some file systems have no links
                    os.link(target, before)
            os.replace(source, target)
            done.append((before, target))
    except BaseException:
        for before, target in reversed(done):
            if before.exists():
                os.replace(before, target)
            elif target.is_dir():
                shutil.rmtree(target)
            else:
                target.unlink(missing_ok=True)
        raise
    for folder in dict.fromkeys(target.parent for _, target in moves):
        _synchronise(folder)


def _write(path: Path, data: bytes) -> None:
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    os.chmod(path, 0o644)


def _synchronise(folder: Path) -> None:
    """Make renames last; not every system lets folders be opened."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _staging(folder: Path) -> Path:
    """Return a new folder for files in the making; remove those of dead processes."""
    here = f"{_STAGED}{platform.node()}."
    for other in folder.glob(f"{here}*"):
        process = other.name.removeprefix(here).partition(".")[0]
        if process.isdigit() and not _lives(int(process)):
            shutil.rmtree(other, ignore_errors=True)
    return Path(tempfile.mkdtemp(dir=folder, prefix=f"{here}{os.getpid()}."))


def _lives(process: int) -> bool:
    if os.name != "posix":
        return True  # signal 0 asks nothing there
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
