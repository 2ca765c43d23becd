"""Coulomb friction that varies with position."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from consistent_id.regression.drive.coulomb import VELOCITY_SCALE, direction
from consistent_id.regression.drive.term import DriveTerm, JointSamples


@dataclass(frozen=True, slots=True)
class FrictionSlope(DriveTerm):
    """``friction_slope s(dq) q``, [N m/rad or N/m]; ``s`` is the `direction`.

    With a Coulomb term the level of friction is ``coulomb + friction_slope q``, as
    belts, seals and cables that tighten along the way have it.  `NonNegativeDrive`
    keeps the level from being negative at the joint's limits, and so between them;
    the Coulomb term alone is the level at ``q = 0``, which the joint may never reach.
    """

    names = ("friction_slope",)
    unit = ("N m/rad", "N/m")
    shape_parameters = VELOCITY_SCALE

    velocity_scale: float | None = None

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the direction of motion times the position."""
        return [direction(joint.dq, self.velocity_scale) * joint.q]
