"""What an export returns: a file's content, and what the format could not say."""

from dataclasses import dataclass
from pathlib import Path

from consistent_id._support.files import write_atomically


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
    """

    format: str
    content: bytes
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        return self.content.decode("utf-8", "replace")

    def save(self, path: str | Path) -> Path:
        """Write the content; the file is whole or not there."""
        return write_atomically(path, self.content)
