"""Estimates side by side: held-out torque, consistency, distance to nominal."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.tables import Table
from consistent_id._support.threads import single_threaded
from consistent_id.comparison.base_feasibility import BaseFeasibility, base_feasibility
from consistent_id.constraints.cones.certificate import Verdict
from consistent_id.constraints.distances import pullback_distance
from consistent_id.constraints.link_condition import LinkCondition, link_conditions
from consistent_id.errors import ProblemError
from consistent_id.estimation.estimate import Estimate
from consistent_id.recordings.recording import Recording
from consistent_id.regression.mass_matrix import (
    POSES,
    least_mass_eigenvalue,
    random_poses,
)
from consistent_id.regression.regression import build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.scaling import reference_bodies


@dataclass(frozen=True, slots=True, eq=False)
class TorqueError:
    """Prediction error of one estimate on one recording.

    Parameters
    ----------
    recording : str
    rms : ndarray, shape (torque joints,), [N m or N]
        Root of the mean squared error.
    relative : ndarray, shape (torque joints,)
        RMS error over RMS torque.
    stacked : float
        ``||tau - prediction|| / ||tau||`` over all joints.
    """

    recording: str
    rms: Vector
    relative: Vector
    stacked: float

    @property
    def mse(self) -> Vector:
        """Mean squared error of each joint, [(N m)^2 or N^2]."""
        return self.rms**2


@dataclass(frozen=True, slots=True, eq=False)
class EstimateReport:
    """What there is to say of one estimate.

    Parameters
    ----------
    estimate : Estimate
    training : tuple of TorqueError
    validation : tuple of TorqueError
    links : tuple of LinkCondition
        Physical consistency of each link of the standard parameters, as they stand.
    base_feasibility : BaseFeasibility
        Whether any consistent robot has the estimate's base parameters.
    least_mass_eigenvalue : float, [kg m^2 or kg]
        Smallest eigenvalue of the mass matrix over `POSES` random poses.
    distance_to_nominal : ndarray, shape (links,)
        Pullback distance of each link to its reference body.
    """

    estimate: Estimate
    training: tuple[TorqueError, ...]
    validation: tuple[TorqueError, ...]
    links: tuple[LinkCondition, ...]
    base_feasibility: BaseFeasibility
    least_mass_eigenvalue: float
    distance_to_nominal: Vector

    @property
    def consistent_links(self) -> tuple[bool, ...]:
        """Whether each link is physically consistent."""
        return tuple(link.consistent for link in self.links)

    @property
    def refusal(self) -> str:
        """Why no robot could have these parameters, or the certificate's reason."""
        if self.base_feasibility.answer == "impossible":
            return self.base_feasibility.summary
        return self.estimate.certificate.reason

    @property
    def verdict(self) -> Verdict:
        """``refused`` where no robot could have these parameters, else its own."""
        if self.base_feasibility.answer == "impossible":
            return "refused"
        return self.estimate.certificate.verdict


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Reports on several estimates of one robot, in the order given."""

    model: TorqueModel
    reports: tuple[EstimateReport, ...]

    def __getitem__(self, method: str) -> EstimateReport:
        for report in self.reports:
            if report.estimate.method == method:
                return report
        known = ", ".join(report.estimate.method for report in self.reports)
        raise ProblemError(f"no estimate by {method!r}; there are: {known}")

    @property
    def certified(self) -> bool:
        """Whether any estimate is certified."""
        return any(report.verdict == "certified" for report in self.reports)

    def __repr__(self) -> str:
        verdicts = (f"{r.estimate.method!r}: {r.verdict}" for r in self.reports)
        return f"Comparison({', '.join(verdicts)})"

    def __str__(self) -> str:
        return verdict_table(self).text()

    def _repr_html_(self) -> str:
        return verdict_table(self).html()


def verdict_table(comparison: Comparison) -> Table:
    """Return each estimate's verdict, and how well it predicts torque held out."""
    reports = comparison.reports
    certified = [r.estimate.method for r in reports if r.verdict == "certified"]
    held_out = [error.recording for error in reports[0].validation]
    refused = (
        f"{r.estimate.method} is refused: {r.refusal}"
        for r in reports
        if r.verdict == "refused"
    )
    return Table(
        f"{comparison.model.robot.name}: {len(certified)} of {len(reports)} estimates "
        "are certified",
        (
            "estimate",
            "verdict",
            "physically consistent links",
            *(f"torque error on {name}" for name in held_out),
        ),
        tuple(
            (
                r.estimate.method,
                r.verdict,
                f"{sum(r.consistent_links)} of {len(r.consistent_links)}",
                *(f"{error.stacked:.2%}" for error in r.validation),
            )
            for r in reports
        ),
        tuple(refused),
    )


@single_threaded
def compare(
    estimates: Sequence[Estimate],
    validation: Sequence[Recording],
    *,
    training: Sequence[Recording] = (),
    seed: int = 0,
) -> Comparison:
    """Compare estimates of one robot on recordings.

    Parameters
    ----------
    estimates : sequence of Estimate
        Of one torque model, with different methods.
    validation, training : sequence of Recording
        With velocity, acceleration and torque.
    seed : int
        Of the poses at which the mass matrix is examined.

    Raises
    ------
    ProblemError
        If there is nothing to compare, or the models differ.
    """
    if not estimates:
        raise ProblemError("no estimate to compare")
    model = estimates[0].model
    if any(e.model.fingerprint != model.fingerprint for e in estimates):
        raise ProblemError("the estimates have different parameters, or are of others")
    poses = random_poses(model, POSES, seed)
    learnt, held_out = (
        [torque_errors(estimates, recording) for recording in recordings]
        for recordings in (training, validation)
    )
    reports = (
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
            distance_to_nominal=np.array(
                [
                    pullback_distance(x, body)
                    for x, body in zip(
                        estimate.links, reference_bodies(model.robot), strict=True
                    )
                ]
            ),
        )
        for i, estimate in enumerate(estimates)
    )
    return Comparison(model, tuple(reports))


def torque_errors(
    estimates: Sequence[Estimate], recording: Recording
) -> list[TorqueError]:
    """Return the prediction error of each estimate of one model along a recording."""
    model = estimates[0].model
    measured = recording.of(model.torque_joints).torque
    if measured is None:
        raise ProblemError(f"{recording.name} has no torque to compare with")
    if not measured.any():
        raise ProblemError(f"{recording.name}: its torque is zero throughout")
    regression = build_regression(model, recording)
    size = regression.torque_rms
    errors = []
    for estimate in estimates:
        rms = regression.residual_rms(estimate.parameters)
        errors.append(
            TorqueError(
                recording.name,
                rms,
                rms / np.where(size > 0.0, size, np.nan),
                float(np.linalg.norm(rms) / np.linalg.norm(size)),
            )
        )
    return errors
