"""Estimates side by side: held-out torque, consistency, distance to nominal."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.given_values import require_types
from consistent_id._support.tables import Table, brief
from consistent_id.comparison.consistency_test import (
    ConsistencyTest,
    consistency_test,
)
from consistent_id.comparison.feasibility import BaseFeasibility, base_feasibility
from consistent_id.constraints.delivered_bodies import (
    LinkCondition,
    link_conditions,
    robot_size,
)
from consistent_id.constraints.priors import pullback_distance
from consistent_id.errors import ProblemError, SolverError
from consistent_id.estimation.drive_ratios import (
    drive_ratios,
    errors_off_bounds,
    log_speeds,
)
from consistent_id.estimation.estimate import Estimate, torque_errors
from consistent_id.estimation.fit import usual_efforts
from consistent_id.estimation.judgement import Evidence, judge
from consistent_id.estimation.method import Method
from consistent_id.estimation.torque_error import (
    Slopes,
    TorqueError,
    stacked_error,
)
from consistent_id.estimation.verdict import Verdict
from consistent_id.recordings.recording import LogFinding, Recording
from consistent_id.regression.mass_matrix import (
    POSES,
    least_mass_eigenvalue,
    random_poses,
)
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.scaling import reference_bodies
from consistent_id.robot.solids import DrawnParts

_UNCONSTRAINED = (Method.LEAST_SQUARES, Method.WEIGHTED_LEAST_SQUARES, Method.HUBER)


@brief
@dataclass(frozen=True, eq=False)
class EstimateReport:
    """All evidence on one estimate.

    Parameters
    ----------
    links : tuple of LinkCondition
        Physical consistency of each link of the standard parameters.
    base_feasibility : BaseFeasibility
        Whether any consistent robot has the estimate's base parameters.
    least_mass_eigenvalue : float, [kg m^2 or kg]
        Smallest eigenvalue of the mass matrix over `POSES` random poses.
    distance_to_nominal : ndarray, shape (links,)
        Pullback distance of each link to its reference body.
    findings : tuple of LogFinding
        Findings in the recordings.
    consistency : ConsistencyTest, optional
        If least squares is impossible: whether the data contradict physics, or noise
        alone explains it.
    crossed : Slopes, optional
        Slopes of joints whose torque is not that of the nominal bodies; see
        `confirmed_slopes`.
    usual_efforts : Vector, optional
        Usual efforts of the training recordings; see `usual_efforts`.
    drawn : DrawnParts, optional
        Shapes of links and nominal drives, of the robot's file.
    speeds : mapping of str to float, [rad/s or m/s]
        RMS speed of each joint in the training recordings.
    """

    estimate: Estimate
    training: tuple[TorqueError, ...]
    validation: tuple[TorqueError, ...]
    links: tuple[LinkCondition, ...]
    base_feasibility: BaseFeasibility
    least_mass_eigenvalue: float
    distance_to_nominal: Vector
    findings: tuple[LogFinding, ...] = ()
    consistency: ConsistencyTest | None = None
    crossed: Slopes | None = None
    usual_efforts: Vector | None = None
    drawn: DrawnParts | None = None
    speeds: Mapping[str, float] = field(default_factory=dict)

    @property
    def possible_links(self) -> tuple[bool, ...]:
        """Whether each link can be consistent, for any other links.

        This is a property of the base parameters: the standard parameters of least
        squares are only the smallest of many vectors that fit equally well.
        """
        wrong = {violation.link for violation in self.base_feasibility.violations}
        return tuple(link.link not in wrong for link in self.links)

    @property
    def consistent_links(self) -> tuple[bool, ...]:
        """Whether each link's pseudo-inertia is positive semidefinite."""
        return tuple(link.consistent for link in self.links)

    @cached_property
    def evidence(self) -> Evidence:
        """The evidence for the verdict."""
        own, drawn = self.estimate, self.drawn or DrawnParts()
        under = () if own.fitted_under is None else own.fitted_under.constraints
        errors = errors_off_bounds(
            own.model.layout, own.parameters, own.parameter_errors, under
        )
        return Evidence(
            method=own.method,
            optimum=own.certificate.verdict,
            optimum_reason=own.certificate.reason,
            links=self.links,
            least_mass_eigenvalue=self.least_mass_eigenvalue,
            fit=own.fit,
            impossible=self.impossibility,
            contradicted="" if self.impossibility else self.contradiction,
            held_out=self.validation,
            findings=self.findings,
            undetermined=own.undetermined,
            accepted=own.accepted,
            loose_trunk=own.loose_trunk,
            size=robot_size(own.model, own.parameters, drawn.reach),
            drives=drive_ratios(own.model, own.parameters, errors, drawn, self.speeds),
            crossed=self.crossed,
            usual_efforts=self.usual_efforts,
        )

    @property
    def impossibility(self) -> str:
        """Why no robot has these parameters, and whether data contradict physics."""
        if self.base_feasibility.answer != "impossible":
            return ""
        summary, test = self.base_feasibility.summary, self.consistency
        return summary if test is None else f"{summary}; {test.sentence}"

    @property
    def contradiction(self) -> str:
        """The evidence of the data against every consistent robot; empty if none."""
        return "" if self.consistency is None else self.consistency.contradiction

    @cached_property
    def verdict(self) -> Verdict:
        """Whether the estimate may be used, and why."""
        return judge(self.evidence)

    @property
    def with_verdict(self) -> Estimate:
        """The estimate with this report's verdict."""
        return replace(self.estimate, judged=self.verdict)

    @property
    def held_out_error(self) -> float | None:
        """Relative torque error over all validation recordings; None without any."""
        return stacked_error(self.validation)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Reports on several estimates of one robot, in the order given.

    Parameters
    ----------
    model : TorqueModel
    reports : tuple of EstimateReport
        In the order in which the estimates were given.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True))
    >>> q, dq, ddq = np.random.default_rng(0).normal(size=(3, 200, 1))
    >>> motion = ci.Recording(("joint1",), np.arange(200) / 100, q, dq, ddq)
    >>> body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]  # kg, kg m, kg m^2
    >>> log = ci.simulate_torque(model, [*body, 0.4], motion)
    >>> regression = ci.build_regression(model, log)
    >>> found = ci.compare([ci.least_squares(model, regression)], [log])
    >>> round(found["least squares"].validation[0].stacked, 6)
    0.0
    """

    model: TorqueModel
    reports: tuple[EstimateReport, ...]

    def __getitem__(self, method: str) -> EstimateReport:
        for report in self.reports:
            if report.estimate.method == method:
                return report
        known = ", ".join(report.estimate.method for report in self.reports)
        raise ProblemError(f"no estimate by {method!r}; there are: {known}")

    @property
    def usable(self) -> tuple[EstimateReport, ...]:
        """The reports whose verdict is ``use`` or ``use with care``."""
        return tuple(report for report in self.reports if report.verdict.usable)

    def __repr__(self) -> str:
        verdicts = (f"{r.estimate.method!r}: {r.verdict}" for r in self.reports)
        return f"Comparison({', '.join(verdicts)})"

    def __str__(self) -> str:
        return verdict_table(self).text()

    def _repr_html_(self) -> str:
        return verdict_table(self).html()


def verdict_table(comparison: Comparison) -> Table:
    """Return each estimate's verdict, its consistent links and held-out errors."""
    reports = comparison.reports
    verdicts = [(report, report.verdict) for report in reports]
    usable = sum(verdict.usable for _, verdict in verdicts)
    held_out = reports[0].validation
    return Table(
        f"{comparison.model.robot.name}: {usable} of {len(reports)} estimates may be "
        "used",
        (
            "estimate",
            "verdict",
            "consistent links",
            *(f"held-out error {i}" for i in range(1, len(held_out) + 1)),
        ),
        tuple(
            (
                report.estimate.method,
                verdict.word,
                counted(report.consistent_links),
                *(f"{error.stacked:.2%}" for error in report.validation),
            )
            for report, verdict in verdicts
        ),
        tuple(
            f"held-out error {i}: all joints, {error.recording}{_band(error)}"
            for i, error in enumerate(held_out, start=1)
        ),
    )


