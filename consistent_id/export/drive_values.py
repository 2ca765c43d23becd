"""Friction and drive coefficients by joint, and those that a format cannot express."""

from collections.abc import Collection, Container, Mapping
from dataclasses import dataclass
from math import isfinite

from consistent_id.estimation.estimate import Estimate
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.drive.gear_coupling import GearCoupling
from consistent_id.robot.model import Joint


@dataclass(frozen=True, slots=True)
class JointDrive:
    """One joint's terms and coefficients.

    Parameters
    ----------
    values : dict of str to float
        By name, such as ``"viscous"``; only coefficients of the joint's terms are
        included.
    middle : float, [rad or m]
        Middle of the joint's limits, at which varying friction is evaluated.
    """

    joint: str
    terms: DriveTerms
    values: Mapping[str, float]
    middle: float = 0.0

    def simulated(self, parameter: str) -> float | None:
        """Return a parameter of simulators, such as ``"damping"``; None without a term.

        Of several coefficients of a term, such as the Coulomb levels of both
        directions, the mean.
        """
        levels = [
            sum(self.values[name] for name in term.names) / len(term.names)
            for term in self.terms.terms
            if term.simulated_as == parameter
        ]
        if levels and parameter == "friction":
            levels.append(self.values.get("friction_slope", 0.0) * self.middle)
        return sum(levels) if levels else None


def joint_drives(estimate: Estimate) -> tuple[JointDrive, ...]:
    """Return the terms and coefficients of all joints, in order."""
    model = estimate.model
    return tuple(
        JointDrive(
            joint.name,
            terms,
            {term: estimate[f"{joint.name}.{term}"] for term in terms.names},
            _middle(joint),
        )
        for joint, terms in zip(model.robot.driven, model.terms, strict=True)
    )


def follower_drives(estimate: Estimate) -> tuple[JointDrive, ...]:
    """Return empty drives of joints that follow one whose drive is known.

    The friction of such a joint acts on its leader, whose coefficients contain it. If
    it were stated again at the follower, a simulator would count it twice.
    """
    known = {drive.joint for drive in joint_drives(estimate) if drive.terms.names}
    return tuple(
        JointDrive(joint.name, DriveTerms(), {})
        for joint in estimate.model.robot.joints
        if joint.mimic is not None and joint.mimic.joint in known
    )


def in_leader(follower: str) -> str:
    """Return the note on a follower whose stated friction is removed."""
    return (
        f"friction of {follower} is set to zero: it follows another joint, whose "
        f"coefficients contain it"
    )


def _middle(joint: Joint) -> float:
    limits = joint.limits.lower, joint.limits.upper
    return sum(limits) / 2.0 if all(map(isfinite, limits)) else 0.0


def coupling_values(
    estimate: Estimate,
) -> tuple[tuple[GearCoupling, Mapping[str, float]], ...]:
    """Return couplings with their coefficients."""
    return tuple(
        (coupling, {n: estimate[f"{coupling.label}.{n}"] for n in coupling.names})
        for coupling in estimate.model.couplings
    )


def not_expressed(
    estimate: Estimate,
    where: str,
    expressed: Collection[str],
    exempt: Container[tuple[str, str]] = (),
) -> tuple[str, ...]:
    """Return sentences on drive terms that a format cannot express.

    Parameters
    ----------
    where : str
        The format's name.
    expressed : collection of str
        Parameters of simulators that it has: `simulated_as` of the terms.
    exempt : container of (str, str)
        Joints (or couplings) and terms that it can express, though not for all.
    """
    without = [
        (drive.joint, name, drive.values[name])
        for drive in joint_drives(estimate)
        for term in drive.terms.terms
        if term.simulated_as not in expressed
        for name in term.names
    ]
    for coupling, values in coupling_values(estimate):
        without += [(coupling.label, name, value) for name, value in values.items()]
    left: dict[str, list[str]] = {}
    for owner, name, value in without:
        if value != 0.0 and (owner, name) not in exempt:
            left.setdefault(name, []).append(f"{owner} {value:.6g}")
    notes = [f"{where} has no {term}: {', '.join(of)}" for term, of in left.items()]
    return (*notes, *_rounded_signs(estimate, where, expressed, exempt))


def _rounded_signs(
    estimate: Estimate,
    where: str,
    expressed: Collection[str],
    exempt: Container[tuple[str, str]],
) -> tuple[str, ...]:
    """Return notes on Coulomb levels that replace smoother or two-level friction."""
    if "friction" not in expressed:
        return ()
    levels = [
        (drive.joint, term)
        for drive in joint_drives(estimate)
        if drive.simulated("friction")
        for term in drive.terms.terms
        if term.simulated_as == "friction"
    ]
    smooth = [
        f"{joint} {term.shapes['velocity_scale']:g}"
        for joint, term in levels
        if "velocity_scale" in term.shapes
    ]
    smooth += [
        f"{c.label} {c.velocity_scale:g}"
        for c, values in coupling_values(estimate)
        if c.velocity_scale is not None
        and values.get("coupling_coulomb")
        and (c.label, "coupling_coulomb") in exempt
    ]
    uneven = [joint for joint, term in levels if len(term.names) > 1]
    notes = []
    if smooth:
        notes.append(
            f"{where} has Coulomb friction that jumps with the sign of the velocity; "
            f"the identified form is tanh(velocity / scale), scale: {', '.join(smooth)}"
        )
    if uneven:
        notes.append(
            f"{where} has one Coulomb level for both directions; it is the mean of the "
            f"two of {', '.join(uneven)}"
        )
    return tuple(notes)
