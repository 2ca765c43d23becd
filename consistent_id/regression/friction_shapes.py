"""The shapes of friction: numbers in which the torque is not linear.

Velocity scales, Stribeck velocities and exponents, by names such as
``"elbow.velocity_scale"``.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from consistent_id.errors import ProblemError
from consistent_id.regression.drive.drive_terms import LAWS
from consistent_id.regression.drive.term import DriveTerm
from consistent_id.regression.drive_entries import coupled_joints
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.parameters import did_you_mean

SHAPE_NAMES = tuple(dict.fromkeys(k for x in LAWS.values() for k in x.shape_parameters))
"""Shapes that known laws have."""


@dataclass(frozen=True, slots=True)
class Shape:
    """One shape of a joint or of a coupling.

    Parameters
    ----------
    owner : str
        Joint, or label of a coupling.
    kind : str
        Such as ``"velocity_scale"``.
    bounds : tuple of (float, float)
        Where `fit_shapes` searches.
    """

    owner: str
    kind: str
    value: float
    unit: str
    bounds: tuple[float, float]

    @property
    def name(self) -> str:
        """Owner and kind, such as ``"elbow.velocity_scale"``."""
        return f"{self.owner}.{self.kind}"


def shapes_of(model: TorqueModel) -> tuple[Shape, ...]:
    """Return the shapes of all joints that have a row, and of all couplings.

    Examples
    --------
    >>> from consistent_id import DHRow, DriveTerms, from_modified_dh
    >>> arm = from_modified_dh("arm", [DHRow(0, 0)])
    >>> drive = DriveTerms(coulomb="tanh", velocity_scale=0.02)
    >>> [(s.name, s.value) for s in shapes_of(TorqueModel(arm, drive))]
    [('joint1.velocity_scale', 0.02)]
    """
    robot = model.robot
    found: list[Shape] = []
    for joint, terms in zip(robot.driven, model.terms, strict=True):
        if joint.name in model.torque_joints:
            slides = joint.kind == "prismatic"
            found += _shapes(joint.name, terms.terms, slides)
    for coupling in model.couplings:
        if {coupling.first, coupling.second} & set(model.torque_joints):
            first, _ = coupled_joints(robot, coupling)
            slides = robot.driven[first].kind == "prismatic"
            found += _shapes(coupling.label, coupling.terms, slides)
    return tuple(found)


def with_shapes(model: TorqueModel, values: Mapping[str, float]) -> TorqueModel:
    """Return the model with the named shapes changed.

    Raises
    ------
    ProblemError
        If the model has no such shape, or a value is not positive.
    """
    known = {shape.name for shape in shapes_of(model)}
    for name in values:
        if name not in known:
            near = did_you_mean(name, sorted(known))
            raise ProblemError(f"the model has no shape {name!r}; {near}")
    changes: dict[str, dict[str, float]] = {}
    for name, value in values.items():
        owner, kind = name.rsplit(".", 1)
        changes.setdefault(owner, {})[kind] = float(value)
    drive = tuple(
        terms.with_shapes(changes.get(joint, {}))
        for joint, terms in zip(model.robot.joint_names, model.terms, strict=True)
    )
    couplings = tuple(
        replace(coupling, **changes.get(coupling.label, {}))  # type: ignore[arg-type]
        for coupling in model.couplings
    )
    return replace(model, drive=drive, couplings=couplings)


def _shapes(owner: str, terms: Sequence[DriveTerm], slides: bool) -> Iterable[Shape]:
    """Return the shapes of terms, those that several share once."""
    found: dict[str, Shape] = {}
    for term in terms:
        for kind, value in term.shapes.items():
            unit, low, high = term.shape_parameters[kind]
            found[kind] = Shape(owner, kind, value, unit[slides], (low, high))
    return found.values()
