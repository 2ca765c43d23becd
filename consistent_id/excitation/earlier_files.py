"""Files of an earlier design that lie in the folder of a new one.

A new design replaces files of the same names.  Files of other formats would stay, and
be played as if they were of the new motion.  Those that this package wrote, and nobody
has changed since, are removed; all others stay, and are named.
"""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import NamedTuple

from consistent_id._support.files import has_content
from consistent_id._support.ownership import foreign
from consistent_id.excitation.playable import TRAINING, VALIDATION
from consistent_id.motion.files.document import json_of
from consistent_id.motion.files.trajectory_file import FORMAT_OF_ENDING
from consistent_id.motion.moves import Move

RECORD = "excitation.json"
REPLAY = "replay.html"
CLIENT = "follow.py"
"""Script that plays ``yaml`` files on ROS 2, written beside them."""


class EarlierFiles(NamedTuple):
    """Files in a folder whose names are those of a design, but which show another one.

    Attributes
    ----------
    removed : tuple of Path
        The package's own, unchanged; `write_design` removes them.
    kept : tuple of Path
        Edited ones, and those that the package cannot know as its own.
    """

    removed: tuple[Path, ...] = ()
    kept: tuple[Path, ...] = ()

    def sentences(self) -> tuple[str, ...]:
        """Return what becomes of them, in words."""
        found = []
        if self.removed:
            found.append(f"removed, as of an earlier design: {_names(self.removed)}")
        if self.kept:
            found.append(
                f"warning: not of this design, and left as they are: "
                f"{_names(self.kept)}; edited, or not known as consistent-id's own"
            )
        return tuple(found)

    def record(self) -> dict[str, list[str]]:
        """Return their names, if there are any."""
        names = {
            "removed": [path.name for path in self.removed],
            "kept": [path.name for path in self.kept],
        }
        return names if self.removed or self.kept else {}


def _names(paths: tuple[Path, ...]) -> str:
    return f"{', '.join(path.name for path in paths)} in {paths[0].parent}"


def earlier_files(
    moves: Mapping[str, Move],
    folder: Path,
    formats: Collection[str],
    *,
    replayed: bool = False,
) -> EarlierFiles:
    """Return files of another design in a folder that a new design does not replace.

    A motion that has not changed keeps its files of other formats.

    Parameters
    ----------
    moves : mapping of str to Move
        Those of the new design, see `PlayableDesign`.
    folder : Path
    formats : collection of str
        Endings of the files of samples that will be written.
    replayed : bool
        Whether ``replay.html`` will be written.
    """
    stale = []
    for name in (TRAINING, VALIDATION):
        move, exact = moves.get(name), folder / f"{name}.json"
        if move is not None and has_content(exact, json_of(move)):
            continue
        written = () if move is None else ("json", *formats)
        endings = (ending.lstrip(".") for ending in FORMAT_OF_ENDING)
        stale += [folder / f"{name}.{e}" for e in endings if e not in written]
        if name == TRAINING and not replayed:
            stale.append(folder / REPLAY)
    stale = [path for path in stale if path.is_file()]
    # Without a record of ours beside them, they may be of any use of the package.
    known = (folder / RECORD).is_file() and not foreign(folder / RECORD)
    own = [path for path in stale if known and not foreign(path)]
    kept = tuple(path for path in stale if path not in own)
    client = folder / CLIENT
    if "yaml" not in formats and client.is_file() and not foreign(client):
        left = {*folder.glob("*.yaml"), *folder.glob("*.yml")} - set(own)
        own += [client] * (known and not left)
    return EarlierFiles(tuple(own), kept)
