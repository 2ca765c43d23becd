"""Files that this package wrote and nobody has changed since, recognised by a digest.

A file says by a mark that it was written here.  The mark has a digest of the rest of
the content, so a file that somebody edited is theirs from then on.  The mark is in a
comment, in the header of a page, or after the key "format" of JSON.  Samples, figures
and archives have no place for it; the user's record of what was written has a digest
of their whole content.

That record is in the user's state folder.  An entry is an empty file, and its name is a
digest.  So an entry is there or not there, never half written, and processes that write
at the same time do not need a lock.  What a digest is of is its writer's choice; nobody
can read it back from the record.

Ends of lines and blank lines at the end do not count: editors and git change them
unasked, and no work is lost with them.
"""

import logging
import os
import re
import stat
from collections.abc import Collection, Mapping
from hashlib import sha256
from pathlib import Path

EDITED = (".toml",)  # files that people go on writing; their mark is the last line
_TOML_MARK = re.compile(r"(?m)^# consistent-id: digest [0-9a-f]{16} .*(?:\n|\Z)")
_LARGEST_EDITED = 2**20  # characters; longer ones were not written here
_PLACE = re.compile(
    rb'(?:<!--|#|//|/\*|"""|content="|^[;!])\s*consistent-id: (?=.)'
    rb'|"format": ?"consistent_id [a-z]+ \d+"'
)
_COMMENTED = re.compile(rb"(?<=consistent-id: )digest ([0-9a-f]{16}); ")
_KEYED = re.compile(rb'(?<=\d"), "digest": "([0-9a-f]{16})"')
_LOOKED_AT = 65536  # bytes at the beginning in which the place of a mark is looked for
_UNMARKED = (
    "is there already, and nothing in it says that consistent-id wrote it, nor does "
    "the record of your runs"
)
_CHANGED = "was edited since consistent-id wrote it"
_STATE = "XDG_STATE_HOME"
_KEPT = 10_000  # entries, the youngest; a problem file makes about five
_NAME = re.compile("[0-9a-f]{64}")

_log = logging.getLogger(__name__)


def marked(text: str) -> str:
    """Return text of a file that people may edit, and a line that shows if they do.

    The last line has a digest of the others.
    """
    text = _TOML_MARK.sub("", text.replace("\r\n", "\n")).rstrip() + "\n"
    digest = sha256(text.encode()).hexdigest()[:16]
    return (
        f"{text}\n# consistent-id: digest {digest} of the lines above; once edited, "
        "this file is not overwritten.\n"
    )


def sealed(path: Path, content: bytes) -> bytes:
    r"""Return the content of a file with the digest in its mark, if it has a mark.

    Examples
    --------
    >>> sealed(Path("x.py"), b"# consistent-id: motion\n")
    b'# consistent-id: digest 238173f33158b754; motion\n'
    """
    if path.suffix.lower() in EDITED:
        return content
    bare = _bare(content)
    if (place := _PLACE.search(bare[:_LOOKED_AT])) is None:
        return content
    keyed = place[0].endswith(b'"') and place[0].startswith(b'"format')
    form = b', "digest": "%s"' if keyed else b"digest %s; "
    mark = form % _digest(bare)[:16].encode()
    return bare[: place.end()] + mark + bare[place.end() :]


def note_written(files: Mapping[Path, bytes]) -> None:
    """Add those of some files that have no mark to the record of the user's runs."""
    bare = {
        path: content
        for path, content in files.items()
        if path.suffix.lower() not in EDITED and not _mark_of(content)
    }
    if bare:
        record(
            {_entry(content) for content in bare.values()},
            ", ".join(map(str, bare)),
            otherwise="writing it anew needs --force",
        )


def foreign(path: Path) -> str:
    """Return why a file is not ours to replace, or nothing if it is."""
    try:
        content = path.read_bytes()
    except OSError:
        return _UNMARKED
    if path.suffix.lower() in EDITED:
        return _foreign_text(content.decode("utf-8", "replace"))
    if mark := _mark_of(content):
        own = _digest(_bare(content)).startswith(mark.decode())
        return "" if own else _CHANGED
    return "" if is_recorded(_entry(content)) else _UNMARKED


def _foreign_text(text: str) -> str:
    text = text.replace("\r\n", "\n")
    if len(text) >= _LARGEST_EDITED or not _TOML_MARK.search(text):
        return _UNMARKED
    return "" if marked(text).splitlines()[-1] in text else _CHANGED


def _mark_of(content: bytes) -> bytes:
    """Return the digest that a content states of itself; empty without one."""
    place = _PLACE.search(content[:_LOOKED_AT])
    if place is None:
        return b""
    at = place.end()
    found = _COMMENTED.match(content, at) or _KEYED.match(content, at)
    return found[1] if found else b""


def _bare(content: bytes) -> bytes:
    """Return the content without the digest in its mark."""
    place = _PLACE.search(content[:_LOOKED_AT])
    if place is None:
        return content
    at = place.end()
    found = _COMMENTED.match(content, at) or _KEYED.match(content, at)
    return content[:at] + content[found.end() :] if found else content


def _digest(content: bytes) -> str:
    return sha256(content.replace(b"\r\n", b"\n").rstrip()).hexdigest()


def _entry(content: bytes) -> str:
    """Return the name of a content in the record, which also has other entries."""
    return sha256(b"a file that was written\0" + _digest(content).encode()).hexdigest()


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
