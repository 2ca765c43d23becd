"""What an export returns: a file's content, and what the format could not say."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from consistent_id._support.files import write_atomically
from consistent_id.errors import ProblemError


class SideFile(NamedTuple):
    """What a format has no place for, in a file of the same name but its suffix."""

    suffix: str
    content: bytes


@dataclass(frozen=True, slots=True)
class Export:
    """A file in the making.

    Parameters
    ----------
    format : str
    content : bytes
    notes : tuple of str
        What of the estimate the format cannot express, and what was done so that it
        expresses the rest.
    files : tuple of (Path, Path)
        Files to be copied, and where to, beside the content.
    side : SideFile, optional
    """

    format: str
    content: bytes
    notes: tuple[str, ...] = ()
    files: tuple[tuple[Path, Path], ...] = ()
    side: SideFile | None = None

    def __str__(self) -> str:
        return self.content.decode("utf-8", "replace")

    def save(self, path: str | Path) -> Path:
        """Write the content and what belongs beside it; each is whole or not there.

        Raises
        ------
        ProblemError
            If a place cannot be written to, or another file is where one is to be.
        """
        beside = [(Path(path).parent / name, place) for place, name in self.files]
        for target, place in beside:
            if target.exists() and target.read_bytes() != place.read_bytes():
                raise ProblemError(
                    f"{target}: another file is there already, and {place} should be "
                    "copied to it; choose another folder"
                )
        for target, place in beside:
            if not target.exists():
                write_atomically(target, place.read_bytes())
        if self.side is not None:
            write_atomically(
                Path(path).with_suffix(self.side.suffix), self.side.content
            )
        return write_atomically(path, self.content)
