"""Friction and drive terms: columns that depend on the joints' own motion."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from consistent_id.errors import ProblemError
from consistent_id.regression.drive_terms import (
    AsymmetricCoulomb,
    Coulomb,
    DriveTerm,
    JointSamples,
    LoadFriction,
    Offset,
    RotorInertia,
    Spring,
    Stribeck,
    Viscous,
    saturated,
)
from consistent_id.robot.parameters import COUPLING_NAMES

CoulombShape = Literal["sign", "tanh", "none"]


@dataclass(frozen=True, slots=True)
class DriveTerms:
    """Which terms a joint's torque has besides the rigid-body ones.

    ``tau = viscous dq + coulomb s(dq) + offset + rotor_inertia ddq + spring q``

    and, where friction is not that simple,

    ``+ s(dq) (stribeck exp(-|dq / stribeck_velocity|^stribeck_exponent)
    + load_friction |load|)``.

    Parameters
    ----------
    viscous : bool
        Term in ``dq``, [N m s/rad] or [N s/m].
    coulomb : {"sign", "tanh", "none"}
        Term in ``sign(dq)`` or ``tanh(dq / velocity_scale)``, [N m] or [N].
    velocity_scale : float, [rad/s] or [m/s]
        Velocity at which the smooth Coulomb term reaches ``tanh(1) = 0.76`` of its
        value; needed for ``"tanh"`` and meaningless otherwise.
    offset : bool
        Constant term, [N m] or [N].
    rotor_inertia : bool
        Term in ``ddq``, reflected through the gear, [kg m^2] or [kg].
    spring : bool
        Term in ``q``, [N m/rad] or [N/m]; with an offset, a spring under preload.
    asymmetric : bool
        Two Coulomb levels instead of one, ``coulomb_positive`` and
        ``coulomb_negative``, one for each direction; instead of an offset, from which
        they differ near standstill alone.
    stribeck_velocity : float, optional, [rad/s] or [m/s]
        Velocity at which what friction at rest has beyond the Coulomb level fades;
        without it there is no such term.
    stribeck_exponent : float
        How abruptly it fades: 2 for a bell, 1 for an exponential.
    load_friction : bool
        Term in ``s(dq) |load|``, a pure number; see `TorqueModel`, which computes the
        load.

    Notes
    -----
    All coefficients are linear in the torque; `velocity_scale`, `stribeck_velocity` and
    `stribeck_exponent` are shapes, which `fit_shapes` finds.

    Examples
    --------
    >>> DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02).names
    ('viscous', 'coulomb')
    >>> DriveTerms(coulomb="sign", asymmetric=True, stribeck_velocity=0.1).names
    ('coulomb_positive', 'coulomb_negative', 'stribeck')
    """

    viscous: bool = False
    coulomb: CoulombShape = "none"
    velocity_scale: float | None = None
    offset: bool = False
    rotor_inertia: bool = False
    spring: bool = False
    asymmetric: bool = False
    stribeck_velocity: float | None = None
    stribeck_exponent: float = 2.0
    load_friction: bool = False

    def __post_init__(self) -> None:
        _check_coulomb(self.coulomb, self.velocity_scale)
        if self.coulomb == "none":
            for name in ("asymmetric", "stribeck_velocity", "load_friction"):
                if getattr(self, name):
                    raise ProblemError(
                        f'{name} is {getattr(self, name)}, but coulomb is "none"; it '
                        'needs a direction of motion: choose coulomb "sign" or "tanh"'
                    )
        if self.asymmetric and self.offset:
            raise ProblemError(
                "asymmetric Coulomb friction and an offset differ near standstill "
                "alone; choose one of them"
            )
        self.terms  # noqa: B018  a shape that makes no sense is refused here

    @property
    def terms(self) -> tuple[DriveTerm, ...]:
        """The terms in use, in the order of their columns."""
        scale = self.velocity_scale
        chosen: list[DriveTerm] = []
        if self.viscous:
            chosen.append(Viscous())
        if self.coulomb != "none":
            shape = AsymmetricCoulomb if self.asymmetric else Coulomb
            chosen.append(shape(scale))
        if self.stribeck_velocity is not None:
            v, exponent = self.stribeck_velocity, self.stribeck_exponent
            chosen.append(Stribeck(v, exponent, scale))
        if self.load_friction:
            chosen.append(LoadFriction(scale))
        if self.offset:
            chosen.append(Offset())
        if self.rotor_inertia:
            chosen.append(RotorInertia())
        if self.spring:
            chosen.append(Spring())
        return tuple(chosen)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients, in the order of their columns."""
        return tuple(name for term in self.terms for name in term.names)

    @property
    def shapes(self) -> dict[str, float]:
        """Numbers that the columns' shapes depend on, by name."""
        names = ["velocity_scale"]
        if self.stribeck_velocity is not None:
            names += ["stribeck_velocity", "stribeck_exponent"]
        values = {name: getattr(self, name) for name in names}
        return {name: value for name, value in values.items() if value is not None}

    def columns(self, q: Any, dq: Any, ddq: Any, load: Any = None) -> list[Any]:
        """Return the coefficients' columns for one joint's samples.

        Like the samples, they are arrays of shape (samples,) or CasADi expressions; the
        offset's is the number one.  `load` is the torque that the joint transmits.
        """
        joint = JointSamples(q, dq, ddq, load)
        return [column for term in self.terms for column in term.columns(joint)]


