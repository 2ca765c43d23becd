"""A spring at a joint."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from consistent_id.regression.drive.term import DriveTerm, JointSamples


@dataclass(frozen=True, slots=True)
class Spring(DriveTerm):
    """``spring q``, [N m/rad or N/m]."""

    names = ("spring",)
    unit = ("N m/rad", "N/m")
    smooth = polynomial = nonnegative = True
    friction = False
    simulated_as = "stiffness"

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the position."""
        return [joint.q]
