"""The entries that drive terms and couplings have in the regressor."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from consistent_id.errors import ProblemError
from consistent_id.regression.drive.gear_coupling import GearCoupling
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import require_known

if TYPE_CHECKING:
    from consistent_id.regression.regressor import TorqueModel


def drive_entries(
    model: "TorqueModel", q: Any, dq: Any, ddq: Any, loads: Mapping[int, Any]
) -> Iterator[tuple[int, int, Any]]:
    """Yield ``(joint, column, values)`` of drive terms and couplings.

    `loads` are the transmitted torques of joints whose friction depends on them; a
    joint that needs one and has none is one without a row, and is left out.
    """
    column = model.layout.inertial_size
    for j, terms in enumerate(model.terms):
        if terms.needs_load and j not in loads:
            column += len(terms.names)
            continue
        for values in terms.columns(q[j], dq[j], ddq[j], loads.get(j)):
            yield j, column, values
            column += 1
    for coupling in model.couplings:
        i, j = coupled_joints(model.robot, coupling)
        for first, second in coupling.columns((dq[i], dq[j]), (ddq[i], ddq[j])):
            yield i, column, first
            yield j, column, second
            column += 1


def coupled_joints(robot: RobotModel, coupling: GearCoupling) -> tuple[int, int]:
    """Return the places of the two joints of a coupling.

    Raises
    ------
    ProblemError
        If there is no such joint, or one turns and the other slides.
    """
    places = []
    for name in (coupling.first, coupling.second):
        require_known([name], robot.joint_names, f"coupling {coupling.label}: no joint")
        places.append(robot.joint_names.index(name))
    first, second = places
    slide = [robot.driven[j].kind == "prismatic" for j in places]
    if slide[0] != slide[1]:
        raise ProblemError(
            f"coupling {coupling.label}: one joint turns, the other slides; the sum of "
            "their rates means nothing"
        )
    return first, second
