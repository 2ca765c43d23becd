"""The identified robot's dynamics as CasADi functions, and in C.

The C code is one source of C99 that needs only ``math.h``, and one header.
"""

import hashlib
import re
import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.estimation.estimate import Estimate
from consistent_id.export.export_formats import (
    Export,
    SideFile,
    exporter,
    provenance,
)
from consistent_id.export.smooth_friction import (
    FRICTION_VELOCITY,
    with_smooth_friction,
)
from consistent_id.regression.casadi_rows import casadi_regressor
from consistent_id.regression.newton_euler import (
    floats,
    joint_geometry,
    joint_motions,
    torque_parts,
)
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import RobotModel

_HEAD = """/* {provenance}
 *
 * Torques of the identified robot. SI units; joints in this order:
{joints}
 *
 *   torque = M(q) ddq + bias(q, dq) + springs(q) + friction(q, dq)
 *
 * friction is smooth at rest and at most the identified friction, at every velocity;
 * inverse_dynamics has the friction as it was identified. gravity is bias at rest.
 * M is {n} x {n} and symmetric, rotor inertias included; springs has constant offsets.
 * No memory is allocated and nothing is kept between calls.
 */
"""

_DECLARED = (
    ("inverse_dynamics", ("q", "dq", "ddq"), "tau"),
    ("torque", ("q", "dq", "ddq"), "tau"),
    ("bias", ("q", "dq"), "tau"),
    ("friction", ("q", "dq"), "tau"),
    ("springs", ("q",), "tau"),
    ("gravity", ("q",), "tau"),
    ("mass_matrix", ("q",), "M"),
)
"""Functions of the C code: name, arguments, result."""


_LONGEST = 100
"""Characters of a name.  File systems have 255 for it, the ends of functions' names and
the suffix; C promises to distinguish 63."""
_DIGITS = 8


class Functions(NamedTuple):
    """CasADi functions of one sample, shapes (joints,); all joints, in order.

    Parameters
    ----------
    inverse_dynamics : casadi.Function
        ``(q, dq, ddq) -> tau``, friction and drive terms included.
    rigid_body : casadi.Function
        ``(q, dq, ddq) -> tau`` without them.
    gravity : casadi.Function
        ``q -> g``: torque at rest, without them.
    mass_matrix : casadi.Function
        ``q -> M``, shape (joints, joints), rotor inertias and couplings included.
    bias : casadi.Function
        ``(q, dq) -> tau``: gravity, Coriolis and centrifugal torque of the bodies.
    springs : casadi.Function
        ``q -> tau``: springs and constant offsets of the drives.
    friction : casadi.Function
        ``(q, dq) -> tau``: friction that is smooth at rest, see `with_smooth_friction`;
        friction by load takes the load at rest.
    torque : casadi.Function
        ``(q, dq, ddq) -> M ddq + bias + springs + friction``, of the functions above.
    """

    inverse_dynamics: Any
    rigid_body: Any
    gravity: Any
    mass_matrix: Any
    bias: Any
    springs: Any
    friction: Any
    torque: Any


