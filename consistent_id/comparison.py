"""Estimates side by side: held-out torque, consistency, distance to nominal."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._arrays import Array, Vector
from consistent_id.base_feasibility import BaseFeasibility, base_feasibility
from consistent_id.certificate import Verdict
from consistent_id.errors import ProblemError
from consistent_id.estimate import Estimate
from consistent_id.inertia import pseudo_inertia
from consistent_id.priors import pullback_distance
from consistent_id.recording import Recording
from consistent_id.regressor import TorqueModel
from consistent_id.scaling import link_scales, reference_bodies

POSES = 10_000
"""Random poses at which the mass matrix is examined."""

_CONSISTENT = (
    1e-9  # eigenvalues of J, per typical mass and length, above -this are >= 0
)


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
    consistent_links : tuple of bool
        Whether each link of the standard parameters, as they stand, is a body.
    base_feasibility : BaseFeasibility
        Whether any body has the estimate's base parameters.
    least_mass_eigenvalue : float, [kg m^2 or kg]
        Smallest eigenvalue of the mass matrix over `POSES` random poses.
    distance_to_nominal : ndarray, shape (links,)
        Pullback distance of each link to its reference body.
    """

    estimate: Estimate
    training: tuple[TorqueError, ...]
    validation: tuple[TorqueError, ...]
    consistent_links: tuple[bool, ...]
    base_feasibility: BaseFeasibility
    least_mass_eigenvalue: float
    distance_to_nominal: Vector

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
    reports = (
        EstimateReport(
            estimate=estimate,
            training=tuple(torque_error(estimate, r) for r in training),
            validation=tuple(torque_error(estimate, r) for r in validation),
            consistent_links=consistent_links(estimate),
            base_feasibility=base_feasibility(
                model, estimate.base, estimate.base_values
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
        for estimate in estimates
    )
    return Comparison(model, tuple(reports))


def torque_error(estimate: Estimate, recording: Recording) -> TorqueError:
    """Return the prediction error of an estimate along a recording."""
    measured = recording.of(estimate.model.torque_joints).torque
    if measured is None:
        raise ProblemError(f"{recording.name} has no torque to compare with")
    if not measured.any():
        raise ProblemError(f"{recording.name}: its torque is zero throughout")
    error = measured - estimate.predict(recording)
    rms = np.sqrt(np.mean(error**2, axis=0))
    size = np.sqrt(np.mean(measured**2, axis=0))
    return TorqueError(
        recording.name,
        rms,
        rms / np.where(size > 0.0, size, np.nan),
        float(np.linalg.norm(error) / np.linalg.norm(measured)),
    )


def consistent_links(estimate: Estimate) -> tuple[bool, ...]:
    """Tell, for each link of the standard parameters, whether it is a body."""
    roots = link_scales(estimate.model.robot).root
    least = [
        float(np.linalg.eigvalsh(J / np.outer(root, root))[0])
        for J, root in zip(pseudo_inertia(estimate.links), roots, strict=True)
    ]
    return tuple(value >= -_CONSISTENT for value in least)


def random_poses(model: TorqueModel, count: int, seed: int) -> Array:
    """Return random positions within the joints' limits, shape (count, joints)."""
    rng = np.random.default_rng(seed)
    lower, upper = [], []
    for joint in model.robot.joints:
        reach = 1.0 if joint.kind == "prismatic" else np.pi
        low, high = joint.limits.lower, joint.limits.upper
        low = low if np.isfinite(low) else min(-reach, high - reach)
        lower.append(low)
        upper.append(high if np.isfinite(high) else max(reach, low + reach))
    return rng.uniform(lower, upper, (count, len(model.robot)))


def mass_matrices(model: TorqueModel, parameters: Vector, q: Array) -> Array:
    """Return mass matrices, shape (poses, joints, joints), [kg m^2 or kg].

    Column ``j`` is what a unit acceleration of joint ``j`` adds to the torque at rest;
    rotor inertia and couplings are part of it.
    """
    robot = replace(model.robot, gravity=np.zeros(3))
    still = replace(model, robot=robot, torque_joints=())
    rest = np.zeros_like(q)
    at_rest = still.predict(parameters, q, rest, rest)
    columns = [
        still.predict(parameters, q, rest, np.tile(unit, (len(q), 1))) - at_rest
        for unit in np.eye(len(model.robot))
    ]
    return np.stack(columns, axis=2)


def least_mass_eigenvalue(model: TorqueModel, parameters: Vector, q: Array) -> float:
    """Return the smallest eigenvalue of the mass matrix over poses."""
    M = mass_matrices(model, parameters, q)
    return float(np.linalg.eigvalsh((M + M.transpose(0, 2, 1)) / 2).min())
