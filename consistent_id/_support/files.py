"""Files that are written: whole or not there, several together, never over others'."""

import json
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

from consistent_id._support.run import current_run, is_input
from consistent_id.errors import ProblemError

# How files of this package say so, each as its format allows: in a comment, in the
# header of a page, a figure or a table, or by the key "format".  NPZ has UTF-32.
_MARK = re.compile(
    rb'(?:<!--|#|//|/\*|"""|content="|Software\0)\s*consistent-id: '
    rb'|"format": "consistent_id [a-z]+ \d'
    rb"|consistent-id: samples of a trajectory"  # in a Parquet file's metadata
    rb"|" + re.escape("consistent_id trajectory ".encode("utf-32-le"))
)
# Samples of trajectories and CasADi's functions have no place for a mark, but a form
# that is their own; CasADi writes a byte as two letters, here those of "dynamics".
_FORM = re.compile(
    rb"jhpnnagi\w{,200}egjhogbgngjgdgdh"
    rb"|time,q_[^\n]*,dq_[^\n]*,ddq_(?:(?!,(?:tau|torque|effort|current))[^\n])*\n"
    rb'|\{"header": \{"stamp": \{"sec": 0, "nanosec": 0\}, "frame_id": ""\},\n'
    rb'"joint_names": '
)
_LOOKED_AT = 65536  # bytes at both ends in which a mark is looked for
_EDITED = (".toml",)  # files that people go on writing: over them only as written
_DIGEST = re.compile(r"(?m)^# consistent-id: digest [0-9a-f]{16} .*(?:\n|\Z)")
_LARGEST_EDITED = 2**20  # characters; longer ones were not written here
_UNMARKED = "is there already, and nothing in it says that consistent-id wrote it"
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
    data = content.encode() if isinstance(content, str) else content
    require_replaceable(path, data)
    waiting = _waiting.get()
    if waiting is None:
        _place({path: data})
    else:
        waiting.files[path] = data
    return path


def write_json(path: Path, record: Any) -> Path:
    """Write plain values as JSON, whole or not at all, and return the path."""
    return write_atomically(path, json.dumps(record, indent=1, allow_nan=False) + "\n")


def relative_path(path: Path, folder: Path) -> str:
    """Return how a place is called from a folder."""
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
    """Return what a file will hold once the files of `together` are there."""
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


def marked(text: str) -> str:
    """Return text of a file that people may edit, and a line that shows if they do.

    The last line has a digest of the others.  Ends of lines and blank lines at the end
    do not count: editors and git change them unasked, and no work is lost with them.
    """
    text = _DIGEST.sub("", text.replace("\r\n", "\n")).rstrip() + "\n"
    digest = sha256(text.encode()).hexdigest()[:16]
    return (
        f"{text}\n# consistent-id: digest {digest} of the lines above; once edited, "
        "this file is not overwritten.\n"
    )


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
    if fault := _foreign(path):
        raise ProblemError(f"{path} {fault}; name another place, or say --force")


def require_writable(folder: Path, names: Iterable[str] = ()) -> None:
    """Refuse a folder that cannot be written to, before hours of work for it.

    Nothing is made.  All files that will be written are to be named, those in folders
    below such as ``"plots/a.svg"`` too: none that is there may be in the way.
    """
    files = [folder / name for name in names]
    for place in dict.fromkeys((folder, *(file.parent for file in files))):
        standing = next(p for p in (place, *place.absolute().parents) if p.exists())
        if not (standing.is_dir() and os.access(standing, os.W_OK)):
            raise ProblemError(f"{place}: cannot be written to; choose another folder")
    for file in files:
        require_replaceable(file)


def require_writable_file(file: Path) -> None:
    """Refuse a file that could not be written in the end, before work for it."""
    require_writable(file.parent, [file.name])


def _holds(path: Path, content: bytes) -> bool:
    try:
        return path.stat().st_size == len(content) and path.read_bytes() == content
    except OSError:
        return False


def _foreign(path: Path) -> str:
    """Return why a file is not ours to replace, or nothing if it is."""
    try:
        if path.suffix.lower() not in _EDITED:
            return "" if _is_marked(path) else _UNMARKED
        with path.open(encoding="utf-8", errors="replace") as file:
            text = file.read(_LARGEST_EDITED)
    except OSError:
        return _UNMARKED
    if len(text) == _LARGEST_EDITED or not _DIGEST.search(text):
        return _UNMARKED
    line = marked(text).splitlines()[-1]
    return "" if line in text else "was edited since consistent-id wrote it"


def _is_marked(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(_LOOKED_AT)
        file.seek(max(0, os.fstat(file.fileno()).st_size - _LOOKED_AT))
        tail = file.read(_LOOKED_AT)
    return bool(_MARK.search(head) or _MARK.search(tail) or _FORM.match(head))


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
