"""The content of a report: its sections, and the advice on which estimate to use."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from consistent_id._support.tables import brief
from consistent_id.comparison.comparison import Comparison, EstimateReport
from consistent_id.comparison.constraint_prices import ConstraintCost, ShadowPrice
from consistent_id.diagnosis import Diagnosis
from consistent_id.estimation.cross_validation import RegularisationPath
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.method import Method
from consistent_id.estimation.recommendation import Recommendation
from consistent_id.estimation.uncertainties.parameter_uncertainty import Uncertainty
from consistent_id.estimation.verdict import Verdict, Word, percent
from consistent_id.problems.problem import Problem
from consistent_id.problems.published import PublishedReport
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import Excitation
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_names import in_newton
from consistent_id.report.markup import Html
from consistent_id.robot.model import Joint

_FIRST = (Method.CONSTRAINED, Method.WEIGHTED_CONSTRAINED, Method.CROSS_VALIDATED)
_UNKNOWN = "error to expect on a motion not seen: unknown, most of it would be guessed"
_NOTABLE = 0.02  # relative difference of held-out errors


@brief
@dataclass(frozen=True, slots=True)
class Advice:
    """The advice on the estimates.

    Parameters
    ----------
    verdict : Verdict
        On the estimate that is recommended.
    method : str
        Method of the estimate to use; empty for none.
    headline : str
        The verdict in one line, with the held-out error.
    expected : tuple of str
        The error to expect on a motion not seen, with its range; empty without a
        recommendation.
    reasons : tuple of str
        Reasons for this one.
    cautions : tuple of str
        The verdict's reasons, with advice.
    also : tuple of str
        Other usable estimates.
    """

    verdict: Verdict
    method: str
    headline: str
    expected: tuple[str, ...]
    reasons: tuple[str, ...]
    cautions: tuple[str, ...]
    also: tuple[str, ...] = ()

    @property
    def level(self) -> Word:
        """The verdict's word."""
        return self.verdict.word


def advise(
    comparison: Comparison,
    diagnosis: Diagnosis | None = None,
    *,
    recommendation: Recommendation | None = None,
) -> Advice:
    """Return the advice on which estimate to use.

    It is the recommended one; without a recommendation the first of constrained,
    weighted constrained, cross-validated and any other that may be used.  Held-out data
    are not used for the choice, so it does not bias the error on them.

    Parameters
    ----------
    comparison : Comparison
    diagnosis : Diagnosis, optional
        Diagnosis of the recordings, if the comparison was made without.
    recommendation : Recommendation, optional
        Chosen from the training data.
    """
    if diagnosis is not None:
        found = diagnosis.findings
        reports = tuple(replace(r, findings=found) for r in comparison.reports)
        comparison = replace(comparison, reports=reports)
    chosen = (
        _first(comparison)
        if recommendation is None
        else comparison[recommendation.method]
    )
    verdict = chosen.verdict
    rivals = [r for r in comparison.reports if r is not chosen]
    plain = next((r for r in rivals if _is_plain(r)), None)
    others = "" if recommendation is None else recommendation.others
    return Advice(
        verdict,
        chosen.estimate.method if verdict.usable else "",
        verdict.compared(None if plain is None else plain.held_out_error),
        _expected(recommendation, verdict),
        (
            *((others,) if others else ()),
            *(() if plain is None else (_against(plain),)),
        ),
        verdict.lines,
        _better(chosen, rivals),
    )


def _expected(
    recommendation: Recommendation | None, verdict: Verdict
) -> tuple[str, ...]:
    """Return the error to expect; no figure where most of it would be guessed."""
    if recommendation is None:
        return ()
    refused = [reason.kind for reason in verdict.reasons if reason.word == "do not use"]
    return (_UNKNOWN if "mostly guessed" in refused else recommendation.statement,)


def _first(comparison: Comparison) -> EstimateReport:
    """Return the report to use if nothing was recommended."""
    usable = list(comparison.usable)
    named = {r.estimate.method: r for r in usable}
    first = [named[method] for method in _FIRST if method in named]
    constrained = [r for r in comparison.reports if r.estimate.method in _FIRST]
    return next(iter([*first, *usable, *constrained, *comparison.reports]))


def _is_plain(report: EstimateReport) -> bool:
    return report.estimate.method == Method.LEAST_SQUARES


def _against(report: EstimateReport) -> str:
    """Return the reasons against least squares."""
    verdict = report.verdict
    grounds = ", ".join(dict.fromkeys(r.kind for r in verdict.grounds))
    why = grounds or "every link is consistent here, but no constraint ensures it"
    return f"{report.estimate.method}: {verdict.word} ({why})"


def _better(
    chosen: EstimateReport, others: Sequence[EstimateReport]
) -> tuple[str, ...]:
    own = chosen.held_out_error
    rivals = [(r.held_out_error, r) for r in others if r.verdict.usable]
    said = [
        f"{r.estimate.method} ({percent(error)})"
        for error, r in rivals
        if own and error is not None and error < (1 - _NOTABLE) * own
    ]
    if not said:
        return ()
    return (
        f"also usable, with a smaller held-out error: {', '.join(said)}; held-out "
        "recordings are not used to choose",
    )


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
