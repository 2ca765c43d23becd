"""Files that a problem file names: where they are, and which ones it may name.

A problem file comes with data from others.  What it names is read, and parts of it end
up in reports; so, unless somebody has said that it is trusted, it may name what lies
below its own folder or below the folder of the data, and no other environment variable
than that folder's.
"""

import os
import string
from collections.abc import Iterator
from pathlib import Path

import msgspec

from consistent_id._support.files import relative_path
from consistent_id.errors import ProblemError
from consistent_id.problems.file import ProblemTable

DATA_FOLDER = "CONSISTENT_ID_DATASETS"
"""The environment variable that names the folder of recordings."""


def names_outside(table: ProblemTable, file: Path) -> Iterator[str]:
    """Yield a sentence about each name that leads out of these folders.

    Parameters
    ----------
    file : Path
        From whose folder relative names count.
    """
    roots = [file.parent.resolve()]
    if data := os.environ.get(DATA_FOLDER):
        roots.append(Path(data).resolve())
    for key, (first, *literal) in _named(table):
        if others := _variables(first) - {DATA_FOLDER}:
            yield (
                f"{key} is {first!r} and uses the environment variable "
                f"{min(others)}, expected none but {DATA_FOLDER}"
            )
        found = string.Template(first).safe_substitute(os.environ)
        place = Path(file.parent, found, *literal)
        if not _is_below(place, roots):
            yield (
                f"{key} leads to {str(place)!r}, outside of the file's folder and of "
                f"{DATA_FOLDER}"
            )


def moved(table: ProblemTable, old: Path, new: Path) -> ProblemTable:
    """Return a problem file's content for another folder: it names the same files.

    Parameters
    ----------
    old, new : Path
        Folders of the file, before and after.
    """

    def named(path: str) -> str:
        place = Path(string.Template(path).safe_substitute(os.environ))
        if _variables(path) or place.is_absolute():
            return path
        return as_named(old / place, new)

    model = msgspec.structs.replace(
        table.model,
        **{
            form: named(name)
            for form in ("urdf", "mjcf")
            if (name := getattr(table.model, form)) is not None
        },
    )
    data = table.data
    if data is not None:
        data = msgspec.structs.replace(data, folder=named(data.folder))
    return msgspec.structs.replace(table, model=model, data=data)


def as_named(place: Path, folder: Path) -> str:
    """Return a path from a folder, for a key in which ``$`` begins a variable."""
    return relative_path(place, folder).replace("$", "$$")


def _variables(path: str) -> set[str]:
    return set(string.Template(path).get_identifiers())


def _named(table: ProblemTable) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield a key and its path, whose parts are joined from left to right.

    In the first part environment variables are replaced, the others are as they stand.
    """
    for form in ("urdf", "mjcf"):
        if (name := getattr(table.model, form)) is not None:
            yield f"model.{form}", (name,)
    if table.data is not None:
        folder = table.data.folder
        yield "data.folder", (folder,)
        for entry in table.data.recordings:
            yield "data.recordings.file", (folder, entry.file)
            for track in entry.tracks:
                yield "data.recordings.tracks.file", (folder, track.file)
    constraints = table.constraints
    for shape in (*constraints.centre_of_mass_in, *constraints.density_on):
        if shape.mesh is not None:
            yield "constraints: mesh", (shape.mesh,)
    scene = table.excitation.scene
    for name in () if scene is None else scene.packages:
        yield "excitation.scene.packages", (name,)
    if scene is not None and scene.planning_scene is not None:
        yield "excitation.scene.planning_scene", (scene.planning_scene,)


def _is_below(place: Path, roots: list[Path]) -> bool:
    try:
        real = place.resolve()
    except (OSError, ValueError, RuntimeError):  # a loop of links, or no path at all
        return False
    return any(real.is_relative_to(root) for root in roots)


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
