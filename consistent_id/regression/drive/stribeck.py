"""Stribeck friction: what friction at rest has beyond the Coulomb level."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from consistent_id.regression.drive.coulomb import (
    VELOCITY_SCALE,
    chosen_scale,
    direction,
    direction_options,
    without_jump,
)
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

    def smoothed(self, velocity: float) -> Self:
        """Return the term with a slope in place of the jump."""
        return without_jump(self, velocity)

    @property
    def fading_velocity(self) -> float:
        """Velocity above which little is left of the term."""
        return self.stribeck_velocity

    @property
    def options(self) -> dict[str, Any]:
        """The keywords of `DriveTerms` that choose this term."""
        return self.shapes | direction_options(self.velocity_scale)

    @classmethod
    def from_options(cls, options: Mapping[str, Any]) -> Self | None:
        """Return the term that the keywords of `DriveTerms` choose, if they do."""
        velocity, exponent = options["stribeck_velocity"], options["stribeck_exponent"]
        if velocity is None:
            return None
        return cls(velocity, exponent, chosen_scale("stribeck_velocity", options))
