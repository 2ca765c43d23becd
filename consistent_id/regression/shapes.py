"""The shapes of friction: numbers in which the torque is not linear.

Velocity scales, Stribeck velocities and exponents, by names such as
``"elbow.velocity_scale"``.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from consistent_id.errors import ProblemError
from consistent_id.regression.regressor import TorqueModel, coupled_joints
from consistent_id.robot.parameters import did_you_mean

SHAPE_NAMES = ("velocity_scale", "stribeck_velocity", "stribeck_exponent")

SHAPED_TERMS = (
    "coulomb",
    "coulomb_positive",
    "coulomb_negative",
    "stribeck",
    "load_friction",
    "coupling_coulomb",
)
"""Terms whose columns depend on shapes, if their joint or coupling has any."""


@dataclass(frozen=True, slots=True)
class Shape:
    """One shape of a joint or of a coupling.

    Parameters
    ----------
    owner : str
        Joint, or label of a coupling.
    kind : str
        One of `SHAPE_NAMES`.
    value : float
    unit : str
    """

    owner: str
    kind: str
    value: float
    unit: str

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
    robot, found = model.robot, []
    for joint, terms in zip(robot.joints, model.terms, strict=True):
        if joint.name in model.torque_joints:
            slides = joint.kind == "prismatic"
            for kind, value in terms.shapes.items():
                found.append(Shape(joint.name, kind, value, _unit(kind, slides)))
    for coupling in model.couplings:
        if {coupling.first, coupling.second} & set(model.torque_joints):
            first, _ = coupled_joints(robot, coupling)
            slides = robot.joints[first].kind == "prismatic"
            for kind, value in coupling.shapes.items():
                found.append(Shape(coupling.label, kind, value, _unit(kind, slides)))
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
        replace(terms, **changes.get(joint, {}))  # type: ignore[arg-type]
        for joint, terms in zip(model.robot.joint_names, model.terms, strict=True)
    )
    couplings = tuple(
        replace(coupling, **changes.get(coupling.label, {}))  # type: ignore[arg-type]
        for coupling in model.couplings
    )
    return replace(model, drive=drive, couplings=couplings)


def _unit(kind: str, slides: bool) -> str:
    return "1" if kind == "stribeck_exponent" else "m/s" if slides else "rad/s"
