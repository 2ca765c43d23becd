"""Terms of two joints whose gears are coupled."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.regression.drive.drive_terms import CoulombShape, DriveTerms
from consistent_id.regression.drive.laws import Coulomb
from consistent_id.regression.drive.term import DriveTerm, JointSamples, term_columns
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import require_known

COUPLING_NAMES = ("coupling_viscous", "coupling_coulomb", "coupling_rotor_inertia")


@brief
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
    def terms(self) -> tuple[DriveTerm, ...]:
        """The terms that the joints share, in the order of their columns."""
        return DriveTerms(
            viscous=self.viscous,
            coulomb=self.coulomb,
            velocity_scale=self.velocity_scale,
            rotor_inertia=self.rotor_inertia,
        ).terms

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the terms in use, in the order of their columns."""
        return tuple(f"coupling_{n}" for term in self.terms for n in term.names)

    @property
    def shapes(self) -> dict[str, float]:
        """Numbers that the columns' shapes depend on, by name."""
        return {k: v for term in self.terms for k, v in term.shapes.items()}

    def columns(self, dq: Sequence[Any], ddq: Sequence[Any]) -> list[tuple[Any, Any]]:
        """Return the terms' columns in the rows of the first and the second joint.

        `dq` and `ddq` hold the motion of the first and the second joint.
        """
        pairs = []
        for term in self.terms:
            # Coulomb friction is that of the sum of the rates, in both rows alike.
            of_sum = isinstance(term, Coulomb)
            rates = (dq[0] + dq[1],) * 2 if of_sum else (dq[1], dq[0])
            first, second = (
                term_columns(term, JointSamples(None, rate, acceleration))
                for rate, acceleration in zip(rates, (ddq[1], ddq[0]), strict=True)
            )
            pairs += list(zip(first, second, strict=True))
        return pairs

    def smoothed(self, velocity: float) -> "GearCoupling":
        """Return the coupling with a slope in place of a jump at standstill."""
        if self.coulomb != "sign":
            return self
        return replace(self, coulomb="tanh", velocity_scale=velocity)


def coupled_joints(robot: RobotModel, coupling: GearCoupling) -> tuple[int, int]:
    """Return the places of the two joints of a coupling.

    Raises
    ------
    ProblemError
        If there is no such joint, or one turns and the other slides.
    """
    places = []
    for name in (coupling.first, coupling.second):
        require_known([name], robot.joint_names, f"coupling {coupling.label}: no joint")
        places.append(robot.joint_names.index(name))
    first, second = places
    slide = [robot.driven[j].kind == "prismatic" for j in places]
    if slide[0] != slide[1]:
        raise ProblemError(
            f"coupling {coupling.label}: one joint turns, the other slides; the sum of "
            "their rates means nothing"
        )
    return first, second
