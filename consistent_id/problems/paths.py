"""Files that a problem file names: where they are, and which ones it may name.

A problem file comes with data from others.  Files that it names are read, and parts of
them end up in reports; so, unless somebody has said that it is trusted, it may name
what lies below its own folder or below the folder of the data, and no other environment
variable than that folder's.  Problem files that a run of this user has written may name
the same files as then, anywhere: a record in the user's state folder has a digest of
each.
"""

import json
import os
import string
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from consistent_id._support.files import relative_path
from consistent_id._support.ownership import is_recorded, record
from consistent_id._support.run import require_trusted
from consistent_id.errors import ProblemError
from consistent_id.problems.file import ProblemTable

DATA_FOLDER = "CONSISTENT_ID_DATASETS"
"""The environment variable that names the folder of recordings."""

# Every key that names a file or a folder.  In some, environment variables are replaced;
# in others a dollar is a dollar; logs are named from the folder of the data.
_EXPANDED = (
    "model.urdf",
    "model.mjcf",
    "data.folder",
    "excitation.scene.packages",
    "excitation.scene.planning_scene",
)
_LITERAL = ("constraints.centre_of_mass_in.mesh", "constraints.density_on.mesh")
_LOGS = ("data.recordings.file", "data.recordings.tracks.file")


@dataclass(frozen=True, slots=True)
class _Name:
    """A path in a problem file.

    Parameters
    ----------
    key : str
        Without the places in lists.
    pattern : str
        Its first part, in which environment variables are replaced.
    literal : str
        The rest of the name, unchanged.
    """

    key: str
    pattern: str
    literal: str

    @property
    def variables(self) -> set[str]:
        """Environment variables that it uses."""
        return set(string.Template(self.pattern).get_identifiers())

    def place(self, folder: Path) -> Path:
        """Return the place that it names, from the problem file's folder."""
        found = string.Template(self.pattern).safe_substitute(os.environ)
        return folder / found / self.literal

    def digest(self, file: Path) -> str | None:
        """Return its entry in the record, if it names anything.

        Links are resolved: another place is another digest, and so is the same problem
        file in another place.
        """
        place = _resolved(self.place(file.parent))
        if place is None:
            return None
        itself = file.parent.resolve() / file.name
        said = [str(itself), self.key, sorted(self.variables), str(place)]
        return sha256(json.dumps(said).encode()).hexdigest()


def require_own_names(table: ProblemTable, file: Path) -> None:
    """Refuse a problem file that names what only one that is trusted may name.

    Raises
    ------
    ProblemError
        With the key of the first such name, unless the run trusts the file; if the
        name leads to no file, trust would not help, and the message says so.
    """
    for sentence, missing in names_outside(table, file):
        if missing:
            raise ProblemError(
                f"{file}: {sentence}, and no such file is there. Put it there, or "
                "change the name in the problem file. A folder of results needs no "
                "other file for report, export, compare, info and check"
            )
        require_trusted(file, sentence)


class Outside(NamedTuple):
    """The fault of a name, in words, and whether it leads to no file."""

    sentence: str
    missing: bool = False


def names_outside(table: ProblemTable, file: Path) -> Iterator[Outside]:
    """Yield each name that leads out of these folders.

    Names that a run of this user wrote into the file are left out.

    Parameters
    ----------
    file : Path
        From whose folder relative names count.
    """
    roots = [file.parent.resolve()]
    if data := os.environ.get(DATA_FOLDER):
        roots.append(Path(data).resolve())
    for name in _names(table):
        place, others = name.place(file.parent), name.variables - {DATA_FOLDER}
        if not others and _is_below(place, roots):
            continue
        digest = name.digest(file)
        if digest is not None and is_recorded(digest):
            continue
        if others:
            yield Outside(
                f"{name.key} is {name.pattern!r} and uses the environment variable "
                f"{min(others)}, expected none but {DATA_FOLDER}"
            )
        else:
            yield Outside(
                f"{name.key} leads to {str(place)!r}, outside of the file's folder and "
                f"of {DATA_FOLDER}",
                _is_missing(place),
            )


