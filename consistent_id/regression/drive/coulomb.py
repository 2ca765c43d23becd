"""Coulomb friction, with one level or with one for each direction."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol, Self, TypeVar, get_args

import numpy as np

from consistent_id.errors import ProblemError
from consistent_id.regression.drive.term import (
    SPEED,
    TORQUE,
    DriveTerm,
    JointSamples,
    ShapeParameter,
)

CoulombShape = Literal["sign", "tanh", "none"]

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

    def smoothed(self, velocity: float) -> Self:
        """Return the term with a slope in place of the jump."""
        return without_jump(self, velocity)

    @property
    def options(self) -> dict[str, Any]:
        """The keywords of `DriveTerms` that choose this term."""
        return direction_options(self.velocity_scale)

    @classmethod
    def from_options(cls, options: Mapping[str, Any]) -> Self | None:
        """Return the term that the keywords of `DriveTerms` choose, if they do."""
        require_direction_options(options["coulomb"], options["velocity_scale"])
        if options["coulomb"] == "none" or options["asymmetric"]:
            return None
        return cls(options["velocity_scale"])


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

    def smoothed(self, velocity: float) -> Self:
        """Return the term with a slope in place of the jump."""
        return without_jump(self, velocity)

    @property
    def options(self) -> dict[str, Any]:
        """The keywords of `DriveTerms` that choose this term."""
        return {"asymmetric": True, **direction_options(self.velocity_scale)}

    @classmethod
    def from_options(cls, options: Mapping[str, Any]) -> Self | None:
        """Return the term that the keywords of `DriveTerms` choose, if they do."""
        if not options["asymmetric"]:
            return None
        if options["offset"]:
            raise ProblemError(
                "asymmetric Coulomb friction and an offset differ near standstill "
                "alone; choose one of them"
            )
        return cls(chosen_scale("asymmetric", options))


def direction(dq: Any, velocity_scale: float | None) -> Any:
    """Return ``s(dq)``: the sign of a rate, or ``tanh(dq / velocity_scale)``."""
    return np.sign(dq) if velocity_scale is None else np.tanh(dq / velocity_scale)


class _Directed(Protocol):
    @property
    def velocity_scale(self) -> float | None: ...


_T = TypeVar("_T", bound=_Directed)


def without_jump(term: _T, velocity: float) -> _T:
    """Return a term that depends on the direction of motion, with a slope in it."""
    if term.velocity_scale is not None:
        return term
    return replace(term, velocity_scale=velocity)  # type: ignore[type-var]


def direction_options(velocity_scale: float | None) -> dict[str, Any]:
    """Return the keywords that say how a term depends on the direction of motion."""
    shape = "sign" if velocity_scale is None else "tanh"
    return {"coulomb": shape, "velocity_scale": velocity_scale}


def chosen_scale(name: str, options: Mapping[str, Any]) -> float | None:
    """Return the velocity scale of a term that needs a direction of motion.

    Raises
    ------
    ProblemError
        If there is no such direction.
    """
    if options["coulomb"] == "none":
        raise ProblemError(
            f'{name} is {options[name]}, but coulomb is "none"; it needs a direction '
            'of motion: choose coulomb "sign" or "tanh"'
        )
    scale: float | None = options["velocity_scale"]
    return scale


def require_direction_options(shape: str, velocity_scale: float | None) -> None:
    """Refuse a shape that is unknown, or does not go with the velocity scale."""
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
