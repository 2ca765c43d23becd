"""What a look at a model file has found, as values."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True, order=True)
class Finding:
    """One thing that is wrong with a model file, or odd.

    Parameters
    ----------
    line : int
        Counted from 1.
    severity : {"error", "warning"}
        With an error the robot cannot be loaded.  With a warning it can, and `sentence`
        says what is made of the oddity.
    sentence : str

    Examples
    --------
    >>> print(Finding(7, "error", "joint 'a': axis is zero, expected a direction"))
    line 7: joint 'a': axis is zero, expected a direction
    """

    line: int
    severity: Literal["error", "warning"]
    sentence: str

    def __str__(self) -> str:
        return f"line {self.line}: {self.sentence}"
