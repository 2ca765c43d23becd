"""A constant torque."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from consistent_id.regression.drive.term import TORQUE, DriveTerm, JointSamples


@dataclass(frozen=True, slots=True)
class Offset(DriveTerm):
    """A constant, [N m or N]."""

    names = ("offset",)
    unit = TORQUE
    smooth = polynomial = True

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the number one."""
        return [1.0]
