"""The identified robot's dynamics as one Python file that needs NumPy alone."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from consistent_id.estimation.estimate import Estimate
from consistent_id.export.export_formats import Export, exporter, provenance
from consistent_id.export.file_values import coupling_values, joint_drives
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


@exporter("numpy")
def to_numpy(estimate: Estimate, *, allow_refused: bool = False) -> Export:
    """Return a Python module with ``inverse_dynamics``, ``gravity``, ``mass_matrix``.

    Friction and drive terms included. It holds the robot's numbers and a recursive
    Newton-Euler algorithm over arrays of samples.

    Parameters
    ----------
    estimate : Estimate
    allow_refused : bool
        Export what is refused, too.

    Raises
    ------
    ProblemError
        If the estimate is refused and `allow_refused` is false.
    """
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
    for j, column, value in model.drive_entries(q, dq, ddq, dict(enumerate(load))):
        if terms[column - layout.inertial_size].simulated_as != "armature":  # in ROTORS
            torque = f"{x[column].item()!r} * {SourceText.of(value).text}"
            lines.append(f"    tau[..., {j}] += {torque}  # {layout.names[column]!r}")
    return "\n".join([*lines, "    return tau", ""])


def _harmless(text: str) -> str:
    return text.replace("\\", "/").replace('"', "'")


HEAD = '''"""{provenance}

Inverse dynamics, gravity torque and mass matrix, with friction and drive terms. Needs
NumPy and nothing else. SI units; q, dq, ddq have shape (..., {n}), joints in the order
of JOINTS. Bodies: m, m c, Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the link frame's origin.
"""

import numpy as np

{data}
'''

BODY = '''

def inverse_dynamics(q, dq, ddq):
    """Return joint torques, friction and drive terms included, shape (..., {n})."""
    q, dq, ddq = np.broadcast_arrays(*(np.asarray(x, float) for x in (q, dq, ddq)))
    return rigid_body(q, dq, ddq) + drive(q, dq, ddq)


def gravity(q):
    """Return the torque that holds the bodies at rest, shape (..., {n})."""
    rest = np.zeros_like(np.asarray(q, float))
    return rigid_body(q, rest, rest)


def mass_matrix(q):
    """Return the mass matrix, rotor inertias included, shape (..., {n}, {n})."""
    q = np.asarray(q, float)
    rest = np.zeros_like(q)
    columns = [
        rigid_body(q, rest, rest + unit, gravity=np.zeros(3)) for unit in np.eye({n})
    ]
    return np.stack(columns, axis=-1) + ROTORS


def rigid_body(q, dq, ddq, bodies=BODIES, gravity=GRAVITY):
    """Return joint torques of the bodies alone (recursive Newton-Euler)."""
    q, dq, ddq = (np.asarray(x, float) for x in (q, dq, ddq)){joints}
    state, turns, arms, wrenches = [], [], [], []
    zero = np.zeros((*q.shape[:-1], 3))
    for k, parent in enumerate(PARENT):
        w, dw, a = (zero, zero, zero - gravity) if parent < 0 else state[parent]
        axis, rate, push = AXIS[k], dq[..., k, None], ddq[..., k, None]
        slide = q[..., k, None] * axis if SLIDES[k] else zero
        arm = TRANSLATION[k] + slide @ ROTATION[k].T
        R = ROTATION[k] @ (np.eye(3) if SLIDES[k] else _turn(axis, q[..., k]))
        a = _into(R, a + np.cross(dw, arm) + np.cross(w, np.cross(w, arm)))
        w, dw = _into(R, w), _into(R, dw)
        if SLIDES[k]:
            a = a + push * axis + 2.0 * np.cross(w, rate * axis)
        else:
            dw = dw + push * axis + np.cross(w, rate * axis)
            w = w + rate * axis
        state.append((w, dw, a))
        turns.append(R)
        arms.append(arm)
        m, h, inertia = bodies[k][0], bodies[k][1:4], _inertia(bodies[k])
        force = m * a + np.cross(dw, h) + np.cross(w, np.cross(w, h))
        moment = dw @ inertia + np.cross(w, w @ inertia) + np.cross(h, a)
        wrenches.append((force, moment))
    tau = np.zeros(q.shape)
    for k in reversed(range(len(PARENT))):
        force, moment = wrenches[k]
        tau[..., k] = (force if SLIDES[k] else moment) @ AXIS[k]
        if PARENT[k] >= 0:
            f, n = wrenches[PARENT[k]]
            force, moment = _out_of(turns[k], force), _out_of(turns[k], moment)
            wrenches[PARENT[k]] = (f + force, n + moment + np.cross(arms[k], force))
    return tau{coordinates}


def _inertia(body):
    xx, xy, yy, xz, yz, zz = body[4:]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _turn(axis, angle):
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return np.eye(3) + s * K + (1.0 - c) * (K @ K)


def _into(R, x):
    return np.einsum("...ji,...j->...i", R, x)


def _out_of(R, x):
    return np.einsum("...ij,...j->...i", R, x)
'''
