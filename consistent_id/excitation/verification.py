"""The last word on a path: what is proven of it, over its whole duration."""

from dataclasses import dataclass

from consistent_id._arrays import Matrix
from consistent_id.excitation.limits import MotionLimits
from consistent_id.excitation.margins import MotionMargins, motion_margins
from consistent_id.paths import JointPath
from consistent_id.regressor import TorqueModel


@dataclass(frozen=True, slots=True, eq=False)
class Demands:
    """All that a path must keep to.

    Parameters
    ----------
    limits : MotionLimits
    model : TorqueModel
    parameters : ndarray, shape (members, parameters), optional
        With which torque is predicted; without them it is not looked at.
    """

    limits: MotionLimits
    model: TorqueModel
    parameters: Matrix | None

    def proof(self, path: JointPath) -> "Proof":
        """Prove what can be proven of a path."""
        predicted = self.parameters is not None
        margins = motion_margins(
            path,
            self.limits,
            model=self.model if predicted else None,
            parameters=self.parameters,
        )
        return Proof(margins)


@dataclass(frozen=True, slots=True, eq=False)
class Proof:
    """What is proven of a path.

    Parameters
    ----------
    margins : MotionMargins
    """

    margins: MotionMargins

    @property
    def holds(self) -> bool:
        """Tell whether everything that was demanded is proven."""
        return self.margins.holds

    def require(self) -> None:
        """Raise unless everything is proven; the error names the worst."""
        self.margins.require()
