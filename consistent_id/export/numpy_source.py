"""The identified robot's dynamics as one Python file that needs NumPy alone."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from consistent_id.estimation.estimate import Estimate
from consistent_id.export.drive_values import coupling_values, joint_drives
from consistent_id.export.exported_file import Export
from consistent_id.export.numpy_template import BODY, HEAD
from consistent_id.export.provenance import (
    provenance,
    require_fixed_base,
    require_usable,
)
from consistent_id.regression.drive_entries import drive_entries
from consistent_id.robot.model import RobotModel


@dataclass(frozen=True, slots=True, eq=False)
class SourceText:
    """An expression in Python and NumPy.

    Examples
    --------
    >>> import numpy as np
    >>> v = SourceText("v")
    >>> (2.0 * np.tanh(v / 0.1) - abs(v) ** 2).text
    '((2.0 * np.tanh((v / 0.1))) - (abs(v) ** 2.0))'
    """

    text: str

    @classmethod
    def of(cls, value: Any) -> "SourceText":
        """Return a number as the text that makes it again."""
        return value if isinstance(value, cls) else cls(repr(float(value)))

    def __array_ufunc__(
        self, ufunc: Any, method: str, *inputs: Any, **options: Any
    ) -> Any:
        """Write a call of one of NumPy's functions."""
        if method != "__call__" or options:
            return NotImplemented
        arguments = ", ".join(self.of(x).text for x in inputs)
        return SourceText(f"np.{ufunc.__name__}({arguments})")

    def _with(self, sign: str, other: Any) -> "SourceText":
        return SourceText(f"({self.text} {sign} {self.of(other).text})")

    def __add__(self, other: Any) -> "SourceText":
        return self._with("+", other)

    def __sub__(self, other: Any) -> "SourceText":
        return self._with("-", other)

    def __mul__(self, other: Any) -> "SourceText":
        return self._with("*", other)

    def __truediv__(self, other: Any) -> "SourceText":
        return self._with("/", other)

    def __pow__(self, other: Any) -> "SourceText":
        return self._with("**", other)

    def __radd__(self, other: Any) -> "SourceText":
        return self.of(other) + self

    def __rsub__(self, other: Any) -> "SourceText":
        return self.of(other) - self

    def __rmul__(self, other: Any) -> "SourceText":
        return self.of(other) * self

    def __rtruediv__(self, other: Any) -> "SourceText":
        return self.of(other) / self

    def __neg__(self) -> "SourceText":
        return SourceText(f"(-{self.text})")

    def __abs__(self) -> "SourceText":
        return SourceText(f"abs({self.text})")


def to_numpy(estimate: Estimate, *, allow_refused: bool = False) -> Export:
    """Return a Python module with ``inverse_dynamics``, ``gravity``, ``mass_matrix``.

    Friction and drive terms included. It holds the robot's numbers and a recursive
    Newton-Euler algorithm over arrays of samples.

    Raises
    ------
    ProblemError
        If the estimate is refused and `allow_refused` is false.
    """
    require_usable(estimate, allow_refused)
    require_fixed_base(estimate.model.robot, "NumPy functions")
    n = len(estimate.model.robot)
    head = HEAD.format(
        provenance=_harmless(provenance(estimate)), n=n, data="\n".join(_data(estimate))
    )
    text = head + _body(estimate.model.robot).replace("{n}", str(n)) + _drive(estimate)
    return Export("numpy", text.encode())


def _body(robot: RobotModel) -> str:
    """Return the recursion; where joints follow others, RATES takes q to all joints."""
    joints = coordinates = ""
    if len(robot) < len(robot.joints):
        joints = "\n    q, dq, ddq = q @ RATES.T + OFFSETS, dq @ RATES.T, ddq @ RATES.T"
        coordinates = " @ RATES"
    return BODY.replace("{joints}", joints).replace("{coordinates}", coordinates)


def _data(estimate: Estimate) -> Iterator[str]:
    robot, reference = estimate.model.robot, estimate.model.load_reference
    joints = robot.joints
    yield f"JOINTS = {robot.joint_names!r}"
    yield f"PARENT = {tuple(joint.parent for joint in joints)!r}"
    yield f"SLIDES = {tuple(joint.kind == 'prismatic' for joint in joints)!r}"
    yield _array("GRAVITY", robot.gravity)
    yield _array("ROTATION", np.array([joint.rotation for joint in joints]))
    yield _array("TRANSLATION", np.array([joint.translation for joint in joints]))
    yield _array("AXIS", np.array([joint.axis for joint in joints]))
    yield _array("BODIES", estimate.links)
    if len(robot) < len(joints):
        yield _array("RATES", robot.joint_rates)
        yield _array("OFFSETS", np.array([t.offset for t in robot.transmissions]))
    if reference is not None:
        yield _array("LOAD_BODIES", reference.reshape(-1, 10))
    yield _array("ROTORS", _rotors(estimate))


def _array(name: str, values: Any) -> str:
    rows = values.tolist()
    if np.ndim(values) == 1:
        return f"{name} = np.array({rows!r})"
    return "\n".join([f"{name} = np.array([", *(f"    {r!r}," for r in rows), "])"])


def _rotors(estimate: Estimate) -> Any:
    names = estimate.model.robot.joint_names
    rotors = np.diag(
        [drive.simulated("armature") or 0.0 for drive in joint_drives(estimate)]
    )
    for coupling, values in coupling_values(estimate):
        i, j = names.index(coupling.first), names.index(coupling.second)
        shared = values.get("coupling_rotor_inertia", 0.0)
        rotors[i, j], rotors[j, i] = rotors[i, j] + shared, rotors[j, i] + shared
    return rotors


def _drive(estimate: Estimate) -> str:
    lines = [
        "",
        "",
        "def drive(q, dq, ddq):",
        '    """Return what friction, rotors and springs add to the torque."""',
        "    tau = ddq @ ROTORS.T",
    ]
    if estimate.model.load_reference is not None:
        lines.append("    load = rigid_body(q, dq, ddq, bodies=LOAD_BODIES)")
    model, x = estimate.model, estimate.parameters
    q, dq, ddq, load = (
        [SourceText(f"{name}[..., {k}]") for k in range(len(model.robot))]
        for name in ("q", "dq", "ddq", "load")
    )
    layout, terms = model.layout, model.column_terms
    for j, column, value in drive_entries(model, q, dq, ddq, dict(enumerate(load))):
        if terms[column - layout.inertial_size].simulated_as != "armature":  # in ROTORS
            torque = f"{x[column].item()!r} * {SourceText.of(value).text}"
            lines.append(f"    tau[..., {j}] += {torque}  # {layout.names[column]!r}")
    return "\n".join([*lines, "    return tau", ""])


def _harmless(text: str) -> str:
    return text.replace("\\", "/").replace('"', "'")
