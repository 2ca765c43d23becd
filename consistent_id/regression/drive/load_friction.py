"""Coulomb friction of loaded gears."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from consistent_id.regression.drive.coulomb import (
    VELOCITY_SCALE,
    chosen_scale,
    direction,
    direction_options,
    without_jump,
)
from consistent_id.regression.drive.term import DriveTerm, JointSamples


@dataclass(frozen=True, slots=True)
class LoadFriction(DriveTerm):
    """``load_friction s(dq) |load|``, a pure number; ``s`` is the `direction`.

    The load is computed from known inertial parameters, not measured: a measured torque
    would bring its noise into the regressor, and bias, and no prediction could have it.
    """

    names = ("load_friction",)
    unit = ("1", "1")
    nonnegative = True
    needs_load = True
    shape_parameters = VELOCITY_SCALE

    velocity_scale: float | None = None

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the direction times the size of the transmitted torque."""
        return [direction(joint.dq, self.velocity_scale) * abs(joint.load)]

    def smoothed(self, velocity: float) -> Self:
        """Return the term with a slope in place of the jump."""
        return without_jump(self, velocity)

    @property
    def options(self) -> dict[str, Any]:
        """The keywords of `DriveTerms` that choose this term."""
        return {"load_friction": True, **direction_options(self.velocity_scale)}

    @classmethod
    def from_options(cls, options: Mapping[str, Any]) -> Self | None:
        """Return the term that the keywords of `DriveTerms` choose, if they do."""
        if not options["load_friction"]:
            return None
        return cls(chosen_scale("load_friction", options))
