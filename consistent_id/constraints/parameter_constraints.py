"""Constraints on parameters by name, on friction, drives, motors and gears."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.tables import brief
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.constraints.rows import (
    equalities,
    fixed_values,
    inequalities,
    unit_row,
)
from consistent_id.errors import ProblemError
from consistent_id.regression.drive.drive_terms import LAWS
from consistent_id.regression.drive.gear_coupling import COUPLING_NAMES
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.parameters import did_you_mean


@brief
@dataclass(frozen=True, slots=True)
class Motor:
    """A motor behind a gear.

    Parameters
    ----------
    inertia : float, [kg m^2]
        Inertia of rotor, brake and other parts that turn with them, on the motor's
        side.
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


@brief
@dataclass(frozen=True, slots=True)
class RotorInertias:
    """Rotor inertias as in their motors' datasheets.

    Parameters
    ----------
    motors : mapping of str to Motor
        By joint; the joint's torque model needs the term ``rotor_inertia``.
    tolerance : float
        Share by which the inertia seen from the link may differ from the datasheet's; 0
        fixes it.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(rotor_inertia=True))
    >>> motor = ci.constraints.Motor(inertia=1e-4, gear_ratio=100.0)
    >>> ci.RotorInertias({"joint1": motor}).lower(model).b_eq
    array([1.])
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


@brief
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


@brief
@dataclass(frozen=True, slots=True)
class NonNegativeDrive:
    """Friction dissipates energy; rotors and springs store it.

    Both Coulomb levels of an asymmetric joint are positive; friction at rest is no less
    than the Coulomb level (``stribeck >= 0``); loaded gears have more of it.  Where
    friction varies with position, its level is positive at both limits of the joint.

    Parameters
    ----------
    terms : tuple of str, optional
        Names of the coefficients; by default those of the joints' terms that are called
        `nonnegative` (see `DriveTerm`).
    dissipative : bool
        Whether friction may grow less than in proportion to the speed: `drag` may be
        negative where it and viscous friction together dissipate up to the joint's
        speed limit.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True, coulomb="sign"))
    >>> ci.NonNegativeDrive().lower(model).labels
    ('joint1.viscous >= 0', 'joint1.coulomb >= 0')
    """

    terms: tuple[str, ...] | None = None
    dissipative: bool = False

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ``x_i >= 0`` for the named terms of all joints.

        Raises
        ------
        ProblemError
            If a name is unknown, or the friction of a joint without limits varies with
            position.
        """
        layout = model.layout
        every = [term for joint in model.terms for term in joint.terms]
        names_of = [
            *(law.names for law in LAWS.values()),
            *(term.names for term in every),
        ]
        known = dict.fromkeys(n for names in (*names_of, COUPLING_NAMES) for n in names)
        if self.terms is None:
            signed = {name for t in every if t.nonnegative for name in t.names}
            names = [name for name in known if name in signed]
        else:
            names = list(self.terms)
        unknown = sorted(set(names) - set(known))
        if unknown:
            raise ProblemError(
                f"drive terms {unknown} are unknown; known: {', '.join(known)}"
            )
        sloped = _sloped(model) if "coulomb" in names else {}
        dragged = _dragged(model) if self.dissipative and "drag" in names else {}
        indices = [
            i
            for name in names
            for i in layout.drive_indices(name)
            if not (name == "coulomb" and layout.names[i] in sloped)
            and layout.names[i] not in dragged
        ]
        rows = [-unit_row(layout, layout.names[i]) for i in indices]
        labels = [f"{layout.names[i]} >= 0" for i in indices]
        for level, (slope, limits) in sloped.items():
            for q in limits:
                rows.append(-unit_row(layout, level) - q * unit_row(layout, slope))
                labels.append(f"{level} + {q:.4g} {slope} >= 0")
        for drag, (viscous, speed) in dragged.items():
            rows.append(-unit_row(layout, viscous) - speed * unit_row(layout, drag))
            labels.append(f"{viscous} + {speed:.4g} {drag} >= 0")
        return inequalities(rows, [0.0] * len(rows), labels, model)