@dataclass(frozen=True, slots=True)
class GearCoupling:
    """Terms of two joints whose gears are coupled: one motor turns both.

    With ``1`` the first joint and ``2`` the second,

    ``tau1 += viscous dq2 + rotor_inertia ddq2 + coulomb s(dq1 + dq2)``
    ``tau2 += viscous dq1 + rotor_inertia ddq1 + coulomb s(dq1 + dq2)``

    that is, the motor of the second joint moves with the sum of both rates.

    Parameters
    ----------
    first, second : str
        Joints, of one kind.
    viscous : bool
    coulomb : {"sign", "tanh", "none"}
    velocity_scale : float, [rad/s] or [m/s]
    rotor_inertia : bool
        As in `DriveTerms`.

    Notes
    -----
    `NonNegativeDrive` leaves these terms alone: viscous and inertial ones are the
    off-diagonal entries of symmetric matrices, which dissipate or store energy with
    either sign, as long as the entry is small beside the joints' own.  Where they all
    come of a motor that turns with the sum of the rates, the constraint `SharedMotors`
    bounds them.

    Examples
    --------
    >>> GearCoupling("joint5", "joint6", viscous=True, rotor_inertia=True).names
    ('coupling_viscous', 'coupling_rotor_inertia')
    """

    first: str
    second: str
    viscous: bool = False
    coulomb: CoulombShape = "none"
    velocity_scale: float | None = None
    rotor_inertia: bool = False

    def __post_init__(self) -> None:
        _check_coulomb(self.coulomb, self.velocity_scale)
        if self.first == self.second:
            raise ProblemError(f"joint {self.first!r} cannot be coupled to itself")
        if not self.names:
            raise ProblemError(
                f"the coupling of {self.first!r} and {self.second!r} has no term; "
                "choose viscous, coulomb or rotor_inertia"
            )

    @property
    def label(self) -> str:
        """The two joints, as their parameters are named: ``"joint5+joint6"``."""
        return f"{self.first}+{self.second}"

    @property
    def shapes(self) -> dict[str, float]:
        """Numbers that the columns' shapes depend on, by name."""
        scale = self.velocity_scale
        return {} if scale is None else {"velocity_scale": scale}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the terms in use, in the order of their columns."""
        used = (self.viscous, self.coulomb != "none", self.rotor_inertia)
        return tuple(n for n, use in zip(COUPLING_NAMES, used, strict=True) if use)

    def columns(self, dq: Sequence[Any], ddq: Sequence[Any]) -> list[tuple[Any, Any]]:
        """Return the terms' columns in the rows of the first and the second joint.

        `dq` and `ddq` hold the motion of the first and the second joint.
        """

        def shared() -> tuple[Any, Any]:
            both = saturated(dq[0] + dq[1], self.velocity_scale)
            return both, both

        compute: dict[str, Callable[[], tuple[Any, Any]]] = {
            "coupling_viscous": lambda: (dq[1], dq[0]),
            "coupling_coulomb": shared,
            "coupling_rotor_inertia": lambda: (ddq[1], ddq[0]),
        }
        return [compute[name]() for name in self.names]


def drive_unit(term: str, slides: bool) -> str:
    """Return the unit of a drive term of a turning or a sliding joint."""
    torque, coordinate = ("N", "m") if slides else ("N m", "rad")
    return {
        "viscous": f"{torque} s/{coordinate}",
        "coulomb": torque,
        "coulomb_positive": torque,
        "coulomb_negative": torque,
        "stribeck": torque,
        "load_friction": "1",
        "offset": torque,
        "rotor_inertia": "kg" if slides else "kg m^2",
        "spring": f"{torque}/{coordinate}",
    }[term.removeprefix("coupling_")]


def _check_coulomb(shape: str, velocity_scale: float | None) -> None:
    if shape not in get_args(CoulombShape):
        known = ", ".join(get_args(CoulombShape))
        raise ProblemError(f"coulomb is {shape!r}, expected one of {known}")
    if shape == "tanh":
        if velocity_scale is None or not 0 < velocity_scale < np.inf:
            raise ProblemError(
                f"velocity_scale is {velocity_scale}; a tanh Coulomb term needs the "
                "positive velocity at which it saturates"
            )
    elif velocity_scale is not None:
        raise ProblemError(
            f"velocity_scale is {velocity_scale}, but coulomb is {shape!r}; only "
            "'tanh' has a scale"
        )
