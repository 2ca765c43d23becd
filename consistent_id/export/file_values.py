"""Values in files: inertias, friction, drives, and terms that a format cannot express.

An inertia in a file is about the centre of mass, and divided among fixed links.  Only
the inertia of a whole moving link is identifiable: its division among parts that never
move against each other has no effect on torque.
"""

from collections.abc import Collection, Container, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.estimation.estimate import Estimate
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.drive.gear_coupling import GearCoupling
from consistent_id.robot.chains import Selection
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.model import Joint, RobotModel

_WIDEST = np.pi  # rad between limits, up to which a tendon's moment arm grows

_ROUNDING = 1e-12  # of the largest eigenvalue: the digits of a difference of inertias


@dataclass(frozen=True, slots=True, eq=False)
class FileLink:
    """A link of the file: its parameters in its own frame, and that frame's place.

    `rotation` and `translation` place it in the frame of the moving link.
    """

    name: str
    body: InertialParameters
    rotation: Matrix
    translation: Vector

    @property
    def placed(self) -> InertialParameters:
        """The parameters in the moving link's frame."""
        return self.body.transformed(self.rotation, self.translation)

    def given(
        self, whole: InertialParameters, share: float = 1.0
    ) -> InertialParameters:
        """Return a share of the whole, in the part's own frame."""
        body = InertialParameters(share * whole.vector)
        back = self.rotation.T
        return body.transformed(back, -back @ self.translation)


@dataclass(frozen=True, slots=True, eq=False)
class SplitInertia:
    """Parameters of the parts, in their own frames and order, and how they came."""

    bodies: tuple[InertialParameters, ...]
    note: str = ""


def split_inertia(whole: InertialParameters, parts: Sequence[FileLink]) -> SplitInertia:
    """Divide the whole among parts, of which the first is the moving link itself.

    The others keep the file's values if these, and the remainder for the first, are
    physically consistent.  Otherwise each gets a share of the whole in proportion to
    its mass; all of these are consistent.
    """
    own, *others = parts
    heavy = [part for part in others if part.body.vector.any()]
    if not heavy:
        return SplitInertia((own.given(whole), *(part.body for part in others)))
    stated = np.sum([part.placed.vector for part in heavy], axis=0)
    rest = InertialParameters(whole.vector - stated)
    names = ", ".join(part.name for part in heavy)
    keeps = all(part.body.is_consistent(_ROUNDING) for part in heavy)
    if not whole.is_consistent(_ROUNDING) or (keeps and rest.is_consistent(_ROUNDING)):
        fixed = "which is fixed to it" if len(heavy) == 1 else "which are fixed to it"
        note = f"{own.name} is the remainder without {names}, {fixed} and not changed"
        return SplitInertia((own.given(rest), *(part.body for part in others)), note)
    masses = np.maximum([part.body.mass for part in parts], 0.0)
    if masses.sum() == 0.0:
        masses[0] = 1.0
    weights = masses / masses.sum()
    bodies = tuple(p.given(whole, w) for p, w in zip(parts, weights, strict=True))
    note = (
        f"the remainder of {own.name} without {names} would not be physically "
        f"consistent: the whole is divided in proportion to the masses"
    )
    return SplitInertia(bodies, note)


def central(body: InertialParameters) -> tuple[float, Vector, Matrix]:
    """Return mass, centre of mass and inertia about it; the origin if massless."""
    if body.mass == 0.0:
        return 0.0, np.zeros(3), body.inertia
    return body.mass, body.com, body.central_inertia


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


@lru_cache(maxsize=8)  # an export asks for those of one estimate several times
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


@dataclass(frozen=True, slots=True)
class FileContents:
    """Bodies and drives that were read from a file.

    Parameters
    ----------
    bodies : dict of str to ndarray, shape (10,)
        By link, in the link's frame.
    drives : dict of str to dict
        By joint: ``damping``, ``friction``, ``armature``, ``stiffness``, or names of
        drive terms.
    """

    bodies: Mapping[str, Vector] = field(default_factory=dict)
    drives: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def parameters_in_file(
    estimate: Estimate, holds: Collection[str] | None, read: FileContents | None = None
) -> Vector:
    """Return the parameters of an estimate that are left in a file.

    Terms that the format does not have are zero, and friction by direction or position
    is one level.  Friction changes its sign as the estimate's does: a simulator lets
    joints stick there instead.

    Parameters
    ----------
    holds : collection of str, optional
        Parameters of simulators, and names of further terms, that the format has; None
        if it has all.
    read : FileContents, optional
        Values of the file, in place of the estimate's.
    """
    model, x = estimate.model, estimate.parameters.copy()
    layout, read = model.layout, FileContents() if read is None else read
    for k, link in enumerate(model.robot.links):
        x[layout.link_slice(k)] = read.bodies.get(link.name, x[layout.link_slice(k)])
    for joint, drive in zip(model.robot.driven, joint_drives(estimate), strict=True):
        stated, kept = read.drives.get(drive.joint, {}), holds
        if kept is not None and not can_slope(joint):
            kept = {*kept} - {"friction_slope"}
        for name, value in _terms_in_file(drive, kept, stated).items():
            x[layout.index(f"{drive.joint}.{name}")] = value
    for coupling, values in coupling_values(estimate):
        for name in values:
            if holds is not None and name not in holds:
                x[layout.index(f"{coupling.label}.{name}")] = 0.0
    return x