@exporter("casadi")
def to_casadi(
    estimate: Estimate,
    *,
    friction_velocity: float | Sequence[float] = FRICTION_VELOCITY,
    allow_refused: bool = False,
) -> Functions:
    """Return the dynamics of the identified robot as CasADi functions.

    Parameters
    ----------
    estimate : Estimate
    friction_velocity : float or sequence of float, [rad/s or m/s]
        Width of the change of sign of `Functions.friction`.
    allow_refused : bool
        Export what is refused, too.

    Raises
    ------
    ProblemError
        If the estimate is refused and `allow_refused` is false.
    """
    import casadi as ca

    x = estimate.parameters
    # Joints without a measured torque have a torque, too.
    model = replace(estimate.model, torque_joints=())
    weightless = replace(model, robot=replace(model.robot, gravity=np.zeros(3)))
    q, dq, ddq = (ca.SX.sym(s, len(model.robot)) for s in ("q", "dq", "ddq"))
    rest = ca.SX.zeros(len(model.robot))
    bodies = x[: model.layout.inertial_size]

    def function(name: str, inputs: list[Any], output: Any, out: str) -> Any:
        names = ["q", "dq", "ddq"][: len(inputs)]
        return ca.Function(name, inputs, [ca.densify(output)], names, [out])

    tau = _torque(model, x, q, dq, ddq)
    rigid = _bodies_torque(model.robot, bodies, q, dq, ddq)
    control = with_smooth_friction(model, friction_velocity)
    kept = control.parameters(x)
    springs = _drive_torque(control.model, kept, q, rest, rest)
    friction = _drive_torque(control.model, kept, q, dq, rest) - springs
    rotors = _drive_torque(control.model, kept, q, rest, ddq)
    inertia = ca.jacobian(_torque(weightless, x, q, rest, ddq), ddq)
    # |load| has no slope at rest: the part linear in the acceleration is the mass.
    M = ca.substitute(inertia, ddq, rest)
    return Functions(
        function("inverse_dynamics", [q, dq, ddq], tau, "tau"),
        function("rigid_body", [q, dq, ddq], rigid, "tau"),
        function("gravity", [q], _bodies_torque(model.robot, bodies, q), "g"),
        function("mass_matrix", [q], M, "M"),
        function("bias", [q, dq], _bodies_torque(model.robot, bodies, q, dq), "tau"),
        function("springs", [q], springs, "tau"),
        function("friction", [q, dq], friction, "tau"),
        function("torque", [q, dq, ddq], rigid + rotors + friction, "tau"),
    )


