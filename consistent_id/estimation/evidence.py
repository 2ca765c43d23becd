"""What a verdict on an estimate is judged by."""

from dataclasses import dataclass

from consistent_id.constraints.cones.certificate import OptimumVerdict
from consistent_id.constraints.link_condition import LinkCondition, link_conditions
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.fit import Fit
from consistent_id.estimation.torque_error import TorqueError
from consistent_id.recordings.finding import Finding
from consistent_id.regression.mass_matrix import (
    POSES,
    least_mass_eigenvalue,
    random_poses,
)


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a verdict is judged by; what is not known is None or empty.

    Parameters
    ----------
    method : str
    optimum : {"certified", "uncertified"}
    optimum_reason : str
    links : tuple of LinkCondition
    least_mass_eigenvalue : float, [kg m^2 or kg]
        Of the mass matrix over `POSES` random poses.
    fit : Fit, optional
    impossible : str
        Proof that no consistent robot has the base parameters, in words.
    contradicted : str
        How much worse than least squares the best consistent robot fits, in words, if
        that is no chance.
    held_out : tuple of TorqueError
    findings : tuple of Finding
        Of the recordings.
    undetermined : tuple of str
        Combinations that the data do not determine.
    accepted : tuple of str
        Kinds of reasons to override.
    loose_trunk : tuple of str
        Mass and first moments of a floating base's body that the data do not determine,
        but sums with other bodies at best; see `loose_trunk`.
    """

    method: str
    optimum: OptimumVerdict
    optimum_reason: str
    links: tuple[LinkCondition, ...]
    least_mass_eigenvalue: float
    fit: Fit | None = None
    impossible: str = ""
    contradicted: str = ""
    held_out: tuple[TorqueError, ...] = ()
    findings: tuple[Finding, ...] = ()
    undetermined: tuple[str, ...] = ()
    accepted: tuple[str, ...] = ()
    loose_trunk: tuple[str, ...] = ()


def evidence_of(estimate: Estimate, *, seed: int = 0) -> Evidence:
    """Return what an estimate knows of itself.

    Parameters
    ----------
    seed : int
        Of the poses at which the mass matrix is examined.
    """
    model, x = estimate.model, estimate.parameters
    poses = random_poses(model, POSES, seed)
    return Evidence(
        method=estimate.method,
        optimum=estimate.certificate.verdict,
        optimum_reason=estimate.certificate.reason,
        links=link_conditions(model, x),
        least_mass_eigenvalue=least_mass_eigenvalue(model, x, poses),
        fit=estimate.fit,
        undetermined=estimate.undetermined,
        accepted=estimate.accepted,
        loose_trunk=loose_trunk(estimate),
    )


def loose_trunk(estimate: Estimate) -> tuple[str, ...]:
    """Return what neither data nor constraints tell of a floating base's own body.

    Of mass and first moments, whose sums with other bodies the data may well determine.
    """
    robot, determined = estimate.model.robot, ("data", "constraint")
    if not robot.floating or not len(robot):
        return ()
    pairs = zip(estimate.model.layout.names[:4], estimate.origins, strict=False)
    return tuple(name for name, origin in pairs if origin not in determined)