def _band(error: TorqueError) -> str:
    return "" if error.band is None else f", torque below {error.band:g} Hz"


def counted(links: Sequence[bool]) -> str:
    """Return the number of true entries, of all links, as text.

    Examples
    --------
    >>> counted([True, False, True])
    '2 of 3'
    """
    return f"{sum(links)} of {len(links)}"


@single_threaded
def compare(
    estimates: Sequence[Estimate],
    validation: Sequence[Recording],
    *,
    training: Sequence[Recording] = (),
    findings: Sequence[LogFinding] = (),
    regression: Regression | None = None,
    crossed: Slopes | None = None,
    drawn: DrawnParts | None = None,
    seed: int = 0,
) -> Comparison:
    """Compare estimates of one robot on recordings.

    Parameters
    ----------
    estimates : sequence of Estimate
        Estimates of one torque model, with different methods.
    validation, training : sequence of Recording
        With velocity, acceleration and torque.
    findings : sequence of LogFinding
        Faults of the recordings, found by `diagnose`; verdicts use them.
    regression : Regression, optional
        Regression of the training recordings: if least squares is impossible, they are
        tested for a contradiction of physics; see `consistency_test`.
    crossed : Slopes, optional
        Slopes of joints whose torque is not that of the nominal bodies; see
        `confirmed_slopes`.
    drawn : DrawnParts, optional
        Shapes of links and nominal drives, of the robot's file.
    seed : int
        Seed of the poses at which the mass matrix is examined.

    Raises
    ------
    ProblemError
        If there is nothing to compare, or the models differ.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True))
    >>> q, dq, ddq = np.random.default_rng(0).normal(size=(3, 200, 1))
    >>> motion = ci.Recording(("joint1",), np.arange(200) / 100, q, dq, ddq)
    >>> body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]  # kg, kg m, kg m^2
    >>> log = ci.simulate_torque(model, [*body, 0.4], motion)
    >>> regression = ci.build_regression(model, log)
    >>> plain, robust = ci.least_squares(model, regression), ci.huber(model, log)
    >>> found = ci.compare([plain, robust], [log])
    >>> [report.estimate.method for report in found.reports]
    ['least squares', 'Huber']
    """
    require_types(estimates, Estimate, "estimates")
    require_types(training, Recording, "training")
    require_types(validation, Recording, "validation")
    model = _one_model(estimates)
    poses = random_poses(model, POSES, seed)
    learnt, held_out = (
        [torque_errors(estimates, recording) for recording in recordings]
        for recordings in (training, validation)
    )
    efforts, speeds = usual_efforts(model, training), log_speeds(training)
    reports = [
        EstimateReport(
            estimate=estimate,
            training=tuple(errors[i] for errors in learnt),
            validation=tuple(errors[i] for errors in held_out),
            links=link_conditions(model, estimate.parameters),
            base_feasibility=base_feasibility(
                model,
                estimate.base,
                estimate.base_values,
                witness=estimate.parameters,
            ),
            least_mass_eigenvalue=least_mass_eigenvalue(
                model, estimate.parameters, poses
            ),
            distance_to_nominal=_distances(estimate),
            findings=tuple(findings),
            crossed=crossed,
            usual_efforts=efforts,
            drawn=drawn,
            speeds=speeds,
        )
        for i, estimate in enumerate(estimates)
    ]
    if regression is not None:
        reports = _tested(reports, regression)
    return Comparison(model, tuple(reports))


