"""The problem files of a path: one file, or a folder of several robots."""

from pathlib import Path

from consistent_id.errors import ProblemError

RESULTS = "results.json"
"""The file that marks a folder of results."""

_OWN = "problem.toml"
_OTHERS = ("pyproject.toml",)  # TOML files that are not problem files


def problem_files(path: str | Path) -> tuple[Path, ...]:
    """Return the problem files of a path.

    A file stands for itself, a folder for its ``problem.toml``.  A folder without one
    stands for all TOML files in it and in its subfolders: a robot's folder for the
    problems of this robot, a folder of such folders for all robots.

    Raises
    ------
    ProblemError
        If there is none.
    """
    path = Path(path)
    if not path.is_dir():
        return (path,)
    if (path / _OWN).exists():
        return (path / _OWN,)
    folders = [path, *sorted(p for p in path.iterdir() if _is_visible_folder(p))]
    files = tuple(file for folder in folders for file in toml_files(folder))
    if not files:
        raise ProblemError(
            f"{path}: no {_OWN} in this folder, and no problem file (*.toml) in it or "
            "its subfolders. Name a folder with one, or the file itself"
        )
    return files


def is_results(path: Path) -> bool:
    """Return whether a path is a folder of results, which opens without computing."""
    return (path / RESULTS).is_file()


def results_or_file(file: Path) -> Path:
    """Return a problem file's folder of results if it is in one, else the file."""
    is_theirs = file.name == _OWN and is_results(file.parent)
    return file.parent if is_theirs else file


def toml_files(folder: Path) -> list[Path]:
    """Return a folder's problem files, ``problem.toml`` first."""
    files = [file for file in folder.glob("*.toml") if file.name not in _OTHERS]
    return sorted(files, key=lambda file: (file.name != _OWN, file.name))


def _is_visible_folder(path: Path) -> bool:
    return path.is_dir() and not path.name.startswith(".")
