"""Coulomb friction of loaded gears."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from consistent_id.regression.drive.coulomb import VELOCITY_SCALE, direction
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
