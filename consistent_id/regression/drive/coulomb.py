"""Coulomb friction, with one level or with one for each direction."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from consistent_id.regression.drive.term import (
    SPEED,
    TORQUE,
    DriveTerm,
    JointSamples,
    ShapeParameter,
)

VELOCITY_SCALE = {"velocity_scale": ShapeParameter(SPEED, 1e-3, 1.0)}


@dataclass(frozen=True, slots=True)
class Coulomb(DriveTerm):
    """``coulomb s(dq)``, [N m or N], ``s`` being `direction`."""

    names = ("coulomb",)
    unit = TORQUE
    nonnegative = True
    simulated_as = "friction"
    shape_parameters = VELOCITY_SCALE

    velocity_scale: float | None = None

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the direction of motion."""
        return [direction(joint.dq, self.velocity_scale)]


@dataclass(frozen=True, slots=True)
class AsymmetricCoulomb(DriveTerm):
    """``coulomb_positive max(s, 0) + coulomb_negative min(s, 0)``, ``s = s(dq)``.

    Both levels are positive where friction dissipates in both directions.
    """

    names = ("coulomb_positive", "coulomb_negative")
    unit = TORQUE
    nonnegative = True
    simulated_as = "friction"
    shape_parameters = VELOCITY_SCALE

    velocity_scale: float | None = None

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the positive and the negative part of the direction."""
        s = direction(joint.dq, self.velocity_scale)
        return [(s + abs(s)) / 2, (s - abs(s)) / 2]


def direction(dq: Any, velocity_scale: float | None) -> Any:
    """Return ``s(dq)``: the sign of a rate, or ``tanh(dq / velocity_scale)``."""
    return np.sign(dq) if velocity_scale is None else np.tanh(dq / velocity_scale)
