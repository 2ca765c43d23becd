"""Viscous friction."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from consistent_id.regression.drive.term import DriveTerm, JointSamples


@dataclass(frozen=True, slots=True)
class Viscous(DriveTerm):
    """``viscous dq``, [N m s/rad or N s/m]."""

    names = ("viscous",)
    unit = ("N m s/rad", "N s/m")
    smooth = polynomial = nonnegative = True
    simulated_as = "damping"

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the rate."""
        return [joint.dq]
