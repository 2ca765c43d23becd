"""What friction and drives add to a joint's torque: one small value per idea.

Each has names, and columns that depend on its joint's own motion alone (and on the
torque that the joint transmits), for NumPy arrays and for CasADi expressions alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from consistent_id.errors import ProblemError


class JointSamples(NamedTuple):
    """One joint's samples: arrays of shape (samples,), or CasADi expressions.

    `load` is the torque that the joint transmits, [N m or N], for terms that need it.
    """

    q: Any
    dq: Any
    ddq: Any
    load: Any = None


class DriveTerm(Protocol):
    """Terms of a joint's torque that are linear in their coefficients."""

    names: ClassVar[tuple[str, ...]]

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return one column for each name."""
        ...


@dataclass(frozen=True, slots=True)
class Viscous:
    """``viscous dq``, [N m s/rad or N s/m]."""

    names: ClassVar[tuple[str, ...]] = ("viscous",)

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the rate."""
        return [joint.dq]


@dataclass(frozen=True, slots=True)
class Coulomb:
    """``coulomb s(dq)``, [N m or N], ``s`` being `saturated`."""

    names: ClassVar[tuple[str, ...]] = ("coulomb",)
    velocity_scale: float | None = None

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the sign, rounded off or not."""
        return [saturated(joint.dq, self.velocity_scale)]


@dataclass(frozen=True, slots=True)
class AsymmetricCoulomb:
    """``coulomb_positive max(s, 0) + coulomb_negative min(s, 0)``, ``s = s(dq)``.

    Both levels are positive where friction dissipates in both directions.
    """

    names: ClassVar[tuple[str, ...]] = ("coulomb_positive", "coulomb_negative")
    velocity_scale: float | None = None

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the positive and the negative part of the sign."""
        s = saturated(joint.dq, self.velocity_scale)
        return [(s + abs(s)) / 2, (s - abs(s)) / 2]


@dataclass(frozen=True, slots=True)
class Stribeck:
    """``stribeck s(dq) exp(-|dq / velocity|^exponent)``, [N m or N].

    What friction at rest has beyond the Coulomb level.
    """

    names: ClassVar[tuple[str, ...]] = ("stribeck",)
    velocity: float
    exponent: float = 2.0
    velocity_scale: float | None = None

    def __post_init__(self) -> None:
        for name in ("velocity", "exponent"):
            value = getattr(self, name)
            if not 0.0 < value < np.inf:
                raise ProblemError(
                    f"stribeck_{name} is {value}, expected a positive number"
                )

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the sign, fading with the rate."""
        fading = _exponential(-(abs(joint.dq / self.velocity) ** self.exponent))
        return [saturated(joint.dq, self.velocity_scale) * fading]


@dataclass(frozen=True, slots=True)
class LoadFriction:
    """``load_friction s(dq) |load|``: Coulomb friction of loaded gears, a pure number.

    The load is computed from known inertial parameters, not measured: a measured torque
    would bring its noise into the regressor, and bias, and no prediction could have it.
    """

    names: ClassVar[tuple[str, ...]] = ("load_friction",)
    velocity_scale: float | None = None

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the sign times the size of the transmitted torque."""
        return [saturated(joint.dq, self.velocity_scale) * abs(joint.load)]


@dataclass(frozen=True, slots=True)
class Offset:
    """A constant, [N m or N]."""

    names: ClassVar[tuple[str, ...]] = ("offset",)

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the number one."""
        return [1.0]


@dataclass(frozen=True, slots=True)
class RotorInertia:
    """``rotor_inertia ddq``, seen from the link: gear ratio squared times the motor's.

    In [kg m^2 or kg].
    """

    names: ClassVar[tuple[str, ...]] = ("rotor_inertia",)

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the acceleration."""
        return [joint.ddq]


@dataclass(frozen=True, slots=True)
class Spring:
    """``spring q``, [N m/rad or N/m]."""

    names: ClassVar[tuple[str, ...]] = ("spring",)

    def columns(self, joint: JointSamples) -> Sequence[Any]:
        """Return the position."""
        return [joint.q]


def saturated(dq: Any, velocity_scale: float | None) -> Any:
    """Return ``s(dq)``: the sign of a rate, or ``tanh(dq / velocity_scale)``."""
    # CasADi's expressions have as methods what NumPy has as functions.
    if not isinstance(dq, np.ndarray):
        return dq.sign() if velocity_scale is None else (dq / velocity_scale).tanh()
    return np.sign(dq) if velocity_scale is None else np.tanh(dq / velocity_scale)


def _exponential(x: Any) -> Any:
    return np.exp(x) if isinstance(x, np.ndarray) else x.exp()
