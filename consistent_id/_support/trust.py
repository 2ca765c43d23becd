"""A record of what this user's own runs wrote, in the user's state folder.

An entry is an empty file, and its name is a digest.  So an entry is there or not there,
never half written, and processes that write at the same time do not need a lock.  What
a digest is of is its writer's choice; nobody can read it back from the record.
"""

import logging
import os
import re
import stat
from collections.abc import Collection
from pathlib import Path

_STATE = "XDG_STATE_HOME"
_KEPT = 10_000  # entries, the youngest; a problem file makes about five
_NAME = re.compile("[0-9a-f]{64}")

_log = logging.getLogger(__name__)


def record(
    digests: Collection[str],
    what: object,
    *,
    otherwise: str = "opening it needs --trust",
) -> None:
    """Add SHA-256 digests to the record, for good.

    Parameters
    ----------
    digests : collection of str
        In hexadecimal.
    what : object
        The object that they are of, for the warning that is logged where the state
        folder cannot be used.
    otherwise : str
        The consequence for the user if it is not recorded.
    """
    if not digests:
        return
    try:
        folder = _folder()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _require_own(folder)
        for digest in digests:
            (folder / digest).touch(mode=0o600)
        _forget_oldest(folder)
    except OSError as cause:
        _log.warning(
            "%s is not recorded as a file of your own, and %s: %s",
            what,
            otherwise,
            cause,
        )


def is_recorded(digest: str) -> bool:
    """Return whether a run of this user has recorded a digest."""
    try:
        folder = _folder()
        _require_own(folder)
        _require_own(folder / digest)
    except OSError as cause:
        _log.debug("not recorded: %s", cause)
        return False
    return True


def _folder() -> Path:
    """Return the folder of the record, which need not be there."""
    from platformdirs import user_state_dir

    above = os.environ.get(_STATE, "")  # platformdirs heeds it on some systems only
    found = Path(above) if os.path.isabs(above) else Path(user_state_dir())
    if not found.is_absolute():  # else the folder that we are in chose the record
        raise OSError(f"{_STATE} or HOME leads to {found}, expected an absolute path")
    return found / "consistent_id" / "written"


def _require_own(path: Path) -> None:
    """Refuse what the user does not own or others can write to.

    On Windows, where there is no owner's number, the user's profile is private.
    """
    status = path.lstat()
    others = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    if stat.S_ISLNK(status.st_mode):
        raise PermissionError(f"{path} is a link")
    if os.name == "posix" and (status.st_uid != os.getuid() or others):
        raise PermissionError(f"{path} is not yours alone to write")


def _forget_oldest(folder: Path) -> None:
    """Keep the record small, whatever else lies in its folder."""
    entries = [path for path in folder.iterdir() if _NAME.fullmatch(path.name)]
    if len(entries) > _KEPT:
        for path in sorted(entries, key=_age)[_KEPT:]:
            path.unlink(missing_ok=True)


def _age(path: Path) -> float:
    """Return the age of an entry; one that another process removed is the oldest."""
    try:
        return -path.stat().st_mtime
    except FileNotFoundError:
        return float("inf")
