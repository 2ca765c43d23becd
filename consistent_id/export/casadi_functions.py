"""The identified robot's dynamics as CasADi functions."""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from consistent_id.estimation.estimate import Estimate
from consistent_id.export.exported_file import Export
from consistent_id.export.provenance import require_fixed_base, require_usable
from consistent_id.regression.casadi_regressor import casadi_regressor
from consistent_id.regression.regressor import TorqueModel


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
    """

    inverse_dynamics: Any
    rigid_body: Any
    gravity: Any
    mass_matrix: Any


def to_casadi(estimate: Estimate, *, allow_refused: bool = False) -> Functions:
    """Return the dynamics of the identified robot as CasADi functions.

    Raises
    ------
    ProblemError
        If the estimate is refused and `allow_refused` is false.
    """
    import casadi as ca

    require_usable(estimate, allow_refused)
    require_fixed_base(estimate.model.robot, "CasADi functions")
    x = estimate.parameters
    # Joints without a measured torque have one nonetheless.
    model = replace(estimate.model, torque_joints=())
    weightless = replace(model, robot=replace(model.robot, gravity=np.zeros(3)))
    q, dq, ddq = (ca.SX.sym(s, len(model.robot)) for s in ("q", "dq", "ddq"))
    rest = ca.SX.zeros(len(model.robot))
    inertial = x[: model.layout.inertial_size]
    bodies = TorqueModel(model.robot)

    def function(name: str, inputs: list[Any], output: Any, out: str) -> Any:
        names = ["q", "dq", "ddq"][: len(inputs)]
        return ca.Function(name, inputs, [ca.densify(output)], names, [out])

    tau = _torque(model, x, q, dq, ddq)
    rigid = _torque(bodies, inertial, q, dq, ddq)
    at_rest = _torque(bodies, inertial, q, rest, rest)
    inertia = ca.jacobian(_torque(weightless, x, q, rest, ddq), ddq)
    # |load| has no slope at rest: what is linear in the acceleration is the mass.
    M = ca.substitute(inertia, ddq, rest)
    return Functions(
        function("inverse_dynamics", [q, dq, ddq], tau, "tau"),
        function("rigid_body", [q, dq, ddq], rigid, "tau"),
        function("gravity", [q], at_rest, "g"),
        function("mass_matrix", [q], M, "M"),
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


def _torque(model: TorqueModel, x: Any, q: Any, dq: Any, ddq: Any) -> Any:
    import casadi as ca

    return ca.mtimes(casadi_regressor(model)(q, dq, ddq), ca.DM(x))
