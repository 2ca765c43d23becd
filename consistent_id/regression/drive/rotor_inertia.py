"""Inertia of the motor's rotor."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from consistent_id.regression.drive.term import DriveTerm, JointSamples


@dataclass(frozen=True, slots=True)
class RotorInertia(DriveTerm):
    """``rotor_inertia ddq``, [kg m^2 or kg].

    Seen from the link: gear ratio squared times the motor's.
    """

    names = ("rotor_inertia",)
    unit = ("kg m^2", "kg")
    smooth = polynomial = nonnegative = True
    friction = False
    simulated_as = "armature"

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the acceleration."""
        return [joint.ddq]
