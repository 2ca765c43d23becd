"""Quadratic drag."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from consistent_id.regression.drive.term import DriveTerm, JointSamples


@dataclass(frozen=True, slots=True)
class Drag(DriveTerm):
    """``drag dq |dq|``, as of fluids and fans, [N m s^2/rad^2 or N s^2/m^2]."""

    names = ("drag",)
    unit = ("N m s^2/rad^2", "N s^2/m^2")
    smooth = nonnegative = True

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the square of the rate, with its sign."""
        return [joint.dq * abs(joint.dq)]