def casadi_file(estimate: Estimate, *, allow_refused: bool = False) -> Export:
    """Return ``dynamics``, as ``casadi.Function.load`` reads it.

    ``(q, dq, ddq) -> (tau, g, M)``: inverse dynamics with friction, gravity torque and
    mass matrix.
    """
    import casadi as ca

    functions = to_casadi(estimate, allow_refused=allow_refused)
    q, dq, ddq = (ca.SX.sym(s, len(estimate.model.robot)) for s in ("q", "dq", "ddq"))
    outputs = [
        functions.inverse_dynamics(q, dq, ddq),
        functions.gravity(q),
        functions.mass_matrix(q),
    ]
    whole = ca.Function(
        "dynamics", [q, dq, ddq], outputs, ["q", "dq", "ddq"], ["tau", "g", "M"]
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "dynamics.casadi"
        whole.save(str(path))
        return Export("casadi", path.read_bytes())


def to_c(
    estimate: Estimate,
    *,
    name: str | None = None,
    friction_velocity: float | Sequence[float] = FRICTION_VELOCITY,
    allow_refused: bool = False,
) -> Export:
    """Return C code of the identified robot's torques; a header is beside it.

    Generated by CasADi from the functions of `to_casadi`: straight-line code, the same
    for every sample, without allocation.

    Parameters
    ----------
    estimate : Estimate
    name : str, optional
        Prefix of the functions' names; by default the robot's name.  Of more than 100
        characters it is cut, and a note says so.
    friction_velocity : float or sequence of float, [rad/s or m/s]
        See `to_casadi`.
    allow_refused : bool
    """
    import casadi as ca

    functions = to_casadi(
        estimate, friction_velocity=friction_velocity, allow_refused=allow_refused
    )
    robot = estimate.model.robot
    asked = name or robot.name
    name = identifier(asked)
    generator = ca.CodeGenerator(f"{name}.c", {"casadi_int": "int"})
    for own, _, _ in _DECLARED:
        generator.add(_renamed(getattr(functions, own), f"{name}_{own}_"))
    with tempfile.TemporaryDirectory() as folder:
        generator.generate(f"{folder}/")
        code = (Path(folder) / f"{name}.c").read_text()
    joints = "\n".join(f" *   {k} {j}" for k, j in enumerate(robot.joint_names))
    about = {"n": len(robot), "joints": _harmless(joints)}
    head = _HEAD.format(provenance=_harmless(provenance(estimate)), **about)
    source = head + code + "".join(_definition(name, *d) for d in _DECLARED)
    header = SideFile(".h", (head + _header(name)).encode())
    rough = with_smooth_friction(estimate.model, friction_velocity).left_out
    notes = [
        f"{parameter} is not in friction and torque: its law is not smooth at rest; "
        "define smoothed(velocity) in it, or use inverse_dynamics"
        for parameter in rough
    ]
    if name != _plain(asked):
        notes.append(
            f"the name has {len(asked)} characters: functions begin with {name}"
        )
    return Export("c", source.encode(), tuple(notes), side=header)


def _prototype(name: str, own: str, arguments: Sequence[str], result: str) -> str:
    given = ", ".join(f"const double *{a}" for a in arguments)
    return f"void {name}_{own}({given}, double *{result})"


def _definition(name: str, own: str, arguments: Sequence[str], result: str) -> str:
    """Return a function that calls CasADi's."""
    return (
        f"\n{_prototype(name, own, arguments, result)} {{\n"
        f"  const double *arguments[{len(arguments)}] = {{{', '.join(arguments)}}};\n"
        f"  double *results[1] = {{{result}}};\n"
        f"  {name}_{own}_(arguments, results, 0, 0, 0);\n}}\n"
    )


def _header(name: str) -> str:
    """Return the declarations, for C and C++."""
    guard = f"{name.upper()}_H"
    lines = "".join(f"{_prototype(name, *one)};\n" for one in _DECLARED)
    return (
        f"#ifndef {guard}\n#define {guard}\n\n"
        '#ifdef __cplusplus\nextern "C" {\n#endif\n\n'
        f"{lines}\n#ifdef __cplusplus\n}}\n#endif\n\n#endif\n"
    )


def _torque(model: TorqueModel, x: Any, q: Any, dq: Any, ddq: Any) -> Any:
    import casadi as ca

    return ca.mtimes(casadi_regressor(model)(q, dq, ddq), ca.DM(x))


def _bodies_torque(
    robot: RobotModel, bodies: Vector, q: Any, dq: Any = None, ddq: Any = None
) -> Any:
    """Return the bodies' torque, by the recursion of forces; at rest by default."""
    import casadi as ca

    n = len(robot)
    state = [[0.0] * n if x is None else ca.vertsplit(x) for x in (q, dq, ddq)]
    motion = joint_motions(robot, state, lambda x: (ca.sin(x), ca.cos(x)))
    gravity, numbers = floats(robot.gravity), bodies.reshape(-1, 10).tolist()
    tau = ca.SX.zeros(n)
    for j, _, value in torque_parts(joint_geometry(robot), gravity, motion, numbers):
        tau[j] += value
    return tau


def _drive_torque(model: TorqueModel, x: Vector, q: Any, dq: Any, ddq: Any) -> Any:
    """Return the torque of drive terms; friction by load takes the load at rest."""
    import casadi as ca

    loads: dict[int, Any] = {}
    if model.load_reference is not None:
        carried = _bodies_torque(model.robot, model.load_reference, q)
        loads = dict(enumerate(ca.vertsplit(carried)))
    tau = ca.SX.zeros(len(model.robot))
    with warnings.catch_warnings():
        # CasADi announces that NumPy's functions of its expressions will change.
        warnings.simplefilter("ignore", FutureWarning)
        for j, column, values in model.drive_entries(q, dq, ddq, loads):
            tau[j] += float(x[column]) * values
    return tau


def identifier(name: str) -> str:
    """Return a name that is valid in C and Python, and of a file.

    A long one is cut; digits that differ for other names are its end.

    Examples
    --------
    >>> identifier("ur-10e"), identifier("3dof"), identifier("")
    ('ur_10e', 'robot_3dof', 'robot')
    >>> len(identifier("arm_" * 75))
    100
    """
    plain = _plain(name)
    if len(plain) <= _LONGEST:
        return plain
    digits = hashlib.sha256(name.encode()).hexdigest()[:_DIGITS]
    return f"{plain[: _LONGEST - _DIGITS - 1].rstrip('_')}_{digits}"


def _plain(name: str) -> str:
    """Return a name with underscores for all that is neither letter nor digit."""
    plain = re.sub(r"[\W_]+", "_", name, flags=re.ASCII).strip("_")
    return plain if plain[:1].isalpha() else f"robot_{plain}".rstrip("_")


def _harmless(text: str) -> str:
    return text.replace("*/", "* /")


def _renamed(function: Any, name: str) -> Any:
    import casadi as ca

    inputs = function.sx_in()
    return ca.Function(name, inputs, function.call(inputs))
