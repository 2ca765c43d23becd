"""The content of a report, and its sections."""

from dataclasses import dataclass
from typing import NamedTuple

from consistent_id.comparison.comparison import Comparison, EstimateReport
from consistent_id.comparison.constraint_prices import ConstraintCost, ShadowPrice
from consistent_id.diagnosis import Diagnosis
from consistent_id.estimation.cross_validation import RegularisationPath
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.method import Method
from consistent_id.estimation.uncertainties.parameter_uncertainty import Uncertainty
from consistent_id.problems.problem import Problem
from consistent_id.problems.published import PublishedReport
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import Excitation
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_names import in_newton
from consistent_id.report.advice import Advice
from consistent_id.report.markup import Html
from consistent_id.robot.model import Joint


@dataclass(frozen=True, slots=True, eq=False)
class ReportContent:
    """The content of a report; unknown parts are None or empty.

    Parameters
    ----------
    uncertainty : Uncertainty, optional
        Uncertainty of the constrained estimate.
    delivered : Estimate, optional
        The recommended estimate, fitted again to all data.
    further : tuple of Section
        Additional sections, such as that of rollouts.
    seed : int, optional
        Seed of the bootstrap.
    command : str
        Command that reproduces the report.
    """

    title: str
    comparison: Comparison
    advice: Advice
    training: tuple[Recording, ...] = ()
    validation: tuple[Recording, ...] = ()
    problem: Problem | None = None
    excitation: Excitation | None = None
    diagnosis: Diagnosis | None = None
    uncertainty: Uncertainty | None = None
    costs: tuple[ConstraintCost, ...] = ()
    prices: tuple[ShadowPrice, ...] = ()
    path: RegularisationPath | None = None
    published: PublishedReport | None = None
    delivered: Estimate | None = None
    further: tuple["Section", ...] = ()
    seed: int | None = None
    command: str = ""

    @property
    def model(self) -> TorqueModel:
        """The torque model that all estimates are of."""
        return self.comparison.model

    @property
    def main(self) -> EstimateReport:
        """The estimate that the report is about: the recommended one.

        See `advise`.
        """
        return self.comparison[self.advice.verdict.method]

    @property
    def plain(self) -> EstimateReport | None:
        """Least squares, to compare with, if it is not the main one."""
        for report in self.comparison.reports:
            if (
                report.estimate.method == Method.LEAST_SQUARES
                and report is not self.main
            ):
                return report
        return None

    @property
    def held_out(self) -> tuple[Recording, ...]:
        """Validation recordings, or the training recordings if there are none."""
        return self.validation or self.training

    @property
    def rows(self) -> tuple["Row", ...]:
        """The measured and predicted rows: torques of joints, the wrench on a base."""
        robot, names = self.model.robot, self.model.torque_joints
        joints = {joint.name: joint for joint in robot.driven}
        units = ("N" if in_newton(robot, name) else "N m" for name in names)
        return tuple(
            Row(column, name, unit, joints.get(name))
            for column, (name, unit) in enumerate(zip(names, units, strict=True))
        )

    @property
    def joint_rows(self) -> tuple[tuple[int, Joint], ...]:
        """Column and joint of the rows that are joints' torques."""
        return tuple((row.column, row.joint) for row in self.rows if row.joint)


class Row(NamedTuple):
    """One column of measured and predicted torque.

    Attributes
    ----------
    column : int
    name : str
        Name of the joint, or of the component of a base's wrench.
    unit : str
    joint : Joint or None
    """

    column: int
    name: str
    unit: str
    joint: Joint | None


@dataclass(frozen=True, slots=True)
class Section:
    """One part of the report, which stands by itself.

    Parameters
    ----------
    name : str
        Anchor in the page.
    """

    name: str
    title: str
    body: Html


def torque_unit(joint: Joint) -> str:
    """Return the unit of a joint's torque."""
    return "N" if joint.kind == "prismatic" else "N m"


def angle_unit(joint: Joint) -> str:
    """Return the unit of a joint's position."""
    return "m" if joint.kind == "prismatic" else "rad"
