"""Friction and drive coefficients joint by joint, and which of them a format lacks."""

from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass

from consistent_id.estimation.estimate import Estimate
from consistent_id.regression.friction import DriveTerms, GearCoupling


@dataclass(frozen=True, slots=True)
class JointDrive:
    """One joint's terms and coefficients.

    Parameters
    ----------
    joint : str
    terms : DriveTerms
    values : dict of str to float
        By name, such as ``"viscous"``; what the joint's terms lack is not there.
    """

    joint: str
    terms: DriveTerms
    values: Mapping[str, float]

    @property
    def friction_level(self) -> float | None:
        """Coulomb friction: the mean of both directions; None without such a term."""
        if self.terms.asymmetric:
            both = (self.values["coulomb_positive"], self.values["coulomb_negative"])
            return sum(both) / 2
        return self.values.get("coulomb")


def joint_drives(estimate: Estimate) -> tuple[JointDrive, ...]:
    """Return the terms and coefficients of all joints, in order."""
    model = estimate.model
    return tuple(
        JointDrive(
            name,
            terms,
            {term: estimate[f"{name}.{term}"] for term in terms.names},
        )
        for name, terms in zip(model.robot.joint_names, model.terms, strict=True)
    )


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
    expressed: Iterable[str],
    exempt: Container[tuple[str, str]] = (),
) -> tuple[str, ...]:
    """Return sentences on drive terms that a format has no place for.

    Parameters
    ----------
    estimate : Estimate
    where : str
        The format's name.
    expressed : iterable of str
        Names of the terms that it does have a place for.
    exempt : container of (str, str)
        Joints (or couplings) and terms that it has a place for, though not at all.
    """
    expressed = set(expressed)
    left: dict[str, list[str]] = {}
    for drive in joint_drives(estimate):
        for name, value in drive.values.items():
            said = name in expressed or (drive.joint, name) in exempt
            if not said and value != 0.0:
                left.setdefault(name, []).append(f"{drive.joint} {value:.6g}")
    for coupling, values in coupling_values(estimate):
        for name, value in values.items():
            said = name in expressed or (coupling.label, name) in exempt
            if not said and value != 0.0:
                left.setdefault(name, []).append(f"{coupling.label} {value:.6g}")
    notes = [f"{where} has no {term}: {', '.join(of)}" for term, of in left.items()]
    return (*notes, *_rounded_signs(estimate, where, expressed, exempt))


def _rounded_signs(
    estimate: Estimate,
    where: str,
    expressed: set[str],
    exempt: Container[tuple[str, str]],
) -> tuple[str, ...]:
    """Say where a Coulomb level stands for something smoother or of two levels."""
    if "coulomb" not in expressed:
        return ()
    drives = [d for d in joint_drives(estimate) if d.friction_level]
    smooth = [
        f"{d.joint} {d.terms.velocity_scale:g}"
        for d in drives
        if d.terms.velocity_scale is not None
    ]
    smooth += [
        f"{c.label} {c.velocity_scale:g}"
        for c, values in coupling_values(estimate)
        if c.velocity_scale is not None
        and values.get("coupling_coulomb")
        and (c.label, "coupling_coulomb") in exempt
    ]
    uneven = [d.joint for d in drives if d.terms.asymmetric]
    notes = []
    if smooth:
        notes.append(
            f"{where} has Coulomb friction that jumps with the sign of the velocity; "
            f"identified was tanh(velocity / scale), scale: {', '.join(smooth)}"
        )
    if uneven:
        notes.append(
            f"{where} has one Coulomb level for both directions; it is the mean of the "
            f"two of {', '.join(uneven)}"
        )
    return tuple(notes)