def _distances(estimate: Estimate) -> Vector:
    """Return the distance of each link from its nominal body."""
    nominal = reference_bodies(estimate.model.robot)
    pairs = zip(estimate.links, nominal, strict=True)
    return np.array([pullback_distance(x, body) for x, body in pairs])


def _one_model(estimates: Sequence[Estimate]) -> TorqueModel:
    """Return the model of all estimates.

    Raises
    ------
    ProblemError
        If there is no estimate, or they are of several models.
    """
    if not estimates:
        raise ProblemError("no estimate to compare")
    model = estimates[0].model
    if any(e.model.fingerprint != model.fingerprint for e in estimates):
        raise ProblemError("the estimates have different parameters, or are of others")
    return model


def _tested(
    reports: Sequence[EstimateReport], regression: Regression
) -> list[EstimateReport]:
    """Add whether the data contradict physics, if least squares is impossible."""
    impossible = [
        report.estimate
        for report in reports
        if report.estimate.method in _UNCONSTRAINED
        and report.base_feasibility.answer == "impossible"
    ]
    if not impossible:
        return list(reports)
    first = impossible[0]
    try:
        test = consistency_test(first.model, regression, base=first.base)
    except SolverError:
        return list(reports)
    return [replace(report, consistency=test) for report in reports]
