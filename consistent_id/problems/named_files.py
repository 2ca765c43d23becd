"""Files that a problem file names, and what to do where they are not there."""

import os
import string
from pathlib import Path

from consistent_id.errors import ProblemError
from consistent_id.problems.file import ProblemTable


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
