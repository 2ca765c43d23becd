"""Stribeck friction: what friction at rest has beyond the Coulomb level."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from consistent_id.regression.drive.coulomb import VELOCITY_SCALE, direction
from consistent_id.regression.drive.term import (
    SPEED,
    TORQUE,
    DriveTerm,
    JointSamples,
    ShapeParameter,
)


@dataclass(frozen=True, slots=True)
class Stribeck(DriveTerm):
    """``stribeck s(dq) exp(-|dq / stribeck_velocity|^stribeck_exponent)``, [N m or N].

    ``s`` is the `direction` of motion.
    """

    names = ("stribeck",)
    unit = TORQUE
    nonnegative = True
    shape_parameters = {  # noqa: RUF012  declared a class variable by DriveTerm
        **VELOCITY_SCALE,
        "stribeck_velocity": ShapeParameter(SPEED, 1e-3, 2.0),
        "stribeck_exponent": ShapeParameter(("1", "1"), 0.3, 4.0),
    }

    stribeck_velocity: float
    stribeck_exponent: float = 2.0
    velocity_scale: float | None = None

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the direction of motion, fading with the rate."""
        speed = abs(joint.dq / self.stribeck_velocity)
        fading = np.exp(-(speed**self.stribeck_exponent))
        return [direction(joint.dq, self.velocity_scale) * fading]

    @property
    def fading_velocity(self) -> float:
        """Velocity above which little is left of the term."""
        return self.stribeck_velocity
