"""What searches have found so far, as files: a killed process takes none along."""

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id.excitation.search import Candidate


def begun(folder: Path, number: int) -> None:
    """Note that a search has begun, and in which process."""
    with suppress(FileNotFoundError):
        (folder / f"{number}.begun").write_text(str(os.getpid()))


def has_begun(folder: Path, number: int) -> bool:
    """Return whether a search has begun."""
    return (folder / f"{number}.begun").exists()


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


def has_ended(folder: Path, number: int) -> bool:
    """Return whether a search has written its last report."""
    file = folder / f"{number}.npz"
    if not file.exists():
        return False
    with np.load(file) as saved:
        return bool(saved["ended"])


def read_reports(folder: Path) -> Iterator[Candidate]:
    """Yield what searches have reported, ended or not."""
    for file in sorted(folder.glob("*.npz")):
        with np.load(file) as saved:
            yield Candidate(
                int(file.stem),
                saved["variables"] if "variables" in saved else None,
                float(saved["score"]),
                complete=bool(saved["complete"]),
                obstacle=str(saved["obstacle"]),
                iterations=int(saved["iterations"]),
                work=float(saved["work"]),
            )
