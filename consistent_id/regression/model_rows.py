"""The rows of a torque model: whose torque each is, and which have a bias."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from consistent_id.errors import ProblemError
from consistent_id.regression.row_names import BASE_ROWS, CONTACT_FREE, row_names
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import require_known

if TYPE_CHECKING:
    from consistent_id.regression.regressor import TorqueModel


def in_order(names: Sequence[str], robot: RobotModel) -> tuple[str, ...]:
    """Return the named rows in the robot's order, all of them for none.

    Raises
    ------
    ProblemError
        If the robot has no such row.
    """
    if not robot.connected or tuple(names) == (CONTACT_FREE,):
        return tuple(names)
    known = row_names(robot)
    if names and not robot.joint_names and not set(names) & set(known):
        return tuple(names)  # of one body alone, whose rows somebody else gives
    require_known(names, known, "torque_joints: no joint")
    return tuple(j for j in known if j in names) or known


def rows_of(model: "TorqueModel") -> dict[int, int]:
    """Return the row of each generalised coordinate that has one.

    Those of a floating base are numbered after the joints, as in `joint_motions`.
    """
    if model.torque_joints == (CONTACT_FREE,):
        raise ProblemError(
            "rows free of contact forces mix all rows, as the contacts are; give their "
            "base parameters (contact_free_base) and regression (contact_free_rows)"
        )
    coordinates = (*model.robot.joint_names, *BASE_ROWS)
    places = [coordinates.index(name) for name in model.torque_joints]
    return {j: row for row, j in enumerate(places)}


def biased_rows(model: "TorqueModel") -> tuple[str, ...]:
    """Return the rows whose sensor has a bias, if it does."""
    if not model.wrench_bias:
        return ()
    if not set(BASE_ROWS) <= set(model.torque_joints):
        raise ProblemError(
            "wrench_bias is of the sensor of the base wrench, but the model has no "
            "rows of it; load the robot with base='floating', or leave the bias out"
        )
    return BASE_ROWS