def can_slope(joint: Joint) -> bool:
    """Return whether a file that holds friction by position can hold a joint's.

    A tendon's moment arm grows over at most half a turn.
    """
    width = joint.limits.upper - joint.limits.lower
    return joint.kind == "revolute" and width <= _WIDEST


def _terms_in_file(
    drive: JointDrive, holds: Collection[str] | None, stated: Mapping[str, float]
) -> dict[str, float]:
    """Return the coefficients of one joint's terms in a file."""
    sloped = drive.values.get("friction_slope", 0.0) != 0.0
    found = {}
    for term in drive.terms.terms:
        parameter = term.simulated_as
        for name in term.names:
            if holds is None or name in holds:
                found[name] = stated.get(name, drive.values[name])
            elif parameter is None or parameter not in holds:
                found[name] = 0.0
            elif parameter == "friction" and sloped and "friction_slope" in holds:
                found[name] = drive.values[name]  # a tendon has a part of it
            else:
                own = drive.simulated(parameter) or 0.0
                found[name] = stated.get(parameter, own)
    return found


def read_contents(
    form: str, file: Path, estimate: Estimate, selection: Selection
) -> FileContents | None:
    """Return what a written file holds; None if this package does not read the format.

    Parameters
    ----------
    selection : Selection
        The joints of the file that are the robot's.

    Raises
    ------
    ModelError
        If it is refused.
    """
    if form == "urdf":
        return _of_urdf(file, selection)
    if form == "mjcf":
        return _of_mjcf(file, selection)
    if form == "json":
        return _of_json(file)
    if form == "pin":
        return _of_pinocchio(file, estimate)
    return _of_source(file) if form == "isaaclab" else None


def _of_urdf(file: Path, selection: Selection) -> FileContents:
    from consistent_id.robot.loaders.urdf import load_urdf
    from consistent_id.robot.loaders.xml import parse

    robot = load_urdf(file, **asdict(selection))
    drives = {}
    for joint in parse(file.read_bytes()).all("joint"):
        stated = joint.child("dynamics")
        words = {} if stated is None else stated.attributes
        drives[joint.name] = {
            name: float(words.get(name, 0.0)) for name in ("damping", "friction")
        }
    return FileContents(_bodies(robot), drives)


def _bodies(robot: RobotModel) -> dict[str, Vector]:
    return {k.name: k.nominal.vector for k in robot.links if k.nominal is not None}


def _of_mjcf(file: Path, selection: Selection) -> FileContents | None:
    """Return the values as MuJoCo compiles them; None where tendons carry some."""
    from consistent_id.robot.loaders.mjcf import compiled_file, load_mjcf

    compiled = compiled_file(file)
    if compiled.ntendon:
        return None
    robot = load_mjcf(file, **asdict(selection))
    drives = {}
    for joint in robot.driven:
        j = compiled.joint(joint.name)
        stiffness = float(compiled.jnt_stiffness[j.id])
        dof, place = int(compiled.jnt_dofadr[j.id]), int(compiled.jnt_qposadr[j.id])
        drives[joint.name] = {
            "damping": float(compiled.dof_damping[dof]),
            "friction": float(compiled.dof_frictionloss[dof]),
            "armature": float(compiled.dof_armature[dof]),
            "stiffness": stiffness,
            "offset": -stiffness * float(compiled.qpos_spring[place]),
            "drag": float(compiled.dof_dampingpoly[dof, 0]),
        }
    return FileContents(_bodies(robot), drives)


def _of_json(file: Path) -> FileContents:
    import json

    record = json.loads(file.read_text(encoding="utf-8"))
    bodies = {
        link["name"]: InertialParameters.from_central(
            link["mass"], link["com"], link["inertia"]
        ).vector
        for link in record["links"]
    }
    drives = {
        joint: {name: float(term["value"]) for name, term in drive["terms"].items()}
        for joint, drive in record["drives"].items()
    }
    return FileContents(bodies, drives)


def _of_pinocchio(file: Path, estimate: Estimate) -> FileContents:
    import pinocchio as pin

    model, robot = pin.Model(), estimate.model.robot
    model.loadFromString(file.read_text())
    bodies = {
        link.name: np.array(model.inertias[k].toDynamicParameters())
        for k, link in enumerate(robot.links, start=1)
    }
    levels = getattr(model, "upperDryFrictionLimit", None)
    levels = model.friction if levels is None else levels  # of older versions
    drives = {
        joint.name: {
            "damping": float(model.damping[i]),
            "friction": float(levels[i]),
            "armature": float(model.armature[i]),
        }
        for joint in robot.driven
        for i in [int(model.idx_vs[model.getJointId(joint.name)])]
    }
    return FileContents(bodies, drives)


def _of_source(file: Path) -> FileContents:
    """Return the tables of a Python source, which is read but not run."""
    import ast

    tables: dict[str, Any] = {}
    for statement in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.Assign) and isinstance(statement.value, ast.Dict):
            tables[ast.unparse(statement.targets[0])] = ast.literal_eval(
                statement.value
            )
    names = {"damping": "VISCOUS", "friction": "FRICTION", "armature": "ARMATURE"}
    return FileContents(
        drives={
            joint: {name: float(tables[of][joint]) for name, of in names.items()}
            for joint in tables["FRICTION"]
        }
    )
