"""Motors and gears: what a datasheet says of them, and which are of one type."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.constraints.parameter_constraints import ParameterBounds
from consistent_id.constraints.rows import equalities, fixed_values, unit_row
from consistent_id.errors import ProblemError
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.parameters import did_you_mean


@dataclass(frozen=True, slots=True)
class Motor:
    """A motor behind a gear.

    Parameters
    ----------
    inertia : float, [kg m^2]
        Of rotor, brake and what turns with them, on the motor's side.
    gear_ratio : float, [rad/rad] or [rad/m]
        Turns of the motor per turn, or metre, of the joint; of either sign.

    Examples
    --------
    >>> print(f"{Motor(inertia=1e-4, gear_ratio=-100.0).reflected:.3g} kg m^2")
    1 kg m^2
    """

    inertia: float
    gear_ratio: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.inertia < np.inf:
            raise ProblemError(
                f"motor inertia is {self.inertia} kg m^2, expected 0 or more"
            )
        if not 0.0 < abs(self.gear_ratio) < np.inf:
            raise ProblemError(
                f"gear ratio is {self.gear_ratio}, expected a number other than 0"
            )

    @property
    def reflected(self) -> float:
        """Inertia seen from the link: gear ratio squared times the motor's."""
        return self.gear_ratio**2 * self.inertia


@dataclass(frozen=True, slots=True)
class RotorInertias:
    """Rotor inertias as their motors' datasheets have them.

    Parameters
    ----------
    motors : mapping of str to Motor
        By joint; the joint's torque model needs the term ``rotor_inertia``.
    tolerance : float
        Share by which the inertia seen from the link may differ from the datasheet's;
        0 holds it there.
    """

    motors: Mapping[str, Motor]
    tolerance: float = 0.0

    def __post_init__(self) -> None:
        if not self.motors:
            raise ProblemError("RotorInertias: no motor; leave this constraint out")
        if not 0.0 <= self.tolerance < np.inf:
            raise ProblemError(
                f"tolerance of rotor inertias is {self.tolerance}, expected 0 or more"
            )

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ``rotor_inertia = value``, or a band around it, per joint.

        Raises
        ------
        ProblemError
            If there is no such joint, or its torque has no such term.
        """
        known = {joint for joint, term in model.layout.drive if term == "rotor_inertia"}
        for joint in self.motors:
            if joint not in known:
                near = did_you_mean(joint, sorted(known))
                raise ProblemError(
                    f"motor of {joint!r}: no joint of that name has the drive term "
                    f"rotor_inertia; {near}"
                )
        values = {
            f"{joint}.rotor_inertia": motor.reflected
            for joint, motor in self.motors.items()
        }
        if self.tolerance == 0.0:
            return fixed_values(values, model.layout)
        less, more = max(1.0 - self.tolerance, 0.0), 1.0 + self.tolerance
        return ParameterBounds(
            {name: (less * value, more * value) for name, value in values.items()}
        ).lower(model)


@dataclass(frozen=True, slots=True)
class EqualMotors:
    """Joints whose motors and gears are of one type: terms of equal value.

    Parameters
    ----------
    joints : sequence of str
        Two or more.
    terms : sequence of str
        Coefficients that are equal; friction of equal drives usually is not.
    """

    joints: Sequence[str]
    terms: Sequence[str] = ("rotor_inertia",)

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return one equality for each term and joint after the first.

        Raises
        ------
        ProblemError
            If there are fewer than two joints, or a joint lacks a term.
        """
        joints = tuple(self.joints)
        if len(set(joints)) != len(joints) or len(joints) < 2:
            raise ProblemError(
                f"equal motors of {joints}: expected two or more distinct joints"
            )
        rows, labels = [], []
        for term in self.terms:
            names = [f"{joint}.{term}" for joint in joints]
            for joint, name in zip(joints, names, strict=True):
                if (joint, term) not in model.layout.drive:
                    having = sorted(j for j, t in model.layout.drive if t == term)
                    raise ProblemError(
                        f"equal motors: {joint!r} has no drive term {term}; "
                        f"{did_you_mean(joint, having)}"
                    )
                if name != names[0]:
                    first = unit_row(model.layout, names[0])
                    rows.append(unit_row(model.layout, name) - first)
                    labels.append(f"{name} = {names[0]}")
        return equalities(rows, [0.0] * len(rows), labels, model)