def record_own(table: ProblemTable, file: Path) -> None:
    """Record the names that lead out of a problem file's folder as this user's own.

    To be called when a run has written the file; `load_problem` then reads it without
    ``trust``.  Where the user's state folder cannot be used a warning is logged.

    Parameters
    ----------
    table : ProblemTable
        The content of the file.
    file : Path
    """
    own = [file.parent.resolve()]
    outside = (
        name
        for name in _names(table)
        if name.variables or not _is_below(name.place(file.parent), own)
    )
    record({digest for n in outside if (digest := n.digest(file))}, file)


def moved(table: ProblemTable, old: Path, new: Path) -> ProblemTable:
    """Return a problem file's content for another folder: it names the same files.

    Parameters
    ----------
    old, new : Path
        Folders of the file, before and after.
    """

    def named(key: str, path: str) -> str:
        if key in _LOGS:
            return path  # from the folder of the data, which is moved itself
        pattern, literal = ("", path) if key in _LITERAL else (path, "")
        name = _Name(key, pattern, literal)
        if name.variables or name.place(Path()).is_absolute():
            return path
        place = name.place(old)
        return relative_path(place, new) if literal else as_named(place, new)

    return _with_paths(table, named)


def as_named(place: Path, folder: Path) -> str:
    """Return a path from a folder, for a key in which ``$`` begins a variable."""
    return relative_path(place, folder).replace("$", "$$")


def _names(table: ProblemTable) -> Iterator[_Name]:
    """Yield every path of a problem file."""
    found: list[_Name] = []

    def seen(key: str, path: str) -> str:
        if key in _LOGS and table.data is not None:
            found.append(_Name(key, table.data.folder, path))
        elif key in _LITERAL:
            found.append(_Name(key, "", path))
        else:
            found.append(_Name(key, path, ""))
        return path

    _with_paths(table, seen)
    yield from found


def _with_paths(
    table: ProblemTable, changed: Callable[[str, str], str]
) -> ProblemTable:
    """Return a file's content with each path changed: a function of key and path."""
    for key in (*_EXPANDED, *_LITERAL, *_LOGS):
        table = _with_leaves(table, key.split("."), partial(changed, key))
    return table


def _with_leaves(value: Any, keys: list[str], changed: Callable[[str], str]) -> Any:
    """Return tables with the values below a key replaced, in lists too."""
    if value is None:
        return None
    if isinstance(value, list):
        return [_with_leaves(member, keys, changed) for member in value]
    if not keys:
        return changed(value)
    first, *rest = keys
    inner = _with_leaves(getattr(value, first), rest, changed)
    return msgspec.structs.replace(value, **{first: inner})


def _is_below(place: Path, roots: list[Path]) -> bool:
    real = _resolved(place)
    return real is not None and any(real.is_relative_to(root) for root in roots)


def _is_missing(place: Path) -> bool:
    real = _resolved(place)
    try:
        return real is not None and not real.exists()
    except OSError:
        return False  # nobody may look


def _resolved(place: Path) -> Path | None:
    """Return a path without links, or None of a loop of links, or of no path at all."""
    try:
        return place.resolve()
    except (OSError, ValueError, RuntimeError):
        return None


def expanded(path: str, table: ProblemTable) -> str:
    """Replace ``${NAME}`` by environment variables; a missing one is an error."""
    try:
        return string.Template(path).substitute(os.environ)
    except KeyError as missing:
        name = missing.args[0]
        raise ProblemError(
            f"problem {table.name!r}: {path} needs the environment variable {name}, "
            f"which is not set. Set it to the folder of the data{_origin(table)}"
        ) from None
    except ValueError as cause:
        raise ProblemError(f"problem {table.name!r}: {path}: {cause}") from None


def require_there(file: Path, table: ProblemTable) -> Path:
    """Return a file, without ways up; where it is not there, say where it is from.

    Raises
    ------
    ProblemError
        If there is no such file, and the problem file names a source.
    """
    if table.source and not file.exists():
        raise ProblemError(f"problem {table.name!r}: no file {file}" + _origin(table))
    return file.resolve() if ".." in file.parts else file


def _origin(table: ProblemTable) -> str:
    if not table.source:
        return ""
    licence = f" (licence: {table.licence})" if table.licence else ""
    return f". The problem's source: {table.source}{licence}"