@brief
@dataclass(frozen=True, slots=True)
class SharedMotors:
    """Couplings from one motor that turns with the sum of two joints' rates.

    The contributions of such motors to a joint are not negative, and their sum is at
    most the joint's own viscous friction and inertia.
    """

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ``0 <= coupling``, and ``sum of couplings <= own term`` of a joint.

        Raises
        ------
        ProblemError
            If the model has no coupling, or a joint lacks a term of its own.
        """
        layout = model.layout
        if not model.couplings:
            raise ProblemError(
                "SharedMotors: the model has no gear coupling; give it one, or leave "
                "this constraint out"
            )
        rows, labels = [], []
        parts: dict[str, list[str]] = {}
        for coupling in model.couplings:
            for term in coupling.names:
                name = f"{coupling.label}.{term}"
                rows.append(-unit_row(layout, name))
                labels.append(f"{name} >= 0")
                if term == "coupling_coulomb":
                    continue  # it has a separate motion, the sum of both rates
                for joint in (coupling.first, coupling.second):
                    own = f"{joint}.{term.removeprefix('coupling_')}"
                    parts.setdefault(own, []).append(name)
        for own, names in parts.items():
            total = np.sum([unit_row(layout, name) for name in names], axis=0)
            rows.append(total - unit_row(layout, own))
            labels.append(f"{' + '.join(names)} <= {own}")
        return inequalities(rows, [0.0] * len(rows), labels, model)


@brief
@dataclass(frozen=True, slots=True)
class FixedParameters:
    """Parameters known exactly, by name, such as ``{"link2.hx": 1.48}``."""

    values: Mapping[str, float]

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ``x_i = value``."""
        return fixed_values(self.values, model.layout)


@brief
@dataclass(frozen=True, slots=True)
class ParameterBounds:
    """Parameters between bounds, by name, such as ``{"elbow.viscous": (0, 20)}``.

    An infinite bound is no bound, and equal ones make an equality.
    """

    bounds: Mapping[str, tuple[float, float]]

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ``low <= x_i <= high``, or ``x_i = low`` where both are equal."""
        rows, limits, labels = [], [], []
        known = ConicSet.everything(len(model.layout))
        for name, (low, high) in self.bounds.items():
            if not low <= high:
                raise ProblemError(f"bounds of {name}: {low:g} is not below {high:g}")
            row = unit_row(model.layout, name)
            if low == high and np.isfinite(low):
                label = f"{name} = {low:g}"
                known &= ConicSet.equal(row[None], np.array([low]), [label])
                continue
            for sign, limit, text in ((-1.0, low, ">="), (1.0, high, "<=")):
                if np.isfinite(limit):
                    rows.append(sign * row)
                    limits.append(sign * limit)
                    labels.append(f"{name} {text} {limit:g}")
        return known & inequalities(rows, limits, labels, model)


@brief
@dataclass(frozen=True, slots=True)
class LinearRelation:
    """A linear relation of parameters: ``lower <= sum_i c_i x_i <= upper``.

    Parameters
    ----------
    terms : mapping of str to float
        Coefficients by parameter.
    lower, upper : float
        Equal bounds make an equality; an infinite one is no bound.
    """

    terms: Mapping[str, float]
    lower_bound: float = -np.inf
    upper_bound: float = np.inf

    def __post_init__(self) -> None:
        if not self.terms:
            raise ProblemError("a linear relation has no terms")
        if not self.lower_bound <= self.upper_bound:
            raise ProblemError(
                f"linear relation: {self.lower_bound:g} is not below "
                f"{self.upper_bound:g}"
            )

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return one equality, or up to two inequalities."""
        row = sum(c * unit_row(model.layout, name) for name, c in self.terms.items())
        row = np.asarray(row)[None]
        text = " + ".join(f"{c:g} {name}" for name, c in self.terms.items())
        low, high = self.lower_bound, self.upper_bound
        if low == high:
            return ConicSet.equal(row, np.array([low]), [f"{text} = {low:g}"])
        whole = ConicSet.everything(len(model.layout))
        if np.isfinite(low):
            whole &= ConicSet.at_most(-row, np.array([-low]), [f"{text} >= {low:g}"])
        if np.isfinite(high):
            whole &= ConicSet.at_most(row, np.array([high]), [f"{text} <= {high:g}"])
        return whole


def _dragged(model: TorqueModel) -> dict[str, tuple[str, float]]:
    """Return drag beside viscous friction: the latter, and the joint's speed limit."""
    return {
        f"{joint.name}.drag": (f"{joint.name}.viscous", joint.limits.velocity)
        for joint, terms in zip(model.robot.driven, model.terms, strict=True)
        if {"viscous", "drag"} <= set(terms.names)
        and 0.0 < joint.limits.velocity < np.inf
    }


def _sloped(model: TorqueModel) -> dict[str, tuple[str, tuple[float, float]]]:
    """Return Coulomb levels that vary with position: their slopes, joints' limits."""
    found = {}
    for joint, terms in zip(model.robot.driven, model.terms, strict=True):
        if {"coulomb", "friction_slope"} <= set(terms.names):
            limits = joint.limits.lower, joint.limits.upper
            if joint.kind == "continuous" or not np.isfinite(limits).all():
                raise ProblemError(
                    f"the friction of {joint.name} varies with position, but the joint "
                    "has no limits between which it would dissipate; give it limits, "
                    "or leave friction_slope out there"
                )
            found[f"{joint.name}.coulomb"] = (f"{joint.name}.friction_slope", limits)
    return found
