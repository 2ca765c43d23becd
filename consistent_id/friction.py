"""Friction and drive terms: columns that depend on one joint's own motion."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from consistent_id._arrays import Array
from consistent_id.errors import ProblemError
from consistent_id.parameters import DRIVE_NAMES

CoulombShape = Literal["sign", "tanh", "none"]


@dataclass(frozen=True, slots=True)
class DriveTerms:
    """Which terms a joint's torque has besides the rigid-body ones.

    ``tau = viscous dq + coulomb s(dq) + offset + rotor_inertia ddq``

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

    Examples
    --------
    >>> DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02).names
    ('viscous', 'coulomb')
    """

    viscous: bool = False
    coulomb: CoulombShape = "none"
    velocity_scale: float | None = None
    offset: bool = False
    rotor_inertia: bool = False

    def __post_init__(self) -> None:
        if self.coulomb not in get_args(CoulombShape):
            known = ", ".join(get_args(CoulombShape))
            raise ProblemError(f"coulomb is {self.coulomb!r}, expected one of {known}")
        if self.coulomb == "tanh":
            if self.velocity_scale is None or not 0 < self.velocity_scale < np.inf:
                raise ProblemError(
                    f"velocity_scale is {self.velocity_scale}; a tanh Coulomb term "
                    "needs the positive velocity at which it saturates"
                )
        elif self.velocity_scale is not None:
            raise ProblemError(
                f"velocity_scale is {self.velocity_scale}, but coulomb is "
                f"{self.coulomb!r}; only 'tanh' has a scale"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the terms in use, in the order of their columns."""
        used = (self.viscous, self.coulomb != "none", self.offset, self.rotor_inertia)
        return tuple(n for n, use in zip(DRIVE_NAMES, used, strict=True) if use)

    def columns(self, dq: Array, ddq: Array) -> list[Array]:
        """Return the terms' columns for one joint's samples, each shape (samples,)."""
        compute: dict[str, Callable[[], Array]] = {
            "viscous": lambda: dq,
            "coulomb": lambda: self._coulomb(dq),
            "offset": lambda: np.ones_like(dq),
            "rotor_inertia": lambda: ddq,
        }
        return [compute[name]() for name in self.names]

    def _coulomb(self, dq: Array) -> Array:
        if self.velocity_scale is None:
            return np.sign(dq)
        return np.tanh(dq / self.velocity_scale)


def drive_unit(term: str, slides: bool) -> str:
    """Return the unit of a drive term of a turning or a sliding joint."""
    torque, coordinate = ("N", "m") if slides else ("N m", "rad")
    return {
        "viscous": f"{torque} s/{coordinate}",
        "coulomb": torque,
        "offset": torque,
        "rotor_inertia": "kg" if slides else "kg m^2",
    }[term]
