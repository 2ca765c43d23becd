"""What searches have found so far, as files: a killed process takes none along."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any

import numpy as np

from consistent_id.excitation.search import Candidate


@contextmanager
def report_folder(place: Path | None = None) -> Iterator[Path]:
    """Yield a new folder, which is gone at once for all who still write to it.

    Parameters
    ----------
    place : Path, optional
        Of the folder; by default that of temporary files.
    """
    folder = last = Path(mkdtemp(prefix="excitation-", dir=place))
    try:
        yield folder
    finally:
        with suppress(OSError):  # of systems that rename no folder in use
            last = folder.rename(folder.with_suffix(".over"))
        rmtree(last, ignore_errors=True)


def times_begun(folder: Path, number: int) -> int:
    """Note that a search begins, and in which process; return how often it has."""
    file = folder / f"{number}.begun"
    try:
        with file.open("a") as noted:
            noted.write(f"{os.getpid()}\n")
        return len(file.read_text().splitlines())
    except FileNotFoundError:  # a folder that this computer does not see
        return 1


def write_report(
    folder: Path, found: Candidate, *, complete: bool | None = None
) -> None:
    """Write what a search has found, at once or not at all.

    Parameters
    ----------
    folder : Path
    found : Candidate
    complete : bool, optional
        In place of the candidate's own: a search under way is not complete.
    """
    temporary = folder / f"{found.number}-{os.getpid()}.partial"
    known: dict[str, Any] = {
        "score": found.score,
        "complete": found.complete if complete is None else complete,
        "ended": complete is None,
        "obstacle": found.obstacle,
        "iterations": found.iterations,
        "work": found.work,
    }
    if found.variables is not None:
        known["variables"] = found.variables
    # A process that is about to be killed may find the folder gone already.
    with suppress(FileNotFoundError):
        with temporary.open("wb") as file:
            np.savez(file, **known)
        temporary.replace(folder / f"{found.number}.npz")


def read_reports(folder: Path, *, ended: bool = False) -> Iterator[Candidate]:
    """Yield what searches have reported, ended or not; or those that have ended."""
    for file in sorted(folder.glob("*.npz")):
        with np.load(file) as saved:
            if ended and not saved["ended"]:
                continue
            yield Candidate(
                int(file.stem),
                saved["variables"] if "variables" in saved else None,
                float(saved["score"]),
                complete=bool(saved["complete"]),
                obstacle=str(saved["obstacle"]),
                iterations=int(saved["iterations"]),
                work=float(saved["work"]),
            )
