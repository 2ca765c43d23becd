"""The regressor as a CasADi function, by the same recursion."""

import warnings
from collections.abc import Sequence
from typing import Any

from consistent_id.regression.newton_euler import (
    FreeMotion,
    JointMotion,
    floats,
    joint_geometry,
    joint_motions,
    regressor_entries,
)
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import RobotModel


def casadi_regressor(model: TorqueModel | RobotModel) -> Any:
    """Return the regressor as a CasADi function of one sample.

    Parameters
    ----------
    model : TorqueModel or RobotModel
        A robot alone has the rigid-body columns only.

    Returns
    -------
    casadi.Function
        ``(q, dq, ddq) -> Y``, shapes (joints,) and (torque joints, parameters), SX.
    """
    import casadi as ca

    model = TorqueModel(model) if isinstance(model, RobotModel) else model
    robot, row, n = model.robot, model.rows, len(model.robot)
    q, dq, ddq = (ca.SX.sym(name, n) for name in ("q", "dq", "ddq"))
    Y = ca.SX(len(row), len(model.layout))
    scalars = [ca.vertsplit(x) for x in (q, dq, ddq)]
    motion = joint_motions(robot, scalars, lambda x: (ca.sin(x), ca.cos(x)))
    fill_bodies(Y, model, motion)
    loads = {
        j: ca.mtimes(Y[row[j], : len(reference)], ca.DM(reference))
        for j, reference in model.load_references.items()
    }
    with warnings.catch_warnings():
        # CasADi announces that NumPy's functions of its expressions will change.
        warnings.simplefilter("ignore", FutureWarning)
        for j, column, values in model.drive_entries(q, dq, ddq, loads):
            if j in row:
                Y[row[j], column] = values
    return ca.Function("regressor", [q, dq, ddq], [Y], ["q", "dq", "ddq"], ["Y"])


def fill_bodies(
    Y: Any, model: TorqueModel, motion: Sequence[JointMotion | FreeMotion]
) -> None:
    """Set the inertial columns of a model's regressor, of one sample's expressions."""
    robot, row = model.robot, model.rows
    gravity = floats(robot.gravity)
    for j, k, entries in regressor_entries(joint_geometry(robot), gravity, motion):
        if j in row:
            for i, entry in enumerate(entries, start=10 * k):
                Y[row[j], i] = entry
