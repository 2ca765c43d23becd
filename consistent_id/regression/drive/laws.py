"""The friction laws and drive terms that are built in; `DriveTerms` chooses."""

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


def direction(dq: Any, velocity_scale: float | None) -> Any:
    """Return ``s(dq)``: the sign of a rate, or ``tanh(dq / velocity_scale)``."""
    return np.sign(dq) if velocity_scale is None else np.tanh(dq / velocity_scale)


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


@dataclass(frozen=True, slots=True)
class Drag(DriveTerm):
    """``drag dq |dq|``, as of fluids and fans, [N m s^2/rad^2 or N s^2/m^2]."""

    names = ("drag",)
    unit = ("N m s^2/rad^2", "N s^2/m^2")
    smooth = nonnegative = True

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the square of the rate, with its sign."""
        return [joint.dq * abs(joint.dq)]


@dataclass(frozen=True, slots=True)
class Offset(DriveTerm):
    """A constant, [N m or N]."""

    names = ("offset",)
    unit = TORQUE
    smooth = polynomial = True

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the number one."""
        return [1.0]


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
