"""Files that are either whole or not there."""

import os
import tempfile
from pathlib import Path

from consistent_id.errors import ProblemError


def write_atomically(path: str | Path, content: str | bytes) -> Path:
    """Write through a temporary file, fsync and rename; return the path.

    Folders are made as needed.  A reader sees the old content or the new one.

    Raises
    ------
    ProblemError
        If the place cannot be written to.
    """
    path = Path(path)
    data = content.encode() if isinstance(content, str) else content
    try:
        return _written(path, data)
    except OSError as cause:
        raise ProblemError(
            f"{path}: cannot be written ({cause.strerror}); choose another folder"
        ) from None


def require_writable(folder: Path) -> None:
    """Refuse a folder that cannot be written to, before hours of work for it.

    The nearest folder that exists is asked; nothing is made.
    """
    standing = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    if not (standing.is_dir() and os.access(standing, os.W_OK)):
        raise ProblemError(f"{folder}: cannot be written to; choose another folder")


def _written(path: Path, data: bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
    return path
